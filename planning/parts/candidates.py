"""Candidates for the assignment of parts: each step with its robots and grips (APEX-MR App. B)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from planning.cell.workcell import (
    Attachment,
    CellObject,
    PlacedRobot,
    Workcell,
    WorldState,
)
from planning.errors import InfeasibleStepError
from planning.geometry.scene_checker import SceneChecker
from planning.kinematics.kinematics import frame_in_flange
from planning.motion.sequential import MARGIN
from planning.parts.assembly import PickPlaceAssembly
from planning.parts.contact_graph import near_to, standing
from planning.parts.grips import Grip, box_grips
from planning.parts.targets import pick_targets, place_targets
from planning.skills.contacts import NOTHING, SkillContacts, gripped, touching
from planning.skills.joint_paths import (
    Obstruction,
    SkillPath,
    joint_distance,
    resolve_skill,
)
from planning.skills.subgoals import SkillTargets
from planning.skills.surroundings import SkillScene, find_obstruction
from planning.tasks.assignment import (
    AssignmentProblem,
    PrimaryCandidate,
    Rejection,
    StepChoice,
)
from planning.transforms import Array, Transform, inverse, readonly

MOST_OVERLAP = 0.002
"""Deepest that a goal may be in what it touches: rounding of poses in files [m]."""


@dataclass(frozen=True)
class PartStep:
    """One step, known before anything is assigned, as it has a part of its own.

    Attributes:
        part: what is placed; it is picked at its ``start``.
        goal: pose of its centre in its place, in the world.
        around: all other parts: those of earlier steps in place, the others where they were.
        grips: ways to hold it; the number of a grip is its place here.
        at_start: what it touches before it is picked, with the distances [m].
        at_goal: what it touches once it is in place, with the distances [m].
    """

    part: CellObject
    goal: Transform
    around: Mapping[str, tuple[CellObject, Attachment]]
    grips: list[Grip]
    at_start: Mapping[str, float]
    at_goal: Mapping[str, float]


def part_steps(cell: Workcell, assembly: PickPlaceAssembly) -> tuple[PartStep, ...]:
    """Return the steps of an assembly, every part of which comes to lie on something.

    Args:
        cell: its objects are the parts.
        assembly: goals and steps.

    Raises:
        InfeasibleStepError: a part would hang in the air, or goes where something is.
    """
    out = []
    where = {item.name: item.start for item in cell.objects}
    for number, name in enumerate(assembly.steps, start=1):
        part, goal = cell.object(name), assembly.goals[name]
        around = {
            item.name: (item, Attachment(None, where[item.name]))
            for item in cell.objects
            if item.name != name
        }
        lying = standing(cell) | {
            k: (item, at.pose) for k, (item, at) in around.items()
        }
        at_goal = near_to((part, goal), lying, assembly.touch)
        _require_standing(f"step {number} ({name})", at_goal)
        at_start = near_to((part, part.start), lying, assembly.touch)
        grips = box_grips(part.size, part.start, goal, assembly.grips)
        out.append(PartStep(part, goal, around, grips, at_start, at_goal))
        where[name] = goal
    return tuple(out)


def _require_standing(step: str, touched: Mapping[str, float]) -> None:
    if not touched:
        raise InfeasibleStepError(
            f"{step} would leave it in the air: it touches neither a fixture nor a part that is"
            " there by then"
        )
    other, gap = min(touched.items(), key=lambda entry: entry[1])
    if gap < -MOST_OVERLAP:
        raise InfeasibleStepError(
            f"{step} goes where {other} is: they would overlap by {-gap * 1e3:.1f} mm"
        )


@dataclass(frozen=True)
class PickPlaceCandidates:
    """The assignment problem of a pick-and-place assembly, and the paths behind it.

    Attributes:
        cell: its objects are the parts.
        frame: name of the tool frame that grips.
        steps: part, grips and surroundings of each step.
        problem: what the solver needs.
        paths: pick and place by step, robot and number of the grip.
    """

    cell: Workcell
    frame: str
    steps: tuple[PartStep, ...]
    problem: AssignmentProblem
    paths: Mapping[tuple[int, str, int], tuple[SkillPath, SkillPath]] = field(
        repr=False
    )

    def pick(self, choice: StepChoice) -> SkillPath:
        """Return the pick of a choice."""
        return self.paths[choice.step, choice.robot, choice.grasp][0]

    def place(self, choice: StepChoice) -> SkillPath:
        """Return the place of a choice."""
        return self.paths[choice.step, choice.robot, choice.grasp][1]


def find_candidates(cell: Workcell, assembly: PickPlaceAssembly) -> PickPlaceCandidates:
    """Find every robot and grip that can do a step, with its cost.

    Both skills are reachable in one posture each and free of contacts among the parts as they
    are at that step, with all other robots at HOME; the robot can stand at HOME with the part.
    Costs are L1 joint distances, HOME to pick plus HOME to place.

    Args:
        cell: its objects are the parts.
        assembly: goals and steps.

    Raises:
        InfeasibleStepError: a part would hang in the air, or goes where something is.
    """
    steps = part_steps(cell, assembly)
    search = _Search()
    for number, step in enumerate(steps, start=1):
        for robot in cell.robots:
            search.add(number, step.grips, _GripOptions(cell, assembly, step, robot))
    problem = AssignmentProblem(
        robots=tuple(robot.name for robot in cell.robots),
        steps=tuple(f"pick and place {name}" for name in assembly.steps),
        needs_support=(False,) * len(assembly.steps),
        primaries=tuple(search.primaries),
        supports=(),
        rejections=tuple(search.rejections),
    )
    frame = assembly.grips.frame
    return PickPlaceCandidates(cell, frame, steps, problem, search.paths)


def held_pose(robot: PlacedRobot, frame: str, grip: Transform) -> Transform:
    """Return the pose of a part in the flange frame of the robot that holds it.

    Args:
        robot: who holds it.
        frame: name of the tool frame.
        grip: pose of that frame in the frame of the part.
    """
    tool = frame_in_flange(robot.model, frame)
    return readonly(tool @ inverse(grip))


class _Search:
    """Gathers candidates of one step and robot after another."""

    def __init__(self) -> None:
        self.primaries: list[PrimaryCandidate] = []
        self.rejections: list[Rejection] = []
        self.paths: dict[tuple[int, str, int], tuple[SkillPath, SkillPath]] = {}

    def add(self, step: int, grips: list[Grip], options: _GripOptions) -> None:
        """Add the candidates of a step for one robot."""
        robot, part = options.robot, options.part
        if not grips:
            self._reject(
                step,
                f"{robot.name} grips {part.name}",
                Obstruction("no face can be gripped both at its start and at its goal"),
            )
        for number, grip in enumerate(grips):
            place = options.place(grip.pose)
            if isinstance(place, Obstruction):
                self._reject(step, f"{robot.name} places, {grip.words}", place)
                continue
            pick = options.pick(grip.pose)
            if isinstance(pick, Obstruction):
                self._reject(step, f"{robot.name} picks, {grip.words}", pick)
                continue
            at_home = options.at_home(grip.pose)
            if at_home is not None:
                self._reject(step, f"{robot.name} at HOME, {grip.words}", at_home)
                continue
            self.paths[step, robot.name, number] = (pick, place)
            cost = sum(joint_distance(robot.home, p.contact) for p in (pick, place))
            self.primaries.append(
                PrimaryCandidate(step, robot.name, part.name, number, cost)
            )

    def _reject(self, step: int, what: str, reason: Obstruction) -> None:
        self.rejections.append(Rejection(step, what, reason.words))


class _GripOptions:
    """How one robot does one step with each of its grips."""

    def __init__(
        self,
        cell: Workcell,
        assembly: PickPlaceAssembly,
        step: PartStep,
        robot: PlacedRobot,
    ) -> None:
        self.cell = cell
        self.assembly = assembly
        self.robot = robot
        self.part = step.part
        self.goal = step.goal
        self.held = gripped(robot.name, self.part.name)
        self._at_start = touching(self.part.name, step.at_start)
        self._at_goal = touching(self.part.name, step.at_goal)
        self._around = step.around
        self._home: dict[str, Array] = {r.name: r.home for r in cell.robots}

    def pick(self, grip: Transform) -> SkillPath | Obstruction:
        """Return the pick of the part."""
        assembly = self.assembly
        targets = pick_targets(
            assembly.grips.frame,
            self.part.start @ grip,
            assembly.approach,
            assembly.leave,
        )
        contacts = SkillContacts(NOTHING, self.held | self._at_start, self.held)
        lying = Attachment(None, self.part.start)
        return self._resolve(targets, contacts, lying, self._in_hand(grip))

    def place(self, grip: Transform) -> SkillPath | Obstruction:
        """Return the place of the part."""
        assembly = self.assembly
        targets = place_targets(
            assembly.grips.frame, self.goal @ grip, assembly.approach, assembly.leave
        )
        contacts = SkillContacts(self.held, self.held | self._at_goal, NOTHING)
        lying = Attachment(None, self.goal)
        return self._resolve(targets, contacts, self._in_hand(grip), lying)

    def at_home(self, grip: Transform) -> Obstruction | None:
        """Return the obstruction at HOME with the part in hand, None where there is none."""
        objects = {**self._around, self.part.name: (self.part, self._in_hand(grip))}
        attachments = {name: at for name, (_, at) in objects.items()}
        checker = SceneChecker(
            self.cell,
            self.robot.name,
            WorldState(self._home, attachments),
            self.held,
            margin=MARGIN,
        )
        contact = checker.contact(self.robot.home)
        return None if contact is None else Obstruction(str(contact))

    def _resolve(
        self,
        targets: SkillTargets,
        contacts: SkillContacts,
        before: Attachment,
        after: Attachment,
    ) -> SkillPath | Obstruction:
        """Return a skill, given where the part is before and after it changes hands."""
        name = self.part.name
        scene = SkillScene(
            self.cell,
            {**self._around, name: (self.part, before)},
            self._home,
            contacts,
            (name, after),
        )
        return resolve_skill(
            self.robot, targets, lambda path: find_obstruction(path, scene)
        )

    def _in_hand(self, grip: Transform) -> Attachment:
        frame = self.assembly.grips.frame
        return Attachment(self.robot.name, held_pose(self.robot, frame, grip))

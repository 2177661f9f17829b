"""Candidates for the assignment: who can put which part in place with which grip (App. B)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from planning.cell.workcell import Attachment, PlacedRobot, Workcell, WorldState
from planning.geometry.scene_checker import SceneChecker, entity
from planning.kinematics.kinematics import frame_in_flange
from planning.motion.sequential import MARGIN
from planning.parts.assembly import PickPlaceAssembly
from planning.parts.part_world import PartWorld
from planning.parts.targets import pick_targets, place_targets
from planning.skills.joint_paths import (
    Obstruction,
    Pairs,
    Phase,
    SkillContacts,
    SkillPath,
    check_skill,
    joint_distance,
    resolve_skill,
)
from planning.skills.subgoals import SkillTargets
from planning.tasks.assignment_problem import (
    AssignmentProblem,
    PrimaryCandidate,
    Rejection,
)
from planning.tasks.plan import StepChoice
from planning.transforms import Array, Transform, inverse, readonly

MOST_OVERLAP = 0.002
"""Deepest that a goal may be in what it touches: rounding of poses in files [m]."""

_NOTHING: Pairs = frozenset()


@dataclass(frozen=True)
class PickPlaceCandidates:
    """The assignment problem of a pick-and-place assembly, and the paths behind it.

    Attributes:
        world: cell and assembly.
        problem: what the solver needs.
        paths: pick and place by step, robot and number of the grip.
    """

    world: PartWorld
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


def find_candidates(
    cell: Workcell, assembly: PickPlaceAssembly, *, balance: float = 1.0
) -> PickPlaceCandidates:
    """Find every robot and grip that can do a step, with its cost.

    Both skills are reachable in one posture each and free of contacts among the parts as they
    are at that step, with all other robots at HOME; the robot can stand at HOME with the part.
    Costs are L1 joint distances, HOME to pick plus HOME to place.

    Args:
        cell: its objects are the parts.
        assembly: goals and steps.
        balance: see AssignmentProblem.

    Raises:
        InfeasibleStepError: a part would hang in the air, or goes where something is.
    """
    world = PartWorld(cell, assembly)
    world.require_standing(MOST_OVERLAP)
    search = _Search(world)
    for step in range(1, len(assembly.steps) + 1):
        for robot in cell.robots:
            search.add(step, robot)
    problem = AssignmentProblem(
        robots=tuple(robot.name for robot in cell.robots),
        steps=tuple(f"pick and place {name}" for name in assembly.steps),
        needs_support=(False,) * len(assembly.steps),
        primaries=tuple(search.primaries),
        supports=(),
        balance=balance,
        rejections=tuple(search.rejections),
    )
    return PickPlaceCandidates(world, problem, search.paths)


def held_pose(robot: PlacedRobot, frame: str, grip: Transform) -> Transform:
    """Return the pose of a part in the flange frame of the robot that holds it.

    Args:
        robot: who holds it.
        frame: name of the tool frame.
        grip: pose of that frame in the frame of the part.
    """
    tool = frame_in_flange(robot.model, frame)
    return readonly(tool @ inverse(grip))


def gripped(robot: str, part: str) -> Pairs:
    """Return the contact of a tool with the part it handles."""
    return frozenset({frozenset((entity(robot, "tool"), part))})


def touching(part: str, others: Mapping[str, float]) -> Pairs:
    """Return the contacts of a part with what it touches."""
    return frozenset(frozenset((part, other)) for other in others)


class _Search:
    """Gathers candidates of one step and robot after another."""

    def __init__(self, world: PartWorld) -> None:
        self.world = world
        self.primaries: list[PrimaryCandidate] = []
        self.rejections: list[Rejection] = []
        self.paths: dict[tuple[int, str, int], tuple[SkillPath, SkillPath]] = {}

    def add(self, step: int, robot: PlacedRobot) -> None:
        """Add the candidates of a step for one robot."""
        part, grips = self.world.part(step), self.world.grips(step)
        if not grips:
            self._reject(
                step,
                f"{robot.name} grips {part.name}",
                Obstruction("no face can be gripped both at its start and at its goal"),
            )
        options = _GripOptions(self.world, step, robot)
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
    """How one robot does one step with each of its grips.

    Most grips are checked in the same few scenes: each collision checker is made once.
    """

    def __init__(self, world: PartWorld, step: int, robot: PlacedRobot) -> None:
        self.world = world
        self.robot = robot
        self.part = world.part(step)
        self.goal = world.goal(step)
        self.held = gripped(robot.name, self.part.name)
        self._at_start = touching(self.part.name, world.at_start(step))
        self._at_goal = touching(self.part.name, world.at_goal(step))
        self._attachments = {
            name: attachment for name, (_, attachment) in world.around(step).items()
        }
        self._home: dict[str, Array] = {r.name: r.home for r in world.cell.robots}
        self._checkers: dict[tuple[bytes, Pairs], SceneChecker] = {}

    def pick(self, grip: Transform) -> SkillPath | Obstruction:
        """Return how the part is picked."""
        assembly = self.world.assembly
        targets = pick_targets(
            assembly.grips.frame,
            self.part.start @ grip,
            assembly.approach,
            assembly.leave,
        )
        contacts = SkillContacts(_NOTHING, self.held | self._at_start, self.held)
        lying = Attachment(None, self.part.start)
        return self._resolve(targets, contacts, lying, self._in_hand(grip))

    def place(self, grip: Transform) -> SkillPath | Obstruction:
        """Return how the part is put in its place."""
        assembly = self.world.assembly
        targets = place_targets(
            assembly.grips.frame, self.goal @ grip, assembly.approach, assembly.leave
        )
        contacts = SkillContacts(self.held, self.held | self._at_goal, _NOTHING)
        lying = Attachment(None, self.goal)
        return self._resolve(targets, contacts, self._in_hand(grip), lying)

    def at_home(self, grip: Transform) -> Obstruction | None:
        """Return what is in the way of standing at HOME with the part."""
        checker = self._checker(self._in_hand(grip), self.held)
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

        def checker_of(phase: Phase) -> SceneChecker:
            match phase:
                case Phase.BEFORE:
                    return self._checker(before, contacts.before)
                case Phase.UNTIL_CHANGE:
                    return self._checker(before, contacts.during)
                case Phase.SINCE_CHANGE:
                    return self._checker(after, contacts.during)
                case Phase.AFTER:
                    return self._checker(after, contacts.after)

        return resolve_skill(
            self.robot, targets, lambda path: check_skill(path, checker_of)
        )

    def _checker(self, part: Attachment, allowed: Pairs) -> SceneChecker:
        """Return the checker of a scene with the part where it is given."""
        key = (part.pose.tobytes(), allowed)
        if key not in self._checkers:
            attachments = {**self._attachments, self.part.name: part}
            self._checkers[key] = SceneChecker(
                self.world.cell,
                self.robot.name,
                WorldState(self._home, attachments),
                allowed,
                margin=MARGIN,
            )
        return self._checkers[key]

    def _in_hand(self, grip: Transform) -> Attachment:
        frame = self.world.assembly.grips.frame
        return Attachment(self.robot.name, held_pose(self.robot, frame, grip))

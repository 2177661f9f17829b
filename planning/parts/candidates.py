"""Candidates for the assignment of parts: each step with its robots and grips (APEX-MR App. B)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import product

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
from planning.parts.assembly import Grip, PartAssembly, box_grips
from planning.parts.contact_graph import near_to, standing
from planning.parts.targets import pick_targets, place_targets
from planning.skills.contacts import NOTHING, SkillContacts, gripped, touching
from planning.skills.joint_paths import Obstruction, SkillPath, joint_distance
from planning.skills.subgoals import SkillTargets
from planning.skills.surroundings import SkillScene, resolve_skill
from planning.tasks.assignment import AssignmentProblem, PrimaryCandidate, Rejection
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


def part_steps(cell: Workcell, assembly: PartAssembly) -> tuple[PartStep, ...]:
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
class PartCandidates:
    """The assignment problem of an assembly of parts, and the paths behind it.

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


def find_candidates(cell: Workcell, assembly: PartAssembly) -> PartCandidates:
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
    primaries: list[PrimaryCandidate] = []
    rejections: list[Rejection] = []
    paths: dict[tuple[int, str, int], tuple[SkillPath, SkillPath]] = {}
    for (number, step), robot in product(enumerate(steps, start=1), cell.robots):
        part, name = step.part.name, robot.name
        if not step.grips:
            reason = "no face can be gripped both at its start and at its goal"
            rejections.append(Rejection(number, f"{name} grips {part}", reason))
        for k, grip in enumerate(step.grips):
            found = _GripOption(cell, assembly, step, robot, grip.pose).paths()
            if isinstance(found[1], Obstruction):
                what = f"{name} {found[0]}, {grip.words}"
                rejections.append(Rejection(number, what, found[1].words))
                continue
            paths[number, name, k] = found
            cost = sum(joint_distance(robot.home, path.contact) for path in found)
            primaries.append(PrimaryCandidate(number, name, part, k, cost))
    problem = AssignmentProblem(
        robots=tuple(robot.name for robot in cell.robots),
        steps=tuple(f"pick and place {name}" for name in assembly.steps),
        needs_support=(False,) * len(assembly.steps),
        primaries=tuple(primaries),
        rejections=tuple(rejections),
    )
    return PartCandidates(cell, assembly.grips.frame, steps, problem, paths)


def held_pose(robot: PlacedRobot, frame: str, grip: Transform) -> Transform:
    """Return the pose of a part in the flange frame of the robot that holds it.

    Args:
        robot: who holds it.
        frame: name of the tool frame.
        grip: pose of that frame in the frame of the part.
    """
    tool = frame_in_flange(robot.model, frame)
    return readonly(tool @ inverse(grip))


@dataclass(frozen=True)
class _GripOption:
    """How one robot does one step with one of its grips, a pose in the frame of the part."""

    cell: Workcell
    assembly: PartAssembly
    step: PartStep
    robot: PlacedRobot
    grip: Transform

    def paths(self) -> tuple[SkillPath, SkillPath] | tuple[str, Obstruction]:
        """Return pick and place; or what cannot be done, and why."""
        step, part, name = self.step, self.step.part, self.step.part.name
        frame, held = self.assembly.grips.frame, gripped(self.robot.name, name)
        approach, leave = self.assembly.approach, self.assembly.leave
        in_hand = Attachment(self.robot.name, held_pose(self.robot, frame, self.grip))
        place = self._resolve(
            place_targets(frame, step.goal @ self.grip, approach, leave),
            SkillContacts(held, held | touching(name, step.at_goal), NOTHING),
            in_hand,
            Attachment(None, step.goal),
        )
        if isinstance(place, Obstruction):
            return "places", place
        pick = self._resolve(
            pick_targets(frame, part.start @ self.grip, approach, leave),
            SkillContacts(NOTHING, held | touching(name, step.at_start), held),
            Attachment(None, part.start),
            in_hand,
        )
        if isinstance(pick, Obstruction):
            return "picks", pick
        attachments = {k: at for k, (_, at) in step.around.items()} | {name: in_hand}
        state = WorldState(self._home, attachments)
        checker = SceneChecker(self.cell, self.robot.name, state, held, margin=MARGIN)
        contact = checker.contact(self.robot.home)
        return (
            (pick, place) if contact is None else ("at HOME", Obstruction(str(contact)))
        )

    def _resolve(
        self,
        targets: SkillTargets,
        contacts: SkillContacts,
        before: Attachment,
        after: Attachment,
    ) -> SkillPath | Obstruction:
        """Return a skill, given where the part is before and after it changes hands."""
        part = self.step.part
        objects = {**self.step.around, part.name: (part, before)}
        scene = SkillScene(self.cell, objects, self._home, contacts, (part.name, after))
        found = resolve_skill(self.robot, targets, scene)
        return found if isinstance(found, Obstruction) else found.path

    @property
    def _home(self) -> dict[str, Array]:
        return {robot.name: robot.home for robot in self.cell.robots}

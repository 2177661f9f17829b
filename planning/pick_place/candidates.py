"""Candidates for the assignment: who can put which part in place with which grip (App. B)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from planning.assignment_problem import AssignmentProblem, PrimaryCandidate, Rejection
from planning.geometry.scene import entity
from planning.pick_place.part_world import PartWorld
from planning.pick_place.structure import PickPlaceAssembly
from planning.pick_place.targets import pick_targets, place_targets
from planning.skill_paths import (
    Obstruction,
    Pairs,
    SkillContacts,
    SkillPath,
    SkillScene,
    find_obstruction,
    joint_distance,
    resolve_skill,
)
from planning.task_plan import StepChoice
from planning.transforms import Array, Transform, inverse, readonly
from planning.workcell import Attachment, PlacedRobot, Workcell

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
    tool = robot.model.frames[frame] if frame != "flange" else np.eye(4)
    return readonly(tool @ inverse(grip))


def gripped(robot: str, part: str) -> Pairs:
    """Return the contact of a tool with the part it handles."""
    return frozenset({frozenset((entity(robot, "tool"), part))})


def touching(part: str, others: Mapping[str, float]) -> Pairs:
    """Return the contacts of a part with what it touches."""
    return frozenset(frozenset((part, other)) for other in others)


class _Search:
    """Works out the paths of one step and robot after another."""

    def __init__(self, world: PartWorld) -> None:
        self.world = world
        self.primaries: list[PrimaryCandidate] = []
        self.rejections: list[Rejection] = []
        self.paths: dict[tuple[int, str, int], tuple[SkillPath, SkillPath]] = {}
        self._home: dict[str, Array] = {r.name: r.home for r in world.cell.robots}

    def add(self, step: int, robot: PlacedRobot) -> None:
        """Add the candidates of a step for one robot."""
        part = self.world.part(step)
        grips = self.world.grips(step)
        if not grips:
            self._reject(
                step,
                f"{robot.name} grips {part.name}",
                Obstruction("no face can be gripped both at its start and at its goal"),
            )
        for number, grip in enumerate(grips):
            place = self._place(step, robot, grip.pose)
            if isinstance(place, Obstruction):
                self._reject(step, f"{robot.name} places, {grip.words}", place)
                continue
            pick = self._pick(step, robot, grip.pose)
            if isinstance(pick, Obstruction):
                self._reject(step, f"{robot.name} picks, {grip.words}", pick)
                continue
            at_home = self._at_home(step, robot, grip.pose)
            if at_home is not None:
                self._reject(step, f"{robot.name} at HOME, {grip.words}", at_home)
                continue
            self.paths[step, robot.name, number] = (pick, place)
            cost = self._cost(pick) + self._cost(place)
            self.primaries.append(
                PrimaryCandidate(step, robot.name, part.name, number, cost)
            )

    def _pick(
        self, step: int, robot: PlacedRobot, grip: Transform
    ) -> SkillPath | Obstruction:
        assembly, part = self.world.assembly, self.world.part(step)
        held = gripped(robot.name, part.name)
        scene = SkillScene(
            self.world.cell,
            {
                **self.world.around(step),
                part.name: (part, Attachment(None, part.start)),
            },
            self._home,
            SkillContacts(
                _NOTHING, held | touching(part.name, self.world.at_start(step)), held
            ),
            (part.name, self._in_hand(robot, grip)),
        )
        targets = pick_targets(
            assembly.grips.frame, part.start @ grip, assembly.approach, assembly.leave
        )
        return resolve_skill(robot, targets, lambda p: find_obstruction(p, scene))

    def _place(
        self, step: int, robot: PlacedRobot, grip: Transform
    ) -> SkillPath | Obstruction:
        assembly, part = self.world.assembly, self.world.part(step)
        goal = self.world.goal(step)
        held = gripped(robot.name, part.name)
        scene = SkillScene(
            self.world.cell,
            {**self.world.around(step), part.name: (part, self._in_hand(robot, grip))},
            self._home,
            SkillContacts(
                held, held | touching(part.name, self.world.at_goal(step)), _NOTHING
            ),
            (part.name, Attachment(None, goal)),
        )
        targets = place_targets(
            assembly.grips.frame, goal @ grip, assembly.approach, assembly.leave
        )
        return resolve_skill(robot, targets, lambda p: find_obstruction(p, scene))

    def _at_home(
        self, step: int, robot: PlacedRobot, grip: Transform
    ) -> Obstruction | None:
        """Return what is in the way of standing at HOME with the part."""
        part = self.world.part(step)
        scene = SkillScene(
            self.world.cell,
            {**self.world.around(step), part.name: (part, self._in_hand(robot, grip))},
            self._home,
            SkillContacts(_NOTHING, _NOTHING, _NOTHING),
        )
        checker = scene.checker(robot.name, gripped(robot.name, part.name))
        contact = checker.contact(robot.home)
        return None if contact is None else Obstruction(str(contact))

    def _in_hand(self, robot: PlacedRobot, grip: Transform) -> Attachment:
        frame = self.world.assembly.grips.frame
        return Attachment(robot.name, held_pose(robot, frame, grip))

    def _cost(self, path: SkillPath) -> float:
        return joint_distance(self._home[path.robot], path.contact)

    def _reject(self, step: int, what: str, reason: Obstruction) -> None:
        self.rejections.append(Rejection(step, what, reason.words))

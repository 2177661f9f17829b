"""Skills of one robot on parts, as subgoals and as paths that nothing is in the way of."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from planning.cell.workcell import (
    Attachment,
    CellObject,
    PlacedRobot,
    Workcell,
    WorldState,
)
from planning.geometry.robot_bodies import entity
from planning.geometry.scene_checker import SceneChecker
from planning.kinematics.kinematics import frame_in_flange
from planning.motion.sequential import MARGIN
from planning.parts.assembly import DOWN, UP, Grip, PartAssembly, Process
from planning.parts.part_steps import Held, PartStep, WorkStep
from planning.parts.tool_grips import tool_misfit
from planning.steps.skill import (
    NOTHING,
    Obstruction,
    Phase,
    SkillContacts,
    SkillPath,
    SkillTargets,
    Subgoal,
    ToolContact,
    gripped,
    straight_way,
    touching,
)
from planning.steps.skill_scene import (
    SkillScene,
    find_obstruction,
    resolve_skill,
)
from planning.tasks.task import HOLD
from planning.transforms import (
    Array,
    Transform,
    inverse,
    readonly,
    rotation,
    translation,
)

Vector = tuple[float, float, float]

SMALL_STRIDE = 0.01
"""Longest straight way between two subgoals of a process, where the tool is at work [m]."""

SMALL_TURN = math.radians(5.0)
"""Most that the tool turns between two subgoals of such a path [rad]."""


def pick_targets(
    frame: str, grip: Transform, approach: float, leave: float, out: Vector = UP
) -> SkillTargets:
    """Return the subgoals of picking a part up: approach, attach, lift.

    Args:
        frame: name of the tool frame.
        grip: pose of that frame in the world where it grips the part.
        approach: length of the straight way along the tool before that [m].
        leave: length of the straight way out after it [m].
        out: direction of that way in the world, of length one.
    """
    back = grip @ translation(0.0, 0.0, -approach)
    lifted = _moved(grip, out, leave)
    return _in_and_out("pick", frame, grip, ("approach", back), ("lift", lifted))


def place_targets(
    frame: str, grip: Transform, approach: float, leave: float, into: Vector = DOWN
) -> SkillTargets:
    """Return the subgoals of putting a part in place: above, detach, leave.

    Args:
        frame: name of the tool frame.
        grip: pose of that frame in the world where the part is in its place.
        approach: length of the straight way into its place before that [m].
        leave: length of the straight way back along the tool after it [m].
        into: direction of the way into its place in the world, of length one.
    """
    back = grip @ translation(0.0, 0.0, -leave)
    above = _moved(grip, into, -approach)
    return _in_and_out("place-down", frame, grip, ("above", above), ("leave", back))


def hold_targets(frame: str, grip: Transform, approach: float) -> SkillTargets:
    """Return the subgoals of gripping a part where it lies: approach, hold.

    Args:
        frame: name of the tool frame.
        grip: pose of that frame in the world where it grips the part.
        approach: length of the straight way along the tool before that [m].
    """
    back = grip @ translation(0.0, 0.0, -approach)
    subgoals = [
        *straight_way(frame, "approach", back, grip),
        Subgoal(HOLD, frame, grip),
    ]
    return SkillTargets(HOLD, tuple(subgoals))


@dataclass(frozen=True)
class ProcessTargets:
    """One execution of a process as poses to reach, and which of them are the process itself.

    Attributes:
        targets: approach, process and the way back.
        first, last: indices of the subgoals at which the process begins and ends.
    """

    targets: SkillTargets
    first: int
    last: int


def process_targets(process: Process, place: Transform, turn: float) -> ProcessTargets:
    """Return the subgoals of a process: approach, its path, back.

    Args:
        process: what is done.
        place: pose in the world of the frame at which it is done, z out of the surface.
        turn: of the tool about that axis [rad].
    """
    frame, name = process.frame, process.name
    facing = rotation("z", turn) @ rotation("x", np.pi)
    poses = [place @ at @ facing for at in process.path or (np.eye(4),)]
    back = translation(0.0, 0.0, -process.approach)
    way = [Subgoal(name, frame, pose) for pose in _along(poses)]
    approach = straight_way(frame, "approach", poses[0] @ back, poses[0])
    leave = straight_way(frame, "leave", poses[-1] @ back, poses[-1])[::-1]
    first, last = len(approach), len(approach) + len(way) - 1
    subgoals = (*approach, *way, *leave)
    return ProcessTargets(SkillTargets(name, subgoals), first, last)


def _along(poses: Sequence[Transform]) -> list[Transform]:
    """Return poses on the straight lines through some poses, ends included, in small steps."""
    out = [poses[0]]
    for near, far in pairwise(poses):
        turn = Rotation.from_matrix(near[:3, :3].T @ far[:3, :3]).as_rotvec()
        way = far[:3, 3] - near[:3, 3]
        steps = max(
            np.linalg.norm(way) / SMALL_STRIDE, np.linalg.norm(turn) / SMALL_TURN
        )
        count = max(1, math.ceil(float(steps) - 1e-9))
        for k in range(1, count + 1):
            pose = near.copy()
            pose[:3, :3] = (
                near[:3, :3] @ Rotation.from_rotvec(turn * k / count).as_matrix()
            )
            pose[:3, 3] += way * k / count
            out.append(pose)
    return out


def handover_targets(
    frame: str, grip: Transform, coming: Array, leave: float
) -> SkillTargets:
    """Return the subgoals of handing a part over: in between open fingers, let go, back.

    Args:
        frame: name of the giver's tool frame.
        grip: pose of that frame in the world where the part changes hands.
        coming: straight way on which it brings the part there, shape (3,) [m].
        leave: length of the straight way back along its tool after it [m].
    """
    before = grip.copy()
    before[:3, 3] -= coming
    back = grip @ translation(0.0, 0.0, -leave)
    return _in_and_out("handover", frame, grip, ("bring", before), ("leave", back))


def _in_and_out(
    kind: str,
    frame: str,
    grip: Transform,
    come: tuple[str, Transform],
    go: tuple[str, Transform],
) -> SkillTargets:
    """Return the subgoals of going straight to a grip, where the part changes hands, and away.

    ``come`` and ``go`` are what the two ways are called, and where they begin and end.
    """
    way_in = straight_way(frame, *come, grip)
    way_out = straight_way(frame, *go, grip)[::-1]
    subgoals = (*way_in, Subgoal("attach", frame, grip), *way_out)
    return SkillTargets(kind, subgoals, change_at=len(way_in))


def _moved(pose: Transform, direction: Vector, way: float) -> Transform:
    out = pose.copy()
    out[:3, 3] += way * np.asarray(direction)
    return out


PRESSED = 0.003
"""Deepest that the tool of a process may be in what it works at [m]."""


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
class PartSkills:
    """Skills in one cell, with all other robots at HOME but for those that hold something.

    Attributes:
        cell: robots and fixtures.
        assembly: grips, approaches and ways back.
        holding: configurations of the robots that hold something.
    """

    cell: Workcell
    assembly: PartAssembly
    holding: Mapping[str, Array] = field(default_factory=dict)

    def misfit(
        self, robot: PlacedRobot, part: CellObject, grip: Grip
    ) -> Obstruction | None:
        """Return why a robot's tool cannot hold a part by a grip, None where it can."""
        approach = self.assembly.handling(part.name).approach
        return tool_misfit(robot, self._frame, part, grip, approach)

    def pick(
        self,
        robot: PlacedRobot,
        step: PartStep,
        grip: Transform,
        known: SkillPath | None = None,
    ) -> SkillPath | Obstruction:
        """Return the pick of a step by a grip; one that is known, where it is free.

        Grips are poses of the tool in the frame of the part.
        """
        start, ways = step.part.start, self.assembly.handling(step.part.name)
        targets = pick_targets(
            self._frame, start @ grip, ways.approach, ways.leave, ways.extraction
        )
        changes = Attachment(None, start), self._in_hand(robot, grip)
        found = self._handle(robot, step, targets, changes, step.at_start, known)
        return _with_remedy(found, ways.approach, ways.leave)

    def place(
        self,
        robot: PlacedRobot,
        step: PartStep,
        grip: Transform,
        known: SkillPath | None = None,
    ) -> SkillPath | Obstruction:
        """Return the place-down of a step by a grip; one that is known, where it is free."""
        ways = self.assembly.handling(step.part.name)
        targets = place_targets(
            self._frame, step.goal @ grip, ways.approach, ways.leave, ways.insertion
        )
        changes = self._in_hand(robot, grip), Attachment(None, step.goal)
        found = self._handle(robot, step, targets, changes, step.at_goal, known)
        return _with_remedy(found, ways.approach, ways.leave)

    def carried_home(
        self, robot: PlacedRobot, step: PartStep, grip: Transform
    ) -> Obstruction | None:
        """Return what is in the way of a robot that stands at HOME with a part."""
        name = step.part.name
        attachments = {k: at for k, (_, at) in step.around.items()}
        attachments[name] = self._in_hand(robot, grip)
        state = WorldState(self._configurations, attachments)
        held = gripped(robot.name, name)
        checker = SceneChecker(self.cell, robot.name, state, held, margin=MARGIN)
        contact = checker.contact(robot.home)
        if contact is None:
            return None
        return Obstruction(str(contact), contact.second.split(":")[0])

    def in_door(self, door: str) -> str | None:
        """Return the first robot that stands in a door when it is at HOME, None for none."""
        leaf = Attachment(None, self.cell.object(door).start)
        state = WorldState(self._configurations, {door: leaf})
        for robot in self.cell.robots:
            alone = replace(self.cell, robots=(robot,), fixtures=())
            checker = SceneChecker(alone, robot.name, state, NOTHING, margin=MARGIN)
            if checker.contact(robot.home) is not None:
                return robot.name
        return None

    def hold(
        self,
        robot: PlacedRobot,
        step: PartStep | WorkStep,
        held: Held,
        grip: Transform,
        known: SkillPath | None = None,
    ) -> SkillPath | Obstruction:
        """Return how a robot grips a part where it lies; as is known, where that is free."""
        part = held.part.name
        at_part = gripped(robot.name, part)
        targets = hold_targets(
            self._frame,
            held.pose @ grip,
            self.assembly.handling(part).approach,
        )
        contacts = SkillContacts(NOTHING, at_part, at_part)
        scene = SkillScene(self.cell, step.around, self._configurations, contacts)
        found = _free_path(robot, targets, scene, known)
        return _with_remedy(found, self.assembly.handling(part).approach)

    def work(
        self,
        robot: PlacedRobot,
        step: WorkStep,
        turn: float,
        known: SkillPath | None = None,
    ) -> SkillPath | Obstruction:
        """Return a process with its approach and way back; a known one, where it is free."""
        targets = process_targets(step.step.process, step.place, turn).targets
        touches = touching(entity(robot.name, "tool"), step.touched)
        scene = SkillScene(
            self.cell,
            step.around,
            self._configurations,
            SkillContacts(NOTHING, touches, NOTHING),
            tool=ToolContact(0.0, PRESSED),
        )
        found = _free_path(robot, targets, scene, known)
        return _with_remedy(found, step.step.process.approach)

    def _handle(
        self,
        robot: PlacedRobot,
        step: PartStep,
        targets: SkillTargets,
        changes: tuple[Attachment, Attachment],
        touched: Iterable[str],
        known: SkillPath | None,
    ) -> SkillPath | Obstruction:
        """Return a skill, given where the part is before and after it, and what it touches at rest."""
        part, (first, then) = step.part, changes
        held = gripped(robot.name, part.name)
        scene = SkillScene(
            self.cell,
            {**step.around, part.name: (part, first)},
            self._configurations,
            SkillContacts(
                NOTHING if first.holder is None else held,
                held | touching(part.name, touched),
                NOTHING if then.holder is None else held,
            ),
            (part.name, then),
        )
        return _free_path(robot, targets, scene, known)

    def _in_hand(self, robot: PlacedRobot, grip: Transform) -> Attachment:
        return Attachment(robot.name, held_pose(robot, self._frame, grip))

    @property
    def _frame(self) -> str:
        return self.assembly.grips.frame

    @property
    def _configurations(self) -> dict[str, Array]:
        home = {robot.name: robot.home for robot in self.cell.robots}
        return {**home, **self.holding}


def _with_remedy(
    found: SkillPath | Obstruction, approach: float, leave: float | None = None
) -> SkillPath | Obstruction:
    """Return what was found; of what is in the way at an end of a straight way, what could help.

    Args:
        found: a path, or what is in its way.
        approach, leave: lengths of the straight ways before and after [m].
    """
    if not isinstance(found, Obstruction):
        return found
    if found.phase is Phase.BEFORE:
        key, end, length = "approach_m", "begins", approach
    elif found.phase is Phase.AFTER and leave is not None:
        key, end, length = "leave_m", "ends", leave
    else:
        return found
    return replace(
        found,
        words=f"{found.words}, where the straight way {end}, {1e3 * length:g} mm away: if that is too"
        f" short to be clear of what is around, {key} makes it longer",
    )


def _free_path(
    robot: PlacedRobot,
    targets: SkillTargets,
    scene: SkillScene,
    known: SkillPath | None,
) -> SkillPath | Obstruction:
    """Return a skill that is free in a scene, a known one where that is."""
    if known is not None and find_obstruction(known, scene) is None:
        return known
    found = resolve_skill(robot, targets, scene)
    if isinstance(found, Obstruction):
        return found
    if found.touched:
        grazed = min(found.touched)
        return Obstruction(f"the tool comes too near to {grazed}", grazed)
    return found.path

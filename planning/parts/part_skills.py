"""Skills of one robot on parts, as subgoals and as collision-free paths."""

from __future__ import annotations

import math
import operator
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise, product

import numpy as np
from scipy.spatial.transform import Rotation

from planning.cell.workcell import (
    Attachment,
    CellObject,
    PlacedRobot,
    Workcell,
    WorldState,
)
from planning.geometry.exact import resting_solid
from planning.geometry.robot_bodies import entity_name, robot_bodies
from planning.geometry.scene_checker import BodyPair, SceneChecker
from planning.grips.fingers import finger_obstacles
from planning.grips.grip import Grip
from planning.grips.tool_grips import describe_missed_contact, explain_tool_misfit
from planning.handling.skill_contacts import (
    NOTHING,
    SkillContacts,
    ToolContact,
    grip_contact,
)
from planning.handling.skill_scene import SkillScene
from planning.handling.skill_targets import SkillTargets, Subgoal, straight_subgoals
from planning.handling.skill_trial import find_obstruction, resolve_skill
from planning.handling.tool_changes import with_each_tool, with_tools
from planning.motion.sequential import MARGIN
from planning.parts.assembly import PartAssembly, PartHandling, Process
from planning.parts.part_steps import KnownStep, PartStep
from planning.steps.skill import Obstruction, Phase, SkillPath, contacts_with
from planning.tasks.assignment import Tools
from planning.tasks.task import TaskKind
from planning.transforms import (
    Array,
    Transform,
    inverse,
    read_only_copy,
    rotation,
    translation,
)

SMALL_STRIDE = 0.01
"""Longest straight path between two subgoals of a process, where the tool is at work [m]."""

SMALL_TURN = math.radians(5.0)
"""Most that the tool turns between two subgoals of such a path [rad]."""

PRESSED = 0.003
"""Allowed penetration of a process tool into its workpiece [m]."""


def pick_targets(frame: str, grip: Transform, handling: PartHandling) -> SkillTargets:
    """Return the subgoals of picking a part up: approach, attach, lift.

    Args:
        frame: name of the tool frame.
        grip: pose of that frame in the world where it grips the part.
        handling: straight displacements to the part along the tool, and out with it.
    """
    back, lifted = grip @ translation(0.0, 0.0, -handling.approach), grip.copy()
    lifted[:3, 3] += handling.leave * np.asarray(handling.extraction)
    return _approach_and_leave(
        "pick", frame, grip, ("approach", back), ("lift", lifted)
    )


def place_targets(frame: str, grip: Transform, handling: PartHandling) -> SkillTargets:
    """Return the subgoals of putting a part in place: above, detach, leave.

    Args:
        frame: name of the tool frame.
        grip: pose of that frame in the world where the part is in its place.
        handling: straight displacements into its place, and back from it along the tool.
    """
    above, back = grip.copy(), grip @ translation(0.0, 0.0, -handling.leave)
    above[:3, 3] += -handling.approach * np.asarray(handling.insertion)
    return _approach_and_leave(
        "place-down", frame, grip, ("above", above), ("leave", back)
    )


def _hold_targets(frame: str, grip: Transform, handling: PartHandling) -> SkillTargets:
    """Return the subgoals of gripping a part at rest: straight to it, hold."""
    back = grip @ translation(0.0, 0.0, -handling.approach)
    path = straight_subgoals(frame, "approach", back, grip)
    return SkillTargets(TaskKind.HOLD, (*path, Subgoal(TaskKind.HOLD, frame, grip)))


@dataclass(frozen=True)
class ProcessTargets:
    """Poses of one execution of a process, and which of them are the process proper.

    Attributes:
        targets: approach, process and the retreat.
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
    path = [Subgoal(name, frame, pose) for pose in _along(poses)]
    approach = straight_subgoals(frame, "approach", poses[0] @ back, poses[0])
    leave = straight_subgoals(frame, "leave", poses[-1] @ back, poses[-1])[::-1]
    first, last = len(approach), len(approach) + len(path) - 1
    subgoals = (*approach, *path, *leave)
    return ProcessTargets(SkillTargets(name, subgoals), first, last)


def _along(poses: Sequence[Transform]) -> list[Transform]:
    """Return poses on the straight lines through some poses, ends included, in small steps."""
    out = [poses[0]]
    for near, far in pairwise(poses):
        turn = Rotation.from_matrix(near[:3, :3].T @ far[:3, :3]).as_rotvec()
        path = far[:3, 3] - near[:3, 3]
        steps = max(
            np.linalg.norm(path) / SMALL_STRIDE, np.linalg.norm(turn) / SMALL_TURN
        )
        count = max(1, math.ceil(float(steps) - 1e-9))
        for k in range(1, count + 1):
            pose = near.copy()
            pose[:3, :3] = (
                near[:3, :3] @ Rotation.from_rotvec(turn * k / count).as_matrix()
            )
            pose[:3, 3] += path * k / count
            out.append(pose)
    return out


def handover_targets(
    frame: str, grip: Transform, coming: Array, leave: float
) -> SkillTargets:
    """Return the subgoals of handing a part over: between open fingers, release, retreat.

    Args:
        frame: name of the giver's tool frame.
        grip: pose of that frame in the world where the part changes hands.
        coming: straight path on which it brings the part there, shape (3,) [m].
        leave: length of the straight path back along its tool after it [m].
    """
    before = grip.copy()
    before[:3, 3] -= coming
    back = grip @ translation(0.0, 0.0, -leave)
    return _approach_and_leave(
        "handover", frame, grip, ("bring", before), ("leave", back)
    )


def _approach_and_leave(
    kind: str,
    frame: str,
    grip: Transform,
    come: tuple[str, Transform],
    go: tuple[str, Transform],
) -> SkillTargets:
    """Return the subgoals of going straight to a grip, the change of hands, and straight back.

    ``come`` and ``go`` are what the two ways are called, and where they begin and end.
    """
    way_in = straight_subgoals(frame, *come, grip)
    way_out = straight_subgoals(frame, *go, grip)[::-1]
    subgoals = (*way_in, Subgoal("attach", frame, grip), *way_out)
    return SkillTargets(kind, subgoals, change_at=len(way_in))


def held_pose(robot: PlacedRobot, frame: str, grip: Transform) -> Transform:
    """Return the pose of a part in the flange frame of the robot that holds it.

    Args:
        robot: the robot that holds it.
        frame: name of the tool frame.
        grip: pose of that frame in the frame of the part.
    """
    tool = robot.model.frame_in_flange(frame)
    return read_only_copy(tool @ inverse(grip))


@dataclass(frozen=True)
class SkillTry:
    """A skill that a robot tries in a scene.

    Attributes:
        robot: the robot.
        targets: poses to reach in order.
        scene: of the skill.
        approach, leave: lengths of the straight paths before and after; None for none [m].
        held: the part that its fingers close on or open from, and the pose of the tool frame in
            the part's; None for no part.
    """

    robot: PlacedRobot
    targets: SkillTargets
    scene: SkillScene
    approach: float
    leave: float | None = None
    held: tuple[CellObject, Transform] | None = None

    def found(self, known: SkillPath | None = None) -> SkillPath | Obstruction:
        """Return the skill in a free posture; a cached one where that is free."""
        if known is not None and find_obstruction(known, self.scene) is None:
            return known
        found = resolve_skill(self.robot, [self.targets], self.scene)
        if isinstance(found, Obstruction):
            return self._with_remedy(found)
        if found.touched:
            grazed = min(found.touched)
            return Obstruction(f"the tool comes too near to {grazed}", grazed)
        return self._closing(found.path) or found.path

    def _closing(self, path: SkillPath) -> Obstruction | None:
        """Return the obstacle of the fingers as they grip or release the part."""
        if self.held is None:
            return None
        scene, frame = self.scene, self.targets.subgoals[0].frame
        state = WorldState(
            scene.configurations, {k: at for k, (_, at) in scene.objects.items()}
        )
        around = scene.cell, state, scene.contacts.during
        return finger_obstacles(self.robot, frame, self.held, path.contact, around)

    def carried_home(self) -> Obstruction | None:
        """Return the obstacle of a robot that stands at HOME with the part it has taken."""
        assert self.scene.handed is not None
        name, in_hand = self.scene.handed
        places = {k: at for k, (_, at) in self.scene.objects.items()}
        state = WorldState(self.scene.configurations, {**places, name: in_hand})
        allowed = self.scene.contacts.after
        checker = SceneChecker(
            self.scene.cell, self.robot.name, state, allowed, margin=MARGIN
        )
        contact = checker.contact(self.robot.home)
        if contact is None:
            return None
        return Obstruction(str(contact), contact.obstacle, moving=contact.moving)

    def _with_remedy(self, found: Obstruction) -> Obstruction:
        """Return the obstruction; at an end of a straight path, with a possible remedy."""
        if found.phase is Phase.BEFORE:
            key, end, length = "approach_m", "begins", self.approach
        elif found.phase is Phase.AFTER and self.leave is not None:
            key, end, length = "leave_m", "ends", self.leave
        else:
            return found
        return replace(
            found,
            words=f"{found.words}, where the straight way {end}, {1e3 * length:g} mm away: if that is too"
            f" short to be clear of what is around, {key} makes it longer",
        )


@dataclass(frozen=True)
class PartSkills:
    """Skills in one cell, with all other robots at HOME.

    Grips are poses of the tool in the frame of the part.

    Attributes:
        cell: robots and fixtures.
        assembly: grips, approaches and retreats.
    """

    cell: Workcell
    assembly: PartAssembly

    def misfit(
        self, robot: PlacedRobot, part: CellObject, grip: Grip
    ) -> Obstruction | None:
        """Return why a robot's tool cannot hold a part by a grip, None where it can."""
        handling = self.assembly.handling(part.name)
        frame = self.assembly.frame
        if wrong := explain_tool_misfit(robot, frame, part, grip, handling.approach):
            return wrong
        words = describe_missed_contact(robot, part, grip, handling.grips)
        return None if words is None else Obstruction(words)

    def pick(self, robot: PlacedRobot, step: PartStep, grip: Transform) -> SkillTry:
        """Return the pick of a step by a grip."""
        lying, handling = step.part.start, self.assembly.handling(step.part.name)
        targets = pick_targets(self.assembly.frame, lying @ grip, handling)
        changes = Attachment(None, lying), self._in_hand(robot, grip)
        return self._handling(robot, step, (targets, grip), changes, step.at_start)

    def place(self, robot: PlacedRobot, step: PartStep, grip: Transform) -> SkillTry:
        """Return the place-down of a step by a grip."""
        handling = self.assembly.handling(step.part.name)
        targets = place_targets(self.assembly.frame, step.place @ grip, handling)
        changes = self._in_hand(robot, grip), Attachment(None, step.place)
        return self._handling(robot, step, (targets, grip), changes, step.touched)

    def hold(self, robot: PlacedRobot, step: KnownStep, grip: Transform) -> SkillTry:
        """Return the grip of a robot on the part held in a step, at rest."""
        assert step.held is not None
        name = step.held.part.name
        at_part, handling = grip_contact(robot.name, name), self.assembly.handling(name)
        targets = _hold_targets(self.assembly.frame, step.held.pose @ grip, handling)
        contacts = SkillContacts(NOTHING, at_part, at_part)
        scene = SkillScene(self.cell, step.around, self._at_home, contacts)
        held = step.held.part, grip
        return SkillTry(robot, targets, scene, handling.approach, held=held)

    def work(
        self, robot: PlacedRobot, step: KnownStep, process: Process, turn: float
    ) -> SkillTry:
        """Return a process with its approach and retreat, at a tool rotation [rad]."""
        targets = process_targets(process, step.place, turn).targets
        touches = contacts_with(entity_name(robot.name, "tool"), step.touched)
        scene = SkillScene(
            self.cell,
            step.around,
            self._at_home,
            SkillContacts(NOTHING, touches, NOTHING),
            tool=ToolContact(0.0, PRESSED),
        )
        return SkillTry(robot, targets, scene, process.approach)

    def with_standing_robots(
        self, known: SkillTry, standing: Mapping[str, Array]
    ) -> SkillTry:
        """Return a skill trial in this cell, with some robots at given configurations, shape (n,) each."""
        at = {**self._at_home, **standing}
        scene = replace(known.scene, cell=self.cell, configurations=at)
        return replace(known, robot=self.cell.robot(known.robot.name), scene=scene)

    def in_door(self, door: str) -> str | None:
        """Return the first robot that stands in a doorway at HOME, and its tool; None for none.

        A robot that changes tools is looked at with each of them on its flange.
        """
        leaf, limit = self.cell.object(door), self.cell.clearances.robot_object + MARGIN
        pieces = [resting_solid(door, own, leaf.start) for own in leaf.shape.pieces]
        for robot in with_each_tool(self.cell.robots):
            for mine, other in product(robot_bodies(robot).solids, pieces):
                pair = BodyPair(mine, other, limit, together=False)
                if operator.lt(*pair.gap_at(robot.home)):
                    return (
                        f"{robot.name} with {robot.tool}" if robot.tools else robot.name
                    )
        return None

    def _handling(
        self,
        robot: PlacedRobot,
        step: PartStep,
        gripping: tuple[SkillTargets, Transform],
        changes: tuple[Attachment, Attachment],
        touched: Iterable[str],
    ) -> SkillTry:
        """Return a skill by a grip, given the part's place before and after, and its contacts at rest."""
        part, (first, then), (targets, grip) = step.part, changes, gripping
        held, handling = (
            grip_contact(robot.name, part.name),
            self.assembly.handling(part.name),
        )
        scene = SkillScene(
            self.cell,
            {**step.around, part.name: (part, first)},
            self._at_home,
            SkillContacts(
                NOTHING if first.holder is None else held,
                held | contacts_with(part.name, touched),
                NOTHING if then.holder is None else held,
            ),
            (part.name, then),
        )
        ends = handling.approach, handling.leave
        return SkillTry(robot, targets, scene, *ends, (part, grip))

    def _in_hand(self, robot: PlacedRobot, grip: Transform) -> Attachment:
        return Attachment(robot.name, held_pose(robot, self.assembly.frame, grip))

    @property
    def _at_home(self) -> dict[str, Array]:
        return {robot.name: robot.home for robot in self.cell.robots}


@dataclass
class ToolSkills:
    """Skills in one cell by mounted tools; a class because closures cannot be pickled.

    Attributes:
        cell: robots and fixtures.
        assembly: grips, approaches and retreats.
    """

    cell: Workcell
    assembly: PartAssembly
    _known: dict[Tools, PartSkills] = field(default_factory=dict)

    def __call__(self, tools: Tools) -> PartSkills:
        """Return the skills with some tools mounted."""
        if tools not in self._known:
            cell = with_tools(self.cell, tools)
            self._known[tools] = PartSkills(cell, self.assembly)
        return self._known[tools]

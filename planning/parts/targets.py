"""Pick, place-down, hold and processes as sequences of subgoals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from planning.parts.assembly import DOWN, UP
from planning.parts.steps import Process
from planning.skills.subgoals import SkillTargets, Subgoal, straight_way
from planning.tasks.task import HOLD
from planning.transforms import Array, Transform, rotation, translation

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

"""Motions of skills: straight tool paths to the contact with a part, and away from it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from planning.cell.workcell import PlacedRobot
from planning.kinematics.kinematics import follow_poses, frame_pose
from planning.transforms import Array, Transform, read_only_copy

SPACING = 0.025
"""Distance between consecutive tool poses on a straight path [m]."""

_LARGEST_JOINT_STEP = 0.35
"""Largest joint motion between consecutive tool poses; a larger one changes the arm posture [rad or m]."""


@dataclass(frozen=True)
class SkillMotion:
    """Motion of a robot in a skill.

    Attributes:
        robot: the robot.
        path: waypoints, shape (w, n): in, touch, out.
        touch: waypoint at which the part changes hands.
        time: of the waypoints from the start of the skill on, shape (w,) [s].
    """

    robot: str
    path: Array
    touch: int
    time: Array

    @property
    def seconds(self) -> float:
        """Duration of the skill [s]."""
        return float(self.time[-1])

    @property
    def before(self) -> Array:
        """The approach, up to and including the touch."""
        return self.path[: self.touch + 1]

    @property
    def after(self) -> Array:
        """The retreat, from the touch on."""
        return self.path[self.touch :]

    def kept(self) -> SkillMotion:
        """Return the motion up to the touch, with the same duration and a final hold there."""
        time = np.append(self.time[: self.touch], self.seconds)
        return replace(self, path=self.before, time=time)


def skill_motion(
    robot: PlacedRobot,
    frame: str,
    touch: Array,
    displacements: tuple[Array, Array],
    velocity: Array,
    seconds: float,
) -> SkillMotion | None:
    """Return the motion of a skill around a touch, None where the arm cannot follow the straight lines.

    Args:
        robot: the robot.
        frame: its tool frame.
        touch: configuration at the touch, shape (n,).
        displacements: displacements in the world from where the tool comes to the touch, and from the touch
            to where it goes, each of shape (3,) [m].
        velocity: joint speed limits, shape (n,).
        seconds: nominal duration of the skill; longer where the joint speeds require it [s].
    """
    at = frame_pose(robot, touch, frame)
    into = follow_straight_line(robot, frame, at, touch, -displacements[0])
    out = follow_straight_line(robot, frame, at, touch, displacements[1])
    if into is None or out is None:
        return None
    path = np.vstack([into[::-1], out[1:]])
    moving = np.max(np.abs(np.diff(path, axis=0)) / velocity, axis=1)
    stand = max(seconds - float(moving.sum()), 0.0)
    k = len(into) - 1
    # The stand is a waypoint twice: the part changes hands at its end.
    path = np.insert(path, k, path[k], axis=0)
    time = np.concatenate([[0.0], np.cumsum(np.insert(moving, k, stand))])
    return SkillMotion(robot.name, read_only_copy(path), k + 1, read_only_copy(time))


def follow_straight_line(
    robot: PlacedRobot, frame: str, at: Transform, q: Array, displacement: Array
) -> Array | None:
    """Return configurations along a straight tool displacement, shape (k + 1, n), ``q`` first."""
    count = max(int(np.ceil(float(np.linalg.norm(displacement)) / SPACING - 1e-9)), 1)
    targets = np.repeat(np.asarray(at)[None], count + 1, axis=0)
    targets[:, :3, 3] += np.linspace(0.0, 1.0, count + 1)[:, None] * displacement
    found = list(follow_poses(robot, [frame] * (count + 1), targets, q, restarts=0))
    if found[-1] is None:
        return None
    chain = np.array([q, *found])
    return (
        None if np.max(np.abs(np.diff(chain, axis=0))) > _LARGEST_JOINT_STEP else chain
    )

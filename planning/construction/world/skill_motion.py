"""The motion of a skill: straight in until the pad touches, a stand, and straight out again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planning.cell.workcell import PlacedRobot
from planning.kinematics.chain import joint_table
from planning.kinematics.damped_least_squares import follow_targets
from planning.kinematics.kinematics import frame_in_last_joint, frame_pose
from planning.transforms import Array, Transform, inverse, readonly

SPACING = 0.025
"""Distance of the tool poses on a straight way [m]."""

_BEND = 0.35
"""Most that a joint moves between two of them; more is another posture [rad or m]."""


@dataclass(frozen=True)
class SkillMotion:
    """Motion of a robot in a skill.

    Attributes:
        robot: who does it.
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
        """The way in, the touch included."""
        return self.path[: self.touch + 1]

    @property
    def after(self) -> Array:
        """The way out, from the touch on."""
        return self.path[self.touch :]


def skill_motion(
    robot: PlacedRobot,
    frame: str,
    touch: Array,
    ways: tuple[Array, Array],
    velocity: Array,
    seconds: float,
) -> SkillMotion | None:
    """Return the motion of a skill around a touch, None where an arm cannot follow the ways.

    Args:
        robot: who does it.
        frame: its tool frame.
        touch: configuration at the touch, shape (n,).
        ways: vectors in the world from where the tool comes to the touch, and from the touch
            to where it goes, each of shape (3,) [m].
        velocity: joint speed limits, shape (n,).
        seconds: nominal duration of the skill; more where the joints need more for the ways [s].
    """
    at = frame_pose(robot, touch, frame)
    into = _follow(robot, frame, at, touch, -ways[0])
    out = _follow(robot, frame, at, touch, ways[1])
    if into is None or out is None:
        return None
    path = np.vstack([into[::-1], out[1:]])
    moving = np.max(np.abs(np.diff(path, axis=0)) / velocity, axis=1)
    stand = max(seconds - float(moving.sum()), 0.0)
    k = len(into) - 1
    # The stand is a waypoint twice: the part changes hands at its end.
    path = np.insert(path, k, path[k], axis=0)
    time = np.concatenate([[0.0], np.cumsum(np.insert(moving, k, stand))])
    return SkillMotion(robot.name, readonly(path), k + 1, readonly(time))


def _follow(
    robot: PlacedRobot, frame: str, at: Transform, q: Array, way: Array
) -> Array | None:
    """Return configurations along a straight way of the tool, shape (k + 1, n), ``q`` first."""
    count = max(int(np.ceil(float(np.linalg.norm(way)) / SPACING - 1e-9)), 1)
    targets = np.repeat(np.asarray(at)[None], count + 1, axis=0)
    targets[:, :3, 3] += np.linspace(0.0, 1.0, count + 1)[:, None] * way
    model = robot.model
    chain = np.empty((count + 1, model.dof))
    chain[0] = q
    tip = np.ascontiguousarray(frame_in_last_joint(model, frame))
    done = follow_targets(
        joint_table(model),
        np.repeat(tip[None], count + 1, axis=0),
        np.ascontiguousarray(inverse(robot.base) @ targets),
        chain,
        1,
    )
    if done <= count or np.max(np.abs(np.diff(chain, axis=0))) > _BEND:
        return None
    return chain

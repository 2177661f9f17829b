"""Forward and inverse kinematics of placed robots.

Inverse kinematics runs compiled damped least squares from the seed and from random restarts.
"""

from __future__ import annotations

import numpy as np

from planning.errors import RobotModelError
from planning.geometry.chain import joint_poses
from planning.geometry.damped_least_squares import TOLERANCE, solve_from
from planning.robots.model import RobotModel
from planning.transforms import Array, Transform, inverse
from planning.workcell import PlacedRobot

__all__ = ["TOLERANCE", "frame_in_last_joint", "frame_pose", "inverse_kinematics"]


def frame_pose(robot: PlacedRobot, q: Array, frame: str = "flange") -> Transform:
    """Return the world pose of the flange or of a tool frame.

    Args:
        robot: robot and where it stands.
        q: configuration, shape (n,) [rad or m].
        frame: ``"flange"`` or a key of the model's frames.

    Raises:
        RobotModelError: the robot has no such frame.
    """
    chain = robot.model.chain
    poses = np.empty((robot.model.dof + 1, 4, 4))
    joint_poses(
        chain.placement,
        chain.axis,
        chain.prismatic,
        np.ascontiguousarray(robot.base, dtype=np.float64),
        np.ascontiguousarray(q, dtype=np.float64),
        poses,
    )
    return np.asarray(poses[-1] @ frame_in_last_joint(robot.model, frame))


def frame_in_last_joint(model: RobotModel, frame: str) -> Transform:
    """Return the pose of the flange or of a tool frame in the last joint's frame.

    Raises:
        RobotModelError: the robot has no such frame.
    """
    if frame == "flange":
        return model.flange
    if frame not in model.frames:
        raise RobotModelError(
            f"robot {model.name!r} has no frame {frame!r}",
            choices=("flange", *model.frames),
        )
    return np.asarray(model.flange @ model.frames[frame])


def inverse_kinematics(
    robot: PlacedRobot,
    frame: str,
    target: Transform,
    seed: Array,
    *,
    restarts: int = 40,
    rng_seed: int = 0,
) -> list[Array]:
    """Return the distinct configurations found that bring a frame to a target.

    A joint with a range over a full turn takes, of the equivalent values within its limits,
    the one nearest to the seed. A redundant arm has a continuum of solutions, of which every
    restart finds at most one.

    Args:
        robot: robot and where it stands.
        frame: ``"flange"`` or a key of the model's frames.
        target: wanted pose of the frame in the world.
        seed: configuration to stay near to, shape (n,) [rad or m].
        restarts: number of random starts after the seed itself.
        rng_seed: seed of the random starts; the same seed gives the same result.

    Returns:
        Configurations within the joint limits, each within TOLERANCE of the target, nearest
        to the seed (sum of absolute joint differences) first; empty when none was found.

    Raises:
        RobotModelError: the robot has no such frame.
    """
    model = robot.model
    tip = np.ascontiguousarray(frame_in_last_joint(model, frame))
    wanted = np.ascontiguousarray(inverse(robot.base) @ target)
    chain = model.chain
    starts = np.empty((restarts + 1, model.dof))
    starts[0] = np.clip(seed, model.lower, model.upper)
    starts[1:] = np.random.default_rng(rng_seed).uniform(
        model.lower, model.upper, (restarts, model.dof)
    )
    found = np.empty_like(starts)
    count = solve_from(
        chain.placement,
        chain.axis,
        chain.prismatic,
        tip,
        wanted,
        model.lower,
        model.upper,
        np.ascontiguousarray(seed, dtype=np.float64),
        starts,
        found,
    )
    solutions = found[:count]
    order = np.argsort(np.abs(solutions - seed).sum(axis=1), kind="stable")
    return [solutions[k].copy() for k in order]

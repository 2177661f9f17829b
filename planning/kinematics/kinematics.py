"""Forward and inverse kinematics of placed robots.

Inverse kinematics runs compiled damped least squares from a given configuration and from random restarts.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache

import numpy as np

from planning.caches import BoundedCache
from planning.cell.robot_model import RobotModel
from planning.cell.workcell import PlacedRobot
from planning.kinematics.chain import joint_table, placed_joints, pose_joints
from planning.kinematics.damped_least_squares import follow_targets, solve_from
from planning.transforms import Array, Transform, inverse

_SOLVED: BoundedCache[list[Array]] = BoundedCache(20_000)
"""Cache capacity: the same poses recur while candidates are searched."""

_RESTARTS = 20
"""Random seeds for a pose on a path, where the search from the previous configuration fails."""


def frame_pose(robot: PlacedRobot, q: Array, frame: str = "flange") -> Transform:
    """Return the world pose of the flange or of a tool frame.

    Args:
        robot: robot and where it stands.
        q: configuration, shape (n,) [rad or m].
        frame: ``"flange"`` or a key of the model's frames.

    Raises:
        RobotModelError: the robot has no such frame.
    """
    poses = joint_poses_of(robot, q)
    return np.asarray(poses[-1] @ robot.model.frame_in_last_joint(frame))


def joint_poses_of(robot: PlacedRobot, q: Array) -> Array:
    """Return the world poses of a robot's base and joints at ``q``, shape (n + 1, 4, 4)."""
    poses = np.empty((len(q) + 1, 4, 4))
    # A writable copy: numba recompiles for read-only arrays.
    pose_joints(placed_joints(robot), np.array(q, dtype=np.float64), poses)
    return poses


def inverse_kinematics(
    robot: PlacedRobot,
    frame: str,
    target: Transform,
    seed: Array,
    *,
    restarts: int = 40,
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
        restarts: number of random starts after the seed itself, always the same ones.

    Returns:
        Configurations within the joint limits, each within TOLERANCE of the target, nearest
        to the seed (sum of absolute joint differences) first; empty when none was found.

    Raises:
        RobotModelError: the robot has no such frame.
    """
    seed = np.asarray(seed, dtype=np.float64)
    key = (
        robot.model,
        robot.base.tobytes(),
        frame,
        target.tobytes(),
        seed.tobytes(),
        restarts,
    )
    found = _SOLVED.get(key, lambda: _solve(robot, frame, target, seed, restarts))
    return [solution.copy() for solution in found]


def follow_poses(
    robot: PlacedRobot,
    frames: Sequence[str],
    targets: Sequence[Transform] | Array,
    start: Array,
    *,
    restarts: int = _RESTARTS,
) -> Iterator[Array | None]:
    """Yield the configurations that lead through poses, each the solution nearest to the last.

    What ``inverse_kinematics`` finds for each pose from the configuration before it, without
    restarts where that finds anything.

    Args:
        robot: robot and where it stands.
        frames: which frame is to be at each pose.
        targets: wanted poses in the world; the first is that of ``start``.
        start: configuration to begin with, shape (n,) [rad or m].
        restarts: random starts where the search from the configuration before fails.

    Yields:
        One configuration a pose from the second on; None, as the last, where there is none.
    """
    model = robot.model
    joints = joint_table(model)
    chain = np.empty((len(targets), model.dof))
    chain[0] = start
    tips = np.array([_tip(model, frame) for frame in frames])
    wanted = inverse(robot.base) @ np.array(targets)
    done = 1
    while done < len(targets):
        first = done
        done = follow_targets(joints, tips, wanted, chain, done)
        yield from chain[first:done]
        if done < len(targets):
            seed = chain[done - 1]
            others = restarts and inverse_kinematics(
                robot, frames[done], targets[done], seed, restarts=restarts
            )
            if not others:
                yield None
                return
            chain[done] = others[0]
            yield chain[done]
            done += 1


@cache
def _tip(model: RobotModel, frame: str) -> Transform:
    """Return ``model.frame_in_last_joint`` as a writable copy: kernels are recompiled for read-only arrays."""
    return np.array(model.frame_in_last_joint(frame))


@cache
def _random_starts(model: RobotModel, count: int) -> Array:
    """Return reproducible random configurations within the limits."""
    shape = count, model.dof
    return np.random.default_rng(0).uniform(model.lower, model.upper, shape)


def _solve(
    robot: PlacedRobot, frame: str, target: Transform, seed: Array, restarts: int
) -> list[Array]:
    model = robot.model
    tip = _tip(model, frame)
    wanted = np.ascontiguousarray(inverse(robot.base) @ target)
    starts = np.empty((restarts + 1, model.dof))
    starts[0] = np.minimum(np.maximum(seed, model.lower), model.upper)
    starts[1:] = _random_starts(model, restarts)
    found = np.empty_like(starts)
    count = solve_from(
        joint_table(model), tip, wanted, np.array(seed, dtype=np.float64), starts, found
    )
    solutions = found[:count]
    order = np.argsort(np.abs(solutions - seed).sum(axis=1), kind="stable")
    return [solutions[k] for k in order]

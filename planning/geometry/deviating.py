"""How far bodies of a robot may be from where its path has them while a skill is under force control.

The flange, and with it the tool and what it holds, is anywhere within a PoseError of its reference path.
Joints bring it there by the least change of their values, so every link moves, too. To the first order that
is linear: the pseudo-inverse of the flange's Jacobian says what joints do for a way and a turn of the flange, and a
link's own Jacobian how these move it. SECOND_ORDER covers what is not linear, and what lies between
two configurations that are looked at.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planning.cell.workcell import PlacedRobot, PoseError
from planning.geometry.exact import Solid
from planning.geometry.hull_table import hull_table
from planning.geometry.robot_bodies import RobotBodies
from planning.kinematics.kinematics import joint_poses_of
from planning.transforms import Array

SECOND_ORDER = 1.2
"""Bounds of links are this times what the first order says. The proof asks for 1.1, with bounds that are
not quite the same, so what is planned is proved as well."""

UNREACHED = 1e-6
"""Directions in which the flange moves by less than this share of the best one are left out: the joints
cannot go there."""


def how_far(
    robot: PlacedRobot, path: Array, error: PoseError, solids: Sequence[Solid]
) -> Array:
    """Return how far each body may be from its place anywhere on a path, shape (solids,) [m].

    Args:
        robot: who goes along it.
        path: configurations, shape (s, n).
        error: of the flange.
        solids: bodies of the robot, and what it holds.
    """
    frames, tip = (
        np.stack([joint_poses_of(robot, q) for q in path]),
        robot.model.dof - 1,
    )
    turns = _turns(robot, frames)
    answers = np.linalg.pinv(flange_jacobians(robot, frames), rcond=UNREACHED)
    out = np.zeros(len(solids))
    for k, solid in enumerate(solids):
        if solid.joint < 0:
            continue
        points = solid.vertices
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        if solid.joint == tip:
            at = robot.model.flange[:3, 3]
            out[k] = error.takes(float(np.linalg.norm(points - at, axis=1).max()))
            continue
        radius = float(np.linalg.norm(points - middle, axis=1).max())
        frame, own = frames[:, solid.joint + 1], slice(0, solid.joint + 1)
        centre = frame[:, :3, :3] @ middle + frame[:, :3, 3]
        moves = _ways(robot, frames, centre)[:, :, own] @ answers[:, own]
        spins = turns[:, :, own] @ answers[:, own]
        of_way, of_turn = (
            _stretch(moves[..., part]) + radius * _stretch(spins[..., part])
            for part in (slice(0, 3), slice(3, 6))
        )
        most = (error.m * of_way + error.rad * of_turn).max()
        out[k] = SECOND_ORDER * float(most)
    return out


def flange_jacobians(robot: PlacedRobot, frames: Array) -> Array:
    """Return what a unit of each joint does to the flange, ways above turns, shape (s, 6, n).

    Args:
        robot: the robot.
        frames: world poses of its base and joints, shape (s, n + 1, 4, 4).
    """
    flange = (frames[:, -1] @ robot.model.flange)[:, :3, 3]
    return np.concatenate([_ways(robot, frames, flange), _turns(robot, frames)], axis=1)


def _axes(robot: PlacedRobot, frames: Array) -> Array:
    """Return the axes of the joints in the world, shape (s, n, 3)."""
    local = robot.model.chain.axis
    return np.asarray(np.einsum("snij,nj->sni", frames[:, 1:, :3, :3], local))


def _ways(robot: PlacedRobot, frames: Array, points: Array) -> Array:
    """Return what each joint does to points that all of them carry, shape (s, 3, n)."""
    axes, slides = _axes(robot, frames), np.asarray(robot.model.chain.prismatic)
    turned = np.cross(axes, points[:, None] - frames[:, 1:, :3, 3])
    return np.swapaxes(np.where(slides[:, None], axes, turned), 1, 2)


def _turns(robot: PlacedRobot, frames: Array) -> Array:
    """Return about what each joint turns all that it carries, shape (s, 3, n)."""
    slides = np.asarray(robot.model.chain.prismatic)[:, None]
    return np.swapaxes(np.where(slides, 0.0, _axes(robot, frames)), 1, 2)


def _stretch(maps: Array) -> Array:
    """Return the largest singular value of maps of vectors, shape (s, 3, 3), as shape (s,)."""
    return np.asarray(np.linalg.norm(maps, ord=2, axis=(1, 2)))


def while_deviating(
    bodies: RobotBodies, robot: PlacedRobot, path: Array, error: PoseError
) -> RobotBodies:
    """Return the bodies of a robot while it may deviate from a path, see ``how_far``."""
    off = how_far(robot, path, error, bodies.solids).tolist()
    solids = tuple(
        replace(solid, deviates=far)
        for solid, far in zip(bodies.solids, off, strict=True)
    )
    table = bodies.hulls
    hulls = hull_table(table.robot, table.q_a, table.q_b, table.solid, solids)
    return replace(bodies, solids=solids, hulls=hulls)

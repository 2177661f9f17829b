"""Robots with what they hold as flat arrays, so that compiled code can go through all of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from planning.cell.body import ConvexBody
from planning.cell.compiled_robot import RobotKernel
from planning.cell.workcell import CellObject, PlacedRobot
from planning.geometry.hull_table import placed_capsules
from planning.geometry.robot_bodies import entity
from planning.transforms import Array, Indices, Transform


class Fleet(NamedTuple):
    """Bodies and joints of many carriers: a robot with something in its hand is one carrier.

    Attributes:
        joint_first: joints of carrier v are ``range(joint_first[v], joint_first[v + 1])``.
        placement, axis, prismatic: of all joints, see KinematicChain.
        base: pose of every carrier's base, shape (carriers, 4, 4).
        body_first: bodies of a carrier, likewise: the robot's parts, then what it holds.
        joint: joint of its carrier that moves a body, -1 for the base, shape (bodies,).
        entity: number by which limits speak of a body, shape (bodies,).
        capsule_first: capsules of a body, likewise.
        capsule_joint: joint of its carrier that moves a capsule, shape (capsules,).
        start, end: of capsules in the frame of their joint, shape (capsules, 3) [m].
        ends: both in one array, shape (capsules, 2, 3).
        radius: shape (capsules,) [m].
        corner_first: hull corners of a body, likewise.
        corners: in the frame of their joint, shape (corners, 3) [m].
    """

    joint_first: Indices
    placement: Array
    axis: Array
    prismatic: npt.NDArray[np.bool_]
    base: Array
    body_first: Indices
    joint: Indices
    entity: Indices
    capsule_first: Indices
    capsule_joint: Indices
    start: Array
    end: Array
    ends: Array
    radius: Array
    corner_first: Indices
    corners: Array


Carrier = tuple[PlacedRobot, tuple[tuple[CellObject, Transform], ...]]
"""A robot, and the objects in its hand with their poses in the flange frame."""


def build_fleet(carriers: Sequence[Carrier], number: Callable[[str], int]) -> Fleet:
    """Collect carriers.

    Args:
        carriers: at least one.
        number: returns the number of an entity.
    """
    parts: list[_CarrierArrays] = [_arrays(*carrier) for carrier in carriers]
    names = [name for part in parts for name in part.names]
    capsules = [placed for part in parts for placed in part.capsules]
    corners = [c for part in parts for c in part.corners]
    joint = np.array([j for part in parts for j in part.joints], dtype=np.int64)
    counts = np.array([len(c[2]) for c in capsules], dtype=np.int64)
    start = np.ascontiguousarray(np.concatenate([c[0] for c in capsules]))
    end = np.ascontiguousarray(np.concatenate([c[1] for c in capsules]))
    models = [robot.model for robot, _ in carriers]
    return Fleet(
        _firsts([m.dof for m in models]),
        np.ascontiguousarray(np.concatenate([m.chain.placement for m in models])),
        np.ascontiguousarray(np.concatenate([m.chain.axis for m in models])),
        np.concatenate([m.chain.prismatic for m in models]).astype(np.bool_),
        np.ascontiguousarray([robot.base for robot, _ in carriers], dtype=np.float64),
        _firsts([len(part.names) for part in parts]),
        joint,
        np.array([number(name) for name in names], dtype=np.int64),
        _firsts(counts.tolist()),
        np.repeat(joint, counts),
        start,
        end,
        np.ascontiguousarray(np.stack([start, end], axis=1)),
        np.concatenate([c[2] for c in capsules]),
        _firsts([len(c) for c in corners]),
        np.ascontiguousarray(np.concatenate(corners)),
    )


class _CarrierArrays(NamedTuple):
    names: list[str]
    joints: list[int]
    capsules: list[tuple[Array, Array, Array]]
    corners: list[Array]


_BARE: dict[int, tuple[object, list[tuple[Array, Array, Array]], list[Array]]] = {}


def _arrays(
    robot: PlacedRobot, held: Sequence[tuple[CellObject, Transform]]
) -> _CarrierArrays:
    model = robot.model
    known = _BARE.get(id(model))
    if known is None or known[0] is not model:
        own = [_placed(part.body, np.eye(4)) for part in model.parts]
        # The model is kept so that its id is not given to another one.
        known = (model, [p[0] for p in own], [p[1] for p in own])
        _BARE[id(model)] = known
    hand = [_placed(item.body, model.flange @ pose) for item, pose in held]
    return _CarrierArrays(
        [entity(robot.name, part.group) for part in model.parts]
        + [item.name for item, _ in held],
        [part.joint for part in model.parts] + [model.dof - 1] * len(held),
        known[1] + [p[0] for p in hand],
        known[2] + [p[1] for p in hand],
    )


def _placed(
    body: ConvexBody, pose: Transform
) -> tuple[tuple[Array, Array, Array], Array]:
    corners = np.asarray(body.vertices) @ pose[:3, :3].T + pose[:3, 3]
    return placed_capsules(body, pose), corners


def _firsts(counts: Sequence[int]) -> Indices:
    return np.cumsum([0, *counts]).astype(np.int64)


@njit(cache=True, nogil=True)
def carrier_kernel(fleet: Fleet, v: int) -> RobotKernel:
    """Return the joints and capsules of one carrier."""
    j0, j1 = fleet.joint_first[v], fleet.joint_first[v + 1]
    c0 = fleet.capsule_first[fleet.body_first[v]]
    c1 = fleet.capsule_first[fleet.body_first[v + 1]]
    return RobotKernel(
        fleet.placement[j0:j1],
        fleet.axis[j0:j1],
        fleet.prismatic[j0:j1],
        fleet.base[v],
        fleet.capsule_joint[c0:c1],
        fleet.start[c0:c1],
        fleet.end[c0:c1],
        fleet.radius[c0:c1],
        # Bodies are ranges of capsules here; nothing that sweeps looks at this.
        fleet.capsule_joint[c0:c1],
    )

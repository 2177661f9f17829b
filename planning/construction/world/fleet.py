"""Carriers, robots with what they hold, and their bodies for compiled code."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from planning.cell.compiled_robot import robot_kernel
from planning.cell.workcell import CellObject, PlacedRobot, Workcell
from planning.geometry.hull_table import HullTable
from planning.geometry.robot_bodies import entity, entity_numbers
from planning.kernels import inner_kernel
from planning.packed import packed, packed_at
from planning.transforms import Array, Indices, Transform

Held = tuple[tuple[CellObject, Transform], ...]
"""The objects in a robot's hand, with their poses in the flange frame."""


class Carrier(NamedTuple):
    """A robot with something in its hand.

    Attributes:
        robot: who carries.
        held: what it holds.
        names: entities of its bodies: the robot's parts, then what it holds.
        hulls: these bodies on a motion of one segment, packed.
    """

    robot: PlacedRobot
    held: Held
    names: tuple[str, ...]
    hulls: HullTable


def make_carrier(robot: PlacedRobot, held: Held = ()) -> Carrier:
    """Return a robot with what it holds."""
    model = robot.model
    kernel = robot_kernel(robot, [(item.body, pose) for item, pose in held])
    bodies = [part.body for part in model.parts] + [item.body for item, _ in held]
    corners = [np.asarray(part.body.vertices) for part in model.parts]
    for item, pose in held:
        local = model.flange @ pose
        corners.append(np.asarray(item.body.vertices) @ local[:3, :3].T + local[:3, 3])
    joints = [part.joint for part in model.parts] + [model.dof - 1] * len(held)
    hulls = HullTable(
        kernel,
        np.zeros((1, model.dof)),
        np.zeros((1, model.dof)),
        np.arange(len(bodies), dtype=np.int32)[None],
        np.array(joints, dtype=np.int64),
        _firsts([len(c) for c in corners]),
        np.ascontiguousarray(np.concatenate(corners), dtype=np.float64),
        _firsts([len(body.capsules.radius) for body in bodies]),
        np.ascontiguousarray(np.stack([kernel.start, kernel.end], axis=1)),
        kernel.radius,
    )
    names = [entity(robot.name, part.group) for part in model.parts]
    names += [item.name for item, _ in held]
    return Carrier(robot, held, tuple(names), packed(hulls))


class Fleet(NamedTuple):
    """Many carriers. It keeps none of them alive.

    Attributes:
        hulls: addresses of their bodies, shape (carriers,).
        one: the bodies of one of them.
        body_first: bodies of carrier v are ``range(body_first[v], body_first[v + 1])``.
    """

    hulls: Indices
    one: HullTable
    body_first: Indices


def make_fleet(carriers: Sequence[Carrier]) -> Fleet:
    """Return carriers, at least one, for compiled code; they must outlive what is returned."""
    hulls = [carrier.hulls for carrier in carriers]
    addresses = np.array([h.address for h in hulls], dtype=np.int64)  # type: ignore[attr-defined]
    return packed(Fleet(addresses, hulls[0], _firsts([len(c.names) for c in carriers])))


@inner_kernel
def bodies_of(fleet: Fleet, v: int) -> HullTable:
    """Return the bodies of a carrier."""
    hulls: HullTable = packed_at(fleet.hulls, v, fleet.one)
    return hulls


@inner_kernel
def set_motion(hulls: HullTable, q_a: Array, q_b: Array) -> None:
    """Let a carrier's bodies be on a straight motion, whose ends have its joints first."""
    for j in range(hulls.q_a.shape[1]):
        hulls.q_a[0, j] = q_a[j]
        hulls.q_b[0, j] = q_b[j]


def cell_entities(cell: Workcell) -> dict[str, int]:
    """Return the number of every entity: arm and tool of each robot, fixtures, objects."""
    things = [f.name for f in cell.fixtures] + [o.name for o in cell.objects]
    return entity_numbers((robot.name for robot in cell.robots), things)


def _firsts(counts: Sequence[int]) -> Indices:
    return np.cumsum([0, *counts]).astype(np.int64)

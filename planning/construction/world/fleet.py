"""Carriers, robots with what they hold, and their bodies for compiled code."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from planning.cell.workcell import Attachment, CellObject, PlacedRobot, Workcell
from planning.geometry.hull_table import HullTable
from planning.geometry.robot_bodies import entity_numbers, robot_bodies
from planning.kernels import inner_kernel
from planning.packed import packed, packed_at
from planning.transforms import Array, Indices, Transform

Held = tuple[tuple[CellObject, Transform], ...]
"""The objects in a robot's hand, with their poses in the flange frame."""


class Carrier(NamedTuple):
    """A robot with something in its hand.

    Attributes:
        robot: who carries.
        names: entities of its bodies: the robot's parts, then what it holds.
        self_limits: least distance of two of them, see RobotBodies.
        hulls: these bodies on a motion of one segment, packed.
    """

    robot: PlacedRobot
    names: tuple[str, ...]
    self_limits: Array
    hulls: HullTable


def make_carrier(robot: PlacedRobot, held: Held = ()) -> Carrier:
    """Return a robot with what it holds."""
    hand = [(item, Attachment(robot.name, pose)) for item, pose in held]
    bodies = robot_bodies(robot, hand)
    hulls = bodies.hulls.on_a_motion()
    return Carrier(robot, bodies.entities, bodies.self_limits, hulls)


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
    return packed(
        Fleet(addresses, hulls[0], np.cumsum([0, *(len(c.names) for c in carriers)]))
    )


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

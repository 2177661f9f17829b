"""Robots with the parts that they carry, and their bodies as arrays for compiled code."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from planning.cell.workcell import PlacedRobot
from planning.geometry.hull_table import HullTable
from planning.geometry.robot_bodies import Held, RobotBodies, robot_bodies
from planning.kernels import inner_kernel
from planning.packed import packed, packed_at
from planning.transforms import Array, Indices


class LoadedRobot(NamedTuple):
    """A robot with the object in its hand.

    Attributes:
        bodies: the robot's parts, then its load.
        hulls: these bodies on a motion of one segment, packed.
    """

    bodies: RobotBodies
    hulls: HullTable


def make_loaded_robot(robot: PlacedRobot, held: Sequence[Held] = ()) -> LoadedRobot:
    """Return a robot with the object that it holds."""
    bodies = robot_bodies(robot, held)
    return LoadedRobot(bodies, bodies.hulls.on_a_motion())


class RobotFleet(NamedTuple):
    """Handles of many carriers for compiled code; it does not keep them alive.

    Attributes:
        hulls: addresses of their bodies, shape (carriers,).
        one: the bodies of one of them.
        body_first: bodies of carrier v are ``range(body_first[v], body_first[v + 1])``.
    """

    hulls: Indices
    one: HullTable
    body_first: Indices


def make_fleet(carriers: Sequence[LoadedRobot]) -> RobotFleet:
    """Return carriers, at least one, for compiled code; they must outlive the fleet."""
    hulls = [carrier.hulls for carrier in carriers]
    addresses = np.array([h.address for h in hulls], dtype=np.int64)  # type: ignore[attr-defined]
    return packed(
        RobotFleet(addresses, hulls[0], np.cumsum([0, *(len(h.joint) for h in hulls)]))
    )


@inner_kernel
def bodies_of(fleet: RobotFleet, v: int) -> HullTable:
    """Return the bodies of a carrier."""
    hulls: HullTable = packed_at(fleet.hulls, v, fleet.one)
    return hulls


@inner_kernel
def set_motion(hulls: HullTable, q_a: Array, q_b: Array) -> None:
    """Put the bodies of a carrier on a straight motion, whose end points begin with its joints."""
    for j in range(hulls.q_a.shape[1]):
        hulls.q_a[0, j] = q_a[j]
        hulls.q_b[0, j] = q_b[j]

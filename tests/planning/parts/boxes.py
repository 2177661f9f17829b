"""Boxes as parts and fixtures, two arms, and assemblies in which parts are placed one by one."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from planning.cell.shape import box_shape
from planning.cell.workcell import CellObject, Fixture, PlacedRobot, Workcell
from planning.parts.assembly import PartAssembly, PlacePart
from planning.robots.registry import robot_model
from planning.transforms import Transform, from_rpy, translation

Three = tuple[float, float, float]


def part(name: str, size: Three, start: Transform, mass: float = 0.0) -> CellObject:
    """Return a box that lies somewhere at the start."""
    return CellObject(name, "box", box_shape(name, np.array(size)), start, mass)


def fixture(name: str, size: Three, at: Three) -> Fixture:
    """Return a box that stands fast with its centre at a point."""
    return Fixture(name, box_shape(name, np.array(size)), translation(*at))


def table() -> Fixture:
    """Return a table with its top at height 0."""
    return fixture("table", (2.0, 2.0, 0.02), (0.0, 0.0, -0.01))


def two_arms() -> Workcell:
    """Return two arms, west and east, that face each other over a table, 1 m apart."""
    model = robot_model("panda")
    places = ("west", -0.5, 0.0), ("east", 0.5, np.pi)
    robots = (
        PlacedRobot(name, model, from_rpy((x, 0, 0), (0, 0, yaw)), model.home)
        for name, x, yaw in places
    )
    return Workcell(tuple(robots), (table(),), ())


def built(goals: Mapping[str, Transform], *names: str, **more: Any) -> PartAssembly:
    """Return the assembly of some parts, each placed by a step of its name."""
    steps = tuple(PlacePart(part=name, name=name) for name in names)
    return PartAssembly(goals, steps, **more)

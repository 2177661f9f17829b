"""Boxes as parts and fixtures, and assemblies in which they are put in their places one by one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from planning.cell.shape import box_shape
from planning.cell.workcell import CellObject, Fixture
from planning.parts.assembly import PartAssembly, PlacePart
from planning.transforms import Transform, translation

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


def built(goals: Mapping[str, Transform], *names: str, **more: Any) -> PartAssembly:
    """Return the assembly of some parts, each placed by a step of its name."""
    steps = tuple(PlacePart(part=name, name=name) for name in names)
    return PartAssembly(goals, steps, **more)

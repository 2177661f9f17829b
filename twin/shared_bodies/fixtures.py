"""Links that several robots of one description share, as fixtures of the cell."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from itertools import chain, count
from pathlib import Path

import numpy as np

from planning.cell.body import ConvexBody
from planning.cell.shape import Element, shape_of
from planning.cell.workcell import Fixture, PlacedRobot
from planning.robots.tool_shape import convex_hull_mesh
from planning.transforms import read_only_copy
from twin.planning.fitted_robots import model_with, robot_fitting
from twin.scenario.sections.cell import CellSection, RobotSection
from twin.shared_bodies.arms import arms_beside

_LONGEST = 60
"""Longest name of a fixture, without the number of a second one of that name."""


def mount_on_shared_bodies(
    robots: Sequence[PlacedRobot],
    cell: CellSection,
    folder: Path,
    taken: Collection[str],
) -> tuple[tuple[PlacedRobot, ...], tuple[Fixture, ...]]:
    """Return robots, each with what is its own, with the bodies that they share, and these bodies.

    No fixture has one of the names that are taken.
    """
    mounted: dict[str, tuple[Fixture, ...]] = {}
    fixtures: tuple[Fixture, ...] = ()
    for section in cell.robots:
        _, others = arms_beside(section, cell, folder)
        if others and section.name not in mounted:
            names = {*taken, *(item.name for item in fixtures)}
            shared = tuple(_shared_links(section, cell, folder, names))
            mounted |= dict.fromkeys([section.name, *(k.name for k in others)], shared)
            fixtures += shared
    found = (replace(robot, mounted_on=mounted.get(robot.name, ())) for robot in robots)
    return tuple(found), fixtures


def _shared_links(
    section: RobotSection, cell: CellSection, folder: Path, taken: Collection[str]
) -> Iterator[Fixture]:
    """Yield the links that a robot shares with others, one fixture each."""
    fitting = robot_fitting(section, cell, folder)
    whole = replace(fitting, emptied=frozenset(), looks=False)
    model = model_with(section, section.model, folder, whole)
    hulls: dict[str, list[ConvexBody]] = {}
    for part in model.parts:
        if part.joint < 0:
            # pinocchio names shapes "<link>_<number>".
            hulls.setdefault(part.body.name.rpartition("_")[0], []).append(part.body)
    pose, here = read_only_copy(section.base.transform()), read_only_copy(np.eye(4))
    for link, bodies in hulls.items():
        name = _free_name(f"{Path(section.model).stem}.{link}", taken)
        meshes = [convex_hull_mesh(body.vertices, here, name) for body in bodies]
        shape = shape_of(name, [Element(mesh, here) for mesh in meshes])
        yield Fixture(name, shape, pose)


def _free_name(wanted: str, taken: Collection[str]) -> str:
    """Return a name in the form of names in scenarios that nothing else has."""
    name = re.sub(r"[^A-Za-z0-9_.-]", "_", wanted).lstrip(".-")[:_LONGEST] or "body"
    others = (f"{name}_{k}" for k in count(2))
    return next(own for own in chain([name], others) if own not in taken)

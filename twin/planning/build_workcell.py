"""Construction of a cell from a scenario."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from planning.cell.machine import machine
from planning.cell.workcell import Clearances, Fixture, PlacedRobot, Workcell
from planning.transforms import readonly
from twin.planning.build_shape import build_shape
from twin.planning.kind import assembly_kind
from twin.scenario.sections.poses import build_transform
from twin.scenario.sections.scenario import FixtureSection, RobotSection, Scenario
from twin.scenario.sections.tools import ToolSection


def build_workcell(scenario: Scenario, folder: Path = Path()) -> Workcell:
    """Return the cell of a scenario: robots, fixtures, and what is to be assembled.

    Args:
        scenario: a checked scenario.
        folder: where relative paths in it start, that of its file.

    Raises:
        RobotModelError: a robot description cannot be used.
        ShapeError: a mesh cannot be used.
    """
    clearance = scenario.cell.clearance
    assembly = assembly_kind(scenario.assembly)
    return Workcell(
        robots=tuple(
            _robot(r, scenario.cell.tools, folder) for r in scenario.cell.robots
        ),
        fixtures=(
            *(_fixture(f, folder) for f in scenario.cell.fixtures),
            *assembly.fixtures(),
        ),
        objects=assembly.objects(folder),
        clearances=Clearances(
            clearance.robot_robot_m,
            clearance.robot_object_m,
            clearance.contact_tolerance_m,
        ),
        machines=tuple(map(machine, assembly.machines())),
    )


def _robot(
    section: RobotSection, tools: Mapping[str, ToolSection], folder: Path
) -> PlacedRobot:
    from twin.planning.fitted_robots import fitted_model

    model = fitted_model(section, tools, folder)
    if section.frames:
        own = {name: build_transform(pose) for name, pose in section.frames.items()}
        model = dataclasses.replace(model, frames={**model.frames, **own})
    if section.home_deg is not None:
        home = readonly(np.deg2rad(section.home_deg))
    elif section.home_rad_or_m is not None:
        home = readonly(section.home_rad_or_m)
    else:
        home = model.home
    if section.parked is not None:
        x, y = section.parked.at_m
        stand = (x, y, np.deg2rad(section.parked.facing_deg))
        home = readonly((*stand, *home[3:]))
    return PlacedRobot(
        section.name, model, build_transform(section.base), home, tool=section.tool
    )


def _fixture(section: FixtureSection, folder: Path) -> Fixture:
    shape = build_shape(section.name, section.described, folder)
    frames = {name: build_transform(at) for name, at in section.frames.items()}
    return Fixture(section.name, shape, build_transform(section.pose), frames)

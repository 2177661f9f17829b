"""Construction of the workcell of a scenario."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from planning.bounds import HOME_SLACK, LIMIT_SLACK
from planning.cell.machine import machine_robot
from planning.cell.motion_limits import MotionLimits
from planning.cell.workcell import (
    CellObject,
    Clearances,
    Fixture,
    PlacedRobot,
    RackTool,
    Workcell,
)
from planning.kinematics.kinematics import frame_pose
from planning.transforms import read_only_copy
from twin.planning.fitted_robots import fitted_model
from twin.planning.shapes import build_shape
from twin.registry import HOOKS
from twin.scenario.sections.cell import CellSection, LimitsSection, RobotSection
from twin.scenario.sections.kind import AssemblyKind, assembly_kind
from twin.scenario.sections.scenario import FixtureSection, Scenario
from twin.scenario.sections.shapes import to_planning_class

_TOOL_COLOUR = (88, 92, 98)
"""Colour of tools that are objects."""


def build_workcell(
    scenario: Scenario, folder: Path = Path(), kind: AssemblyKind | None = None
) -> Workcell:
    """Return the cell of a scenario: robots, fixtures and the assembly.

    Args:
        scenario: a checked scenario.
        folder: where relative paths in it start, that of its file.
        kind: kind of assembly, where it differs from the scenario's section.

    Raises:
        RobotModelError: a robot description cannot be used.
        ShapeError: a mesh cannot be used.
    """
    assembly = kind or assembly_kind(scenario.assembly)
    robots = tuple(
        _within_limits(scenario, r.limits, _robot(r, scenario.cell, folder))
        for r in scenario.cell.robots
    )
    fixtures = (
        *(_fixture(f, folder) for f in scenario.cell.fixtures),
        *assembly.fixtures(),
    )
    objects = (
        *assembly.objects(folder),
        *(tool.item for robot in robots for tool in robot.tools),
    )
    if "shared bodies" in HOOKS:
        taken = {r.name for r in robots} | {f.name for f in fixtures}
        taken |= {o.name for o in objects}
        mount = HOOKS.load("shared bodies")
        robots, bodies = mount(robots, scenario.cell, folder, taken)
        fixtures += bodies
    return Workcell(
        robots=robots,
        fixtures=fixtures,
        objects=objects,
        clearances=to_planning_class(
            Clearances,
            scenario.cell.clearance,
            contact_depth=assembly.contact_depth(),
        ),
        machines=tuple(map(machine_robot, assembly.machines())),
        deviations={
            skill: off.planned
            for skill, off in sorted(scenario.planning.deviation.items())
            if off.planned
        },
    )


def _within_limits(
    scenario: Scenario, section: LimitsSection, robot: PlacedRobot
) -> PlacedRobot:
    """Return a robot with its motion limits, where the speed model needs them."""
    planning = scenario.planning
    if scenario.speed_model != "limits":
        return robot
    limits = dataclasses.replace(
        MotionLimits.of(robot.model),
        sum_of_speeds=planning.speed_rad_s or np.inf,
        tool_speed=section.tool_speed_m_s or np.inf,
        loaded_tool_speed=section.loaded_tool_speed_m_s or np.inf,
    )
    return dataclasses.replace(robot, limits=limits)


def _robot(section: RobotSection, cell: CellSection, folder: Path) -> PlacedRobot:
    model = fitted_model(section, cell, folder)
    if section.frames:
        own = {name: pose.transform() for name, pose in section.frames.items()}
        model = dataclasses.replace(model, frames={**model.frames, **own})
    if section.home_deg is not None:
        home = read_only_copy(np.deg2rad(section.home_deg))
    elif section.home_rad_or_m is not None:
        home = read_only_copy(section.home_rad_or_m)
    else:
        home = model.home
    if section.parked is not None:
        x, y = section.parked.at_m
        stand = (x, y, np.deg2rad(section.parked.facing_deg))
        home = read_only_copy((*stand, *home[3:]))
    nearest = np.clip(home, model.lower, model.upper)
    off = np.abs(home - nearest)
    rounded = (off > LIMIT_SLACK) & (off <= HOME_SLACK)
    home = read_only_copy(np.where(rounded, nearest, home))
    base, first = section.base.transform(), (*section.tools, section.tool)[0]
    robot = PlacedRobot(section.name, model, base, home, tool=first)
    if section.base_error is not None:
        error = section.base_error.planned
        robot = dataclasses.replace(robot, base_error=error)
    if not section.tools:
        return robot
    changed = tuple(_rack_tool(robot, item, cell, folder) for item in section.outfits)
    own_frames = {
        f"{tool.name}/{name}": pose
        for tool in changed
        for name, pose in tool.model.frames.items()
    }
    model = dataclasses.replace(model, frames={**model.frames, **own_frames})
    return dataclasses.replace(robot, model=model, tools=changed)


def _rack_tool(
    robot: PlacedRobot,
    section: RobotSection,
    cell: CellSection,
    folder: Path,
) -> RackTool:
    """Return an exchangeable tool; a mounted one is at the robot's flange."""
    from planning.robots.tool_shape import tool_shape

    name = str(section.tool)
    own = cell.tools[name]
    assert own.rack is not None
    model = fitted_model(section, cell, folder)
    mount, rack = own.mount.transform(), own.rack.transform()
    shape = tool_shape(name, model, mount)
    start = frame_pose(robot, robot.home) @ mount if robot.tool == name else rack
    item = CellObject(
        name,
        name,
        shape,
        read_only_copy(start),
        own.mass_kg or 0.0,
        colour=_TOOL_COLOUR,
    )
    seconds = own.rack.change_time.located(folder).mean
    return RackTool(item, mount, rack, own.rack.approach_m, seconds, model)


def _fixture(section: FixtureSection, folder: Path) -> Fixture:
    shape = build_shape(section.name, section.described, folder)
    return to_planning_class(Fixture, section, shape=shape)

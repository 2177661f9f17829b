"""Robots with one of the tools that they change on them, as part of their bodies.

Plans know such a tool as an object in the hand of a bare arm. Where a single skill is looked for, its
robot has one tool throughout: then arm and tool are one body, like those of any other robot.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import lru_cache

from planning.cell.robot_model import RobotModel
from planning.cell.workcell import PlacedRobot, RackTool, Workcell
from planning.geometry.robot_bodies import entity
from planning.tasks.assignment import NO_TOOLS, Tools


def outfits(robots: Iterable[PlacedRobot]) -> Iterator[PlacedRobot]:
    """Yield each robot with each of its tools on it, those that change none as they are."""
    for robot in robots:
        if not robot.tools:
            yield robot
        for tool in robot.tools:
            yield replace(robot, model=tool.model, tool=tool.name)


def worn(robot: PlacedRobot) -> Tools:
    """Return the tool that a robot has on it, nothing of one that keeps its own."""
    if not robot.tools:
        return NO_TOOLS
    return frozenset({(robot.name, str(robot.tool))})


def hand(robot: PlacedRobot) -> str:
    """Return by which name allowed contacts speak of the tool that a robot has on it."""
    return str(robot.tool) if robot.tools else entity(robot.name, "tool")


def fitted_out(cell: Workcell, tools: Tools) -> Workcell:
    """Return the cell in which robots have certain tools on them, and all racks are full.

    A robot that is not named has all of its tools on it at once: nobody knows yet which one it
    will have.
    """
    if not any(robot.tools for robot in cell.robots):
        return cell
    chosen = dict(tools)
    robots = tuple(_fitted_out(robot, chosen.get(robot.name)) for robot in cell.robots)
    return replace(in_racks(cell), robots=robots)


def in_racks(cell: Workcell) -> Workcell:
    """Return the cell with all tools that are changed in their racks."""
    racks = {tool.name: tool.rack for tool in rack_tools(cell)}
    objects = tuple(
        replace(item, start=racks.get(item.name, item.start)) for item in cell.objects
    )
    return replace(cell, objects=objects)


def in_every_outfit(cell: Workcell) -> Workcell:
    """Return the cell in which a robot is several: one with each of its tools on it."""
    return replace(in_racks(cell), robots=tuple(outfits(cell.robots)))


def rack_tools(cell: Workcell) -> Iterator[RackTool]:
    """Yield the tools that robots of a cell change."""
    for robot in cell.robots:
        yield from robot.tools


def _fitted_out(robot: PlacedRobot, tool: str | None) -> PlacedRobot:
    if not robot.tools:
        return robot
    if tool is None:
        models = tuple(own.model for own in robot.tools)
        return replace(robot, model=_all_at_once(robot.model, models))
    return next(own for own in outfits([robot]) if own.tool == tool)


@lru_cache(maxsize=64)
def _all_at_once(arm: RobotModel, models: tuple[RobotModel, ...]) -> RobotModel:
    """Return a robot with the bodies of several tools; it only stands in the way of others."""
    tools = [p for model in models for p in model.parts if p.group == "tool"]
    return replace(arm, parts=(*arm.parts, *tools))

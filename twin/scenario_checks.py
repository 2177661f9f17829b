"""Checks that need the whole scenario: do the parts fit together?"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from planning.errors import RobotModelError, ScenarioError
from twin.assemblies.kinds import assembly_kind
from twin.duration_checks import Found, check_durations
from twin.scenario import RobotSection, Scenario
from twin.scenario_problems import Problem, mark_problems, unknown_name
from twin.scenario_yaml import KeyPath, YamlDocument


def find_problems(scenario: Scenario, document: YamlDocument) -> list[Problem]:
    """Return everything in the scenario that cannot be as it is written.

    Args:
        scenario: passed the checks of its single values.
        document: where it was read from, for places and relative paths.
    """
    folder = document.path.parent
    found: list[tuple[KeyPath, str]] = []
    found += _check_robots(scenario.cell.robots, folder)
    found += _check_names(scenario)
    found += check_durations(scenario, folder)
    found += _check_robot_names(scenario)
    assembly = assembly_kind(scenario.assembly)
    return mark_problems(document, found) + assembly.problems(document)


def _check_names(scenario: Scenario) -> Found:
    """Robots have names of their own; so have fixtures and objects together."""
    robots = [
        (("cell", "robots", i, "name"), r.name)
        for i, r in enumerate(scenario.cell.robots)
    ]
    things: list[tuple[KeyPath, str]] = [
        (("cell", "fixtures", i, "name"), f.name)
        for i, f in enumerate(scenario.cell.fixtures)
    ]
    assembly = assembly_kind(scenario.assembly)
    things += assembly.names()
    for group in (robots, things):
        seen: set[str] = set()
        for path, name in group:
            if name in seen:
                yield path, f"the name {name!r} is already taken"
            seen.add(name)
    names = {name for _, name in robots}
    for path, name in things:
        owner = "a robot" if name in names else assembly.reserved(name)
        if owner is not None:
            yield path, f"the name {name!r} is that of {owner}"


def _check_robots(robots: Sequence[RobotSection], folder: Path) -> Found:
    from planning.robots.registry import robot_model

    for i, robot in enumerate(robots):
        at: KeyPath = ("cell", "robots", i)
        try:
            model = robot_model(robot.model, folder)
        except (RobotModelError, ScenarioError) as error:
            if error.choices:
                text = unknown_name("robot model", robot.model, error.choices)
                yield (*at, "model"), text
            else:
                yield (*at, "model"), str(error)
            continue
        home = robot.home_deg or robot.home_rad_or_m
        key = "home_deg" if robot.home_deg else "home_rad_or_m"
        if home is not None and len(home) != model.dof:
            joints = ", ".join(model.joint_names)
            yield (
                (*at, key),
                f"{len(home)} values for the {model.dof} joints of {robot.model} ({joints})",
            )
        if robot.home_deg and model.chain.prismatic.any():
            yield (*at, key), f"{robot.model} has sliding joints: use home_rad_or_m"


def _check_robot_names(scenario: Scenario) -> Found:
    """Disturbances happen to robots of the cell."""
    names = [robot.name for robot in scenario.cell.robots]
    execution = scenario.execution
    used: list[tuple[KeyPath, str]] = [
        (("execution", "speed", "robots", name), name)
        for name in execution.speed.robots
    ]
    if execution.breakdowns is not None:
        used += [
            (("execution", "breakdowns", "robots", i), name)
            for i, name in enumerate(execution.breakdowns.robots or ())
        ]
    used += [
        (("execution", "emergency_stops", i, "robot"), stop.robot)
        for i, stop in enumerate(execution.emergency_stops)
        if stop.robot is not None
    ]
    for path, name in used:
        if name not in names:
            yield path, unknown_name("robot", name, names)

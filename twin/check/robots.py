"""Checks of robots where they stand: HOME clear of everything, bases in nothing, speeds."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from planning.cell.workcell import start_state
from planning.geometry.exact import distance_at, resting_solid
from planning.geometry.robot_bodies import robot_bodies
from planning.geometry.scene_checker import SceneChecker
from twin.check.finding import Finding, Findings, Subject, millimetres

_SUNK = 0.005
"""A base may be in what it stands on by this [m]."""

_NOWHERE = np.zeros(0)

_HOME_KEYS = ("home_deg", "home_rad_or_m", "parked", "base")


def check_homes(subject: Subject) -> Findings:
    """Yield robots that touch themselves, others or anything else at HOME, or are past a limit."""
    cell = subject.cell
    state = start_state(cell)
    seen: set[frozenset[str]] = set()
    for robot in cell.robots:
        at = subject.robot_at(robot.name, *_HOME_KEYS)
        model = robot.model
        for k, name in enumerate(model.joint_names):
            if not model.lower[k] - 1e-6 <= robot.home[k] <= model.upper[k] + 1e-6:
                yield Finding(
                    at,
                    f"HOME of {robot.name}: joint {name} is at {robot.home[k]:.3f}, its limits are"
                    f" {model.lower[k]:.3f} and {model.upper[k]:.3f} (rad or m)",
                )
        contact = SceneChecker(cell, robot.name, state).contact(robot.home)
        if contact is None:
            continue
        pair = frozenset((_owner(contact.first), _owner(contact.second)))
        if pair not in seen:
            yield Finding(
                at,
                f"{robot.name} cannot stand at HOME: {contact}; move its base or change its HOME",
                error=True,
            )
        seen.add(pair)


def check_bases(subject: Subject) -> Findings:
    """Yield bases that are deep in a fixture of the file; two bases are in contact at HOME."""
    cell = subject.cell
    fixtures = [item for item in cell.fixtures if item.name in subject.own_fixtures]
    for robot in cell.robots:
        deepest: dict[str, float] = defaultdict(float)
        for solid in robot_bodies(robot).solids:
            if solid.joint >= 0:
                continue
            for item in fixtures:
                for piece in item.shape.pieces:
                    box = resting_solid(item.name, piece, item.pose)
                    gap = distance_at(solid, robot.home, box, _NOWHERE)
                    deepest[item.name] = min(deepest[item.name], gap)
        for name, gap in deepest.items():
            if gap < -_SUNK:
                yield Finding(
                    subject.robot_at(robot.name, "base"),
                    f"the base of {robot.name} is {millimetres(-gap)} deep in {name}: right if it is"
                    " bolted into a cut-out, a mistake if it stands on it",
                )


def check_speeds(subject: Subject) -> Findings:
    """Yield a planning speed that is beyond the limits of joints, which then set the times."""
    planning = subject.scenario.planning
    if planning.speed_model != "l1" or subject.kind.at_once:
        return
    speed = planning.speed_rad_s
    slow: dict[str, tuple[float, list[str]]] = {}
    for robot in subject.cell.robots:
        model = robot.model
        k = int(np.argmin(model.velocity))
        if speed > model.velocity[k] * (1.0 + 1e-9):
            limit = float(model.velocity[k])
            words = f"{model.name}: {limit:.3g} rad/s or m/s at {model.joint_names[k]}"
            slow.setdefault(words, (limit, []))[1].append(robot.name)
    if slow:
        least = min(limit for limit, _ in slow.values())
        listing = "; ".join(
            f"{words} ({', '.join(names)})" for words, (_, names) in slow.items()
        )
        yield Finding(
            ("planning", "speed_rad_s"),
            f"speed_rad_s {speed:g} is {speed / least:.2f} times what a joint can do ({listing}): where one"
            " joint has most of the way, its limit sets the time and not this speed, and the joint is at"
            " full speed throughout; use speed_model joint to plan by the limits, or at most"
            f" speed_rad_s {least:.3g}",
        )


def _owner(entity: str) -> str:
    return entity.partition(":")[0].partition("/")[0]

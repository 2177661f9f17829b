"""Checks of units: lengths a thousand times too large, as millimetres where metres are asked for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from planning.cell.workcell import PlacedRobot
from planning.transforms import Array, Transform
from twin.checks.finding import CheckContext, Finding, Findings
from twin.checks.reach import distance_from_first_joint, reach_bound
from twin.document.yaml_text import KeyPath
from twin.scenario.sections.cell import CellSection
from twin.scenario.sections.shapes import PoseSection

_MOST_ARM_LENGTHS = 20.0
"""Largest plausible distance from an arm, in arm lengths."""

_LARGE = 10.0
"""Largest plausible size of a part, in lengths of the longest arm."""

Place = tuple[str, str, KeyPath, Transform]
"""Name of a part, the subject of a sentence about where it is, the path of that in the file, and its pose."""


def check_units(subject: CheckContext) -> Findings:
    """Yield places, sizes and tool frames far beyond the reach of the cell's arms."""
    robots = subject.cell.robots
    if not robots:
        return
    longest = max(map(_length, robots))
    places = list(_places(subject))
    yield from _far_apart(subject, places)
    for item in subject.checks.sized():
        size = item.shape.size
        if float(size.max()) > _LARGE * longest:
            large = " x ".join(f"{value:.4g}" for value in size)
            small = " x ".join(f"{value / 1e3:.4g}" for value in size)
            yield Finding(
                subject.thing_at(item.name, "size_m"),
                f"{item.name} measures {large} m, and the longest arm is {longest:.2f} m long: lengths"
                f" are in metres; if these are in millimetres, it is {small} m",
                error=True,
                code="size",
                parts=(item.name,),
            )
    yield from _tool_frames(subject)


def _length(robot: PlacedRobot) -> float:
    return reach_bound(robot, "flange")


def _places(subject: CheckContext) -> Iterator[Place]:
    """Yield the start and goal places of parts."""
    goals = subject.checks.goals()
    for item in subject.cell.objects:
        at = subject.thing_at(item.name, "start")
        yield item.name, f"{item.name} lies", at, item.start
        if item.name in goals:
            at = subject.thing_at(item.name, "goal")
            yield item.name, f"the place of {item.name} is", at, goals[item.name]


def _far_apart(subject: CheckContext, places: Sequence[Place]) -> Findings:
    """Yield places far from every robot, and robots far from every place."""
    robots = subject.cell.robots
    for name, words, at, place in places:
        nearest = min(
            robots,
            key=lambda item: distance_from_first_joint(item, place) / _length(item),
        )
        away = distance_from_first_joint(nearest, place)
        if away > _MOST_ARM_LENGTHS * _length(nearest):
            yield Finding(
                at,
                f"{words} {away:.4g} m away from {nearest.name}, whose arm is"
                f" {_length(nearest):.2f} m long, and no other robot is nearer: {_remedy(place[:3, 3])}",
                error=True,
                code="far",
                parts=(name, nearest.name),
                figures=tuple(place[:3, 3].tolist()),
            )
    for robot in robots if places else ():
        away = min(distance_from_first_joint(robot, place) for _, _, _, place in places)
        if away > _MOST_ARM_LENGTHS * _length(robot):
            yield Finding(
                subject.robot_at(robot.name, "base"),
                f"{robot.name} stands {away:.4g} m away from whatever is to be handled, and its arm is"
                f" {_length(robot):.2f} m long: {_remedy(robot.base[:3, 3])}",
                error=True,
            )


def _tool_frames(subject: CheckContext) -> Findings:
    """Yield tool frames farther from the flange than the arm's length."""
    for robot, words, at, pose in _framed_poses(subject.scenario.cell):
        length = _length(subject.cell.robot(robot))
        place = np.array(pose.xyz_m)
        away = float(np.linalg.norm(place))
        if away > length:
            yield Finding(
                at,
                f"{words} is {away:.4g} m away from what it is on, farther than the arm of"
                f" {robot} is long ({length:.2f} m): {_remedy(place)}",
                error=True,
            )


def _framed_poses(
    cell: CellSection,
) -> Iterator[tuple[str, str, KeyPath, PoseSection]]:
    """Yield mounts and frames of tools, each with robot, description and path in the file."""
    for number, robot in enumerate(cell.listed):
        for name, pose in robot.frames.items():
            at: KeyPath = ("cell", "robots", number, "frames", name)
            yield robot.name, f"frame {name} of {robot.name}", at, pose
        for tool in dict.fromkeys((robot.tool, *robot.tools)):
            if tool is None or tool not in cell.tools:
                continue
            section, at = cell.tools[tool], ("cell", "tools", tool)
            yield robot.name, f"the mount of {tool}", (*at, "mount"), section.mount
            if section.tcp is not None:
                yield robot.name, f"the tcp of {tool}", (*at, "tcp"), section.tcp
            for name, pose in section.frames.items():
                words = f"frame {name} of {tool}"
                yield robot.name, words, (*at, "frames", name), pose


def _remedy(place: Array) -> str:
    small = ", ".join(f"{value / 1e3:.4g}" for value in place)
    return f"xyz_m is in metres; if these are millimetres, it is [{small}]"

"""Pairs of a robot's links that are exempt from collision checks: who exempts them, and which of them can collide."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planning.cell.robot_model import RobotModel
from planning.cell.workcell import PlacedRobot
from planning.geometry.exact import hull_distance_at
from planning.geometry.robot_bodies import robot_bodies
from planning.robots.descriptions.fitting import ignored_pairs
from planning.robots.descriptions.xml_files import read_xml
from planning.transforms import identity
from twin.checks.finding import CheckContext, Finding, Findings

_SAMPLES = 100
"""Number of random configurations in which exempt pairs are measured."""

_DEEP = 0.001
"""Overlaps up to this depth are not reported [m]."""

_MOST_PAIRS = 3
"""Number of pairs that a finding lists."""


@dataclass(frozen=True)
class Overlap:
    """Overlap of an exempt pair of links that are apart at HOME.

    Attributes:
        links: names of the links.
        share: share of random configurations in which they overlap.
        depth: largest depth [m].
    """

    links: tuple[str, str]
    share: float
    depth: float


def exemptions(model: RobotModel) -> dict[str, list[tuple[str, str]]]:
    """Return the exempt pairs of links by reason, such as ``"arm.srdf: Never"``."""
    out: dict[str, list[tuple[str, str]]] = {}
    if model.ignored_contacts:
        for pair, why in ignored_pairs(read_xml(model.urdf)).items():
            out.setdefault(why, []).append(pair)
    return out


def exemption_words(model: RobotModel) -> list[str]:
    """Return a text on the exempt pairs of each reason."""
    return [
        f"not checked for collisions, by {why}: "
        + ", ".join(" - ".join(pair) for pair in pairs)
        for why, pairs in exemptions(model).items()
    ]


def exempt_overlaps(model: RobotModel) -> list[Overlap]:
    """Return the exempt pairs of links that overlap in random configurations, the deepest first.

    Links of neighbouring joints are left out, as are those that overlap at HOME: nothing checks them in any case.
    """
    robot = PlacedRobot(model.name, model, identity(), model.home)
    solids, exempt = (
        robot_bodies(robot).solids,
        set(map(frozenset, model.ignored_contacts)),
    )
    home = model.home
    pairs = [
        (i, j)
        for i, j in sorted(model.never_collide)
        if frozenset((model.parts[i].link, model.parts[j].link)) in exempt
        and abs(model.parts[i].joint - model.parts[j].joint) > 1
        and hull_distance_at(solids[i], home, solids[j], home) > 0.0
    ]
    rng = np.random.default_rng(0)
    seen: dict[tuple[str, str], list[float]] = {}
    for q in rng.uniform(model.lower, model.upper, (_SAMPLES, model.dof)):
        deepest: dict[tuple[str, str], float] = {}
        for i, j in pairs:
            gap = hull_distance_at(solids[i], q, solids[j], q)
            links = model.parts[i].link, model.parts[j].link
            if -gap > max(_DEEP, deepest.get(links, 0.0)):
                deepest[links] = -gap
        for links, depth in deepest.items():
            seen.setdefault(links, []).append(depth)
    found = [Overlap(k, len(v) / _SAMPLES, max(v)) for k, v in seen.items()]
    return sorted(found, key=lambda item: -item.depth)


def overlap_words(model: RobotModel) -> list[str]:
    """Return a warning of the exempt pairs of links that can collide; empty for none."""
    found = exempt_overlaps(model)
    if not found:
        return []
    listed = ", ".join(
        f"{' and '.join(item.links)} ({1e3 * item.depth:.0f} mm deep, {item.share:.0%})"
        for item in found[:_MOST_PAIRS]
    )
    more = f" and {len(found) - _MOST_PAIRS} more" if len(found) > _MOST_PAIRS else ""
    return [
        f"hulls of links overlap in random configurations within the limits and are exempt from collision checks:"
        f" {listed}{more}: no plan and no audit avoids that"
    ]


def check_ignored_contacts(subject: CheckContext) -> Findings:
    """Yield exempt pairs of links that can collide."""
    for robot in subject.distinct_robots:
        at = subject.robot_at(robot.name, "ignore_contacts", "srdf", "model")
        for words in overlap_words(robot.model):
            yield Finding(at, f"{robot.name}: {words}")


def exemption_notes(subject: CheckContext) -> tuple[str, ...]:
    """Return a note on the exempt pairs of links of each robot."""
    return tuple(
        f"{robot.name}: pairs of links that are not checked for collisions: "
        + ", ".join(f"{why} ({len(pairs)})" for why, pairs in found.items())
        for robot in subject.distinct_robots
        if (found := exemptions(robot.model))
    )

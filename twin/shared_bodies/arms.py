"""Arms of one description: robots of a cell whose descriptions and bases are the same, and whose joints are not.

Each arm moves the joints that lead to its flange. The links that hang on them are its own; links that no arm moves are
shared.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Set
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from planning.errors import FittingError, RobotModelError
from planning.files import is_file, resolve_file_name
from planning.robots.descriptions.fitting import Fitting, free_kinds, hold_joints
from planning.robots.descriptions.read_description import read_description
from planning.robots.descriptions.urdf_file import checked_tree, moving_order
from planning.robots.descriptions.xml_files import search_folders
from planning.robots.registry import ROBOTS
from twin.scenario.sections.cell import CellSection, RobotSection

_SAME = 1e-6
"""Bases that differ by less are the same [m, rad]."""


@dataclass(frozen=True)
class Arm:
    """A robot as a part of its description.

    Attributes:
        name: name of the robot.
        held: joints that its section holds, with their values [rad or m].
        way: joints between the root and the flange that are not fixed in the description.
        moved: those of them that are not held.
        above: joints between the root and each link, the link's own first.
        plain: links that can be touched, and have no visual shapes.
    """

    name: str
    held: Mapping[str, float]
    way: Set[str]
    moved: Set[str]
    above: Mapping[str, tuple[str, ...]]
    plain: Set[str]

    @property
    def links(self) -> frozenset[str]:
        """The links that it moves."""
        return frozenset(
            link for link, own in self.above.items() if not self.moved.isdisjoint(own)
        )

    def shared_with(self, others: list[Arm]) -> frozenset[str]:
        """Return the links that neither it nor any of the others moves."""
        return frozenset(self.above).difference(
            self.links, *(arm.links for arm in others)
        )


def without_other_arms(
    fitting: Fitting, robot: RobotSection, cell: CellSection, folder: Path
) -> Fitting:
    """Return the changes to a description that leave a robot what is its own.

    The other arms are removed, and the shapes of the links that all share: these are fixtures. Where all of them have
    looks, the first of the robots is drawn with them in place of the fixtures.

    Args:
        fitting: the other changes.
        robot: a robot of the cell.
        cell: the cell.
        folder: where relative paths start.

    Raises:
        FittingError: two arms contradict each other, or one would move the base of the other.
    """
    own, others = arms_beside(robot, cell, folder)
    if own is None or not others:
        return fitting
    listed = [section.name for section in cell.robots]
    for other in others:
        fault = _contradiction(own, other)
        if fault and listed.index(other.name) > listed.index(robot.name):
            return fitting  # it is said of the other one
        if fault:
            raise FittingError(fault, key="joints")
    if robot.base_error is not None:
        names = ", ".join(arm.name for arm in others)
        raise FittingError(
            f"{robot.name} is an arm of one body with {names}, and the place of a body that is shared is taken as"
            " exact: base_error is not for such arms",
            key="base_error",
        )
    removed = frozenset[str]().union(*(arm.links for arm in others))
    held = {k: v for arm in (*others, own) for k, v in arm.held.items()}
    gone = own.moved | {own.above[link][0] for link in removed}
    shared = own.shared_with(others)
    first = min((own, *others), key=lambda arm: listed.index(arm.name))
    return replace(
        fitting,
        held={name: value for name, value in held.items() if name not in gone},
        removed=removed,
        emptied=shared,
        looks=own is first and shared.isdisjoint(own.plain),
    )


def arms_beside(
    robot: RobotSection, cell: CellSection, folder: Path
) -> tuple[Arm | None, list[Arm]]:
    """Return a robot as a part of its description, and the other arms on the same body.

    Args:
        robot: a robot of the cell.
        cell: the cell.
        folder: where relative paths start.

    Returns:
        None and no arms where it is alone, or its description cannot be used.
    """
    candidates = [
        other
        for other in cell.robots
        if other.name != robot.name
        and (other.flange, other.joints) != (robot.flange, robot.joints)
        and np.allclose(other.base.transform(), robot.base.transform(), atol=_SAME)
    ]
    path = _file_of(robot, folder) if candidates else None
    if path is None:
        return None, []
    own = _arm(path, robot)
    others = [_arm(path, k) for k in candidates if _file_of(k, folder) == path]
    if own is None:
        return None, []
    return own, [arm for arm in others if arm is not None and arm.moved != own.moved]


def _contradiction(one: Arm, other: Arm) -> str | None:
    """Return why two arms cannot be on one body, naming both; None where they can."""
    both = f"{other.name} and {one.name} are arms of one body"
    for name in sorted(one.held.keys() & other.held.keys()):
        if one.held[name] != other.held[name]:
            return (
                f"{both}, and joint {name!r} of it is held at {other.held[name]:g} by {other.name} and at"
                f" {one.held[name]:g} by {one.name}: hold it at one value"
            )
    for name in sorted(one.way & other.way & (one.moved | other.moved)):
        return (
            f"{both}, and joint {name!r} carries both: no robot can move the base of another one; hold it in both,"
            f" with 'joints: {{{name}: 0}}'"
        )
    return None


def _file_of(robot: RobotSection, folder: Path) -> Path | None:
    """Return the description of a robot, None where it is a registered one or not there."""
    if robot.model in ROBOTS:
        return None
    try:
        path = resolve_file_name(robot.model, folder, RobotModelError).resolve()
    except (OSError, ValueError, RobotModelError):
        return None
    return path if is_file(path) else None


def _arm(path: Path, robot: RobotSection) -> Arm | None:
    """Return a robot as a part of its description, None where that cannot be used: why is said when it is read."""
    held, stamp = tuple(sorted(robot.joints.items())), path.stat().st_mtime_ns
    return _read_arm(path, stamp, robot.name, robot.flange, held)


@lru_cache(maxsize=64)
def _read_arm(
    path: Path,
    stamp: int,
    name: str,
    flange: str | None,
    held: tuple[tuple[str, float], ...],
) -> Arm | None:
    try:
        root, dirs = read_description(path), search_folders(path)
        whole = checked_tree(root, path, dirs, free_kinds(root))
        still = copy.deepcopy(root)
        hold_joints(still, path, dict(held))
        tree = checked_tree(still, path, dirs, free_kinds(still))
        end = flange or tree.child_of(moving_order(still, path)[-1])
    except (RobotModelError, IndexError):
        return None
    if end not in tree.parents:
        return None
    way = whole.moving.keys() & whole.joints_to(end)
    above = {link: whole.joints_to(link) for link in (whole.root, *whole.parents)}
    plain = {
        str(link.get("name"))
        for link in root.findall("link[collision]")
        if link.find("visual") is None
    }
    return Arm(name, dict(held), way, way & tree.moving.keys(), above, plain)

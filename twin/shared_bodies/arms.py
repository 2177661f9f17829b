"""Arms of one description: robots of a cell whose descriptions and bases are the same, and whose joints are not.

Each arm moves the joints that lead to its flange. The links that hang on them are its own; links that no arm moves are
shared.
"""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from planning.errors import FittingError, RobotModelError
from planning.files import is_file, resolve_file_name
from planning.robots.descriptions.fitting import Fitting, free_kinds, hold_joints
from planning.robots.descriptions.read_description import read_description
from planning.robots.descriptions.urdf_file import LinkTree, checked_tree, moving_order
from planning.robots.descriptions.xml_files import search_folders
from planning.robots.registry import ROBOTS
from twin.planning.fitted_robots import DESCRIPTION_FILE
from twin.registry import HOOKS
from twin.scenario.sections.cell import CellSection, RobotSection

_SAME = 1e-6
"""Bases that differ by less are the same [m, rad]."""


@dataclass(frozen=True)
class Arm:
    """A robot as a part of its description.

    Attributes:
        name: name of the robot.
        held: joints that its section holds, with their values [rad or m].
        tree: the whole description, with no joint held.
        leading: joints that lead to its flange, and can move.
        moved: those of them that are not held.
    """

    name: str
    held: Mapping[str, float]
    tree: LinkTree
    leading: Set[str]
    moved: Set[str]

    @property
    def links(self) -> set[str]:
        """The links that it moves."""
        tree, moved = self.tree, self.moved
        return {k for k in tree.parents if not moved.isdisjoint(tree.joints_to(k))}


def without_other_arms(
    fitting: Fitting, robot: RobotSection, cell: CellSection, folder: Path
) -> Fitting:
    """Return the changes to a description that leave a robot what is its own.

    The other arms are removed, and the shapes of the links that all share: these are fixtures. They are drawn with
    the first of the robots.

    Raises:
        FittingError: two arms contradict each other, or one would move the base of the other.
    """
    own, others = arms_beside(robot, cell, folder)
    if own is None or not others:
        return fitting
    order = {section.name: k for k, section in enumerate(cell.robots)}
    for other in others:
        fault = _contradiction(own, other)
        if fault:
            if order[other.name] < order[own.name]:
                raise FittingError(fault, key="joints")
            return fitting  # it is said of the other one
    if robot.base_error is not None:
        raise FittingError(
            f"{own.name} is an arm of one body with {', '.join(arm.name for arm in others)}, and the place of a body"
            " that is shared is taken as exact: base_error is not for such arms",
            key="base_error",
        )
    tree, removed = own.tree, frozenset[str]().union(*(arm.links for arm in others))
    held = {k: v for arm in (*others, own) for k, v in arm.held.items()}
    gone = own.moved | {tree.parents[link][1] for link in removed}
    return replace(
        fitting,
        held={name: value for name, value in held.items() if name not in gone},
        removed=removed,
        emptied=frozenset((tree.root, *tree.parents)) - removed - own.links,
        looks=all(order[own.name] < order[other.name] for other in others),
    )


def arms_beside(
    robot: RobotSection, cell: CellSection, folder: Path
) -> tuple[Arm | None, list[Arm]]:
    """Return a robot as a part of its description, and the other arms on the same body.

    The first is None where it is alone, or its description cannot be used.
    """
    base = robot.base.transform()
    candidates = [
        other
        for other in cell.robots
        if other.name != robot.name
        and (other.flange, other.joints) != (robot.flange, robot.joints)
        and np.allclose(other.base.transform(), base, atol=_SAME)
    ]
    path = _description(robot, folder) if candidates else None
    own = None if path is None else _arm(path, robot)
    if path is None or own is None:
        return None, []
    others = [_arm(path, k) for k in candidates if _description(k, folder) == path]
    return own, [arm for arm in others if arm and arm.moved != own.moved]


def _contradiction(one: Arm, other: Arm) -> str | None:
    """Return why two arms cannot be on one body, naming both; None where they can."""
    both = f"{other.name} and {one.name} are arms of one body"
    for name in sorted(one.held.keys() & other.held.keys()):
        if one.held[name] != other.held[name]:
            return (
                f"{both}, and joint {name!r} of it is held at {other.held[name]:g} by {other.name} and at"
                f" {one.held[name]:g} by {one.name}: hold it at one value"
            )
    for name in sorted(one.leading & other.leading & (one.moved | other.moved)):
        return (
            f"{both}, and joint {name!r} carries both: no robot can move the base of another one; hold it in both,"
            f" with 'joints: {{{name}: 0}}'"
        )
    return None


def _description(robot: RobotSection, folder: Path) -> Path | None:
    """Return the file of a robot, None where it is a registered one or not there."""
    try:
        path = resolve_file_name(robot.model, folder, RobotModelError).resolve()
        if DESCRIPTION_FILE in HOOKS:
            path = HOOKS.load(DESCRIPTION_FILE)(path, robot.xacro)
    except (OSError, ValueError, RobotModelError):
        return None
    return path if robot.model not in ROBOTS and is_file(path) else None


def _arm(path: Path, robot: RobotSection) -> Arm | None:
    """Return a robot as a part of its description; None where that cannot be used, which is said when it is read."""
    held, stamp = tuple(robot.joints.items()), path.stat().st_mtime_ns
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
        hold_joints(root, path, dict(held))
        still = checked_tree(root, path, dirs, free_kinds(root))
        end = flange or still.child_of(moving_order(root, path)[-1])
    except (RobotModelError, IndexError):
        return None
    leading = whole.moving.keys() & whole.joints_to(end)
    return Arm(name, dict(held), whole, leading, leading & still.moving.keys())

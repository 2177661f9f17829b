"""The bodies that move with a robot, collected once for each load that it carries."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, permutations

import numpy as np

from planning.cell.workcell import Attachment, CellObject, PlacedRobot, Workcell
from planning.files import KeptAnswers
from planning.geometry.exact import Solid
from planning.geometry.hull_table import HullTable, hull_table
from planning.geometry.swept import SKIP
from planning.kinematics.chain import placed_joints
from planning.transforms import Array, Indices

Held = tuple[CellObject, Attachment]

AllowedPairs = Iterable[frozenset[str]]
"""Unordered pairs of entities that may touch."""


@dataclass(frozen=True)
class RobotBodies:
    """Bodies that move with a robot: its parts, then the pieces of the objects it holds.

    Attributes:
        solids: for exact decisions; a part is named ``"<robot>/<group>:<body>"``.
        entities: as allowed contacts name them, in the order of the bodies.
        hulls: their corners, in one segment.
        self_limits: least distance between two of them, upper triangle, SKIP for none.
        parts: how many belong to the robot itself.
    """

    solids: tuple[Solid, ...]
    entities: tuple[str, ...]
    hulls: HullTable
    self_limits: Array
    parts: int

    def numbered(self, numbers: Mapping[str, int]) -> Indices:
        """Return the number of each body's entity."""
        return np.array([numbers[name] for name in self.entities], dtype=np.int64)

    @cached_property
    def of_entity(self) -> Mapping[str, list[int]]:
        """The bodies of each entity."""
        return places_of(self.entities)

    def limits_within(self, allowed: AllowedPairs) -> Array:
        """Return ``self_limits`` where parts may touch something held, as pairs of entities say."""
        limits, own = self.self_limits.copy(), self.of_entity
        parts = {e: [k for k in own[e] if k < self.parts] for e in own}
        held = {e: [k for k in own[e] if k >= self.parts] for e in own}
        skip_allowed(limits, parts, held, allowed)
        return limits


_KNOWN: KeptAnswers[RobotBodies] = KeptAnswers(4000)


GROUPS = ("arm", "tool")
"""Groups of a robot's bodies, each an entity of its own."""


def entity(robot: str, group: str) -> str:
    """Return the name by which allowed contacts speak of a robot's arm or tool."""
    return f"{robot}/{group}"


def entity_numbers(robots: Iterable[str], things: Iterable[str]) -> dict[str, int]:
    """Return the numbers of entities by their names: arm and tool of each robot, then things.

    Args:
        robots: names of the robots.
        things: names of objects and fixtures.
    """
    names = [entity(robot, group) for robot in robots for group in GROUPS]
    return {name: number for number, name in enumerate([*names, *things])}


def cell_entities(cell: Workcell) -> dict[str, int]:
    """Return the number of every entity of a cell: of robots, fixtures, objects."""
    things = [f.name for f in cell.fixtures] + [item.name for item in cell.objects]
    return entity_numbers((robot.name for robot in cell.robots), things)


def limits_of_entities(
    numbers: Mapping[str, int], least: float, allowed: AllowedPairs
) -> Array:
    """Return the least distance of two entities, SKIP where they may touch, shape (e, e) [m].

    Args:
        numbers: of the entities.
        least: distance of those that may not touch [m].
        allowed: unordered pairs that may; of entities without a number, too.
    """
    limits, places = np.full((len(numbers), len(numbers)), least), places_of(numbers)
    skip_allowed(limits, places, places, allowed)
    return limits


def places_of(names: Iterable[str]) -> dict[str, list[int]]:
    """Return at which places each name stands."""
    found: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        found.setdefault(name, []).append(k)
    return found


def skip_allowed(
    limits: Array,
    rows: Mapping[str, Sequence[int]],
    columns: Mapping[str, Sequence[int]],
    allowed: AllowedPairs,
) -> None:
    """Write SKIP into a table of least distances where two entities may touch.

    Args:
        limits: the table.
        rows, columns: of entities, by name.
        allowed: unordered pairs of entities.
    """
    for one, other in chain.from_iterable(permutations(pair, 2) for pair in allowed):
        if one in rows and other in columns:
            limits[np.ix_(rows[one], columns[other])] = SKIP


def robot_bodies(robot: PlacedRobot, held: Sequence[Held] = ()) -> RobotBodies:
    """Return the bodies that move with a robot and the objects it holds.

    Args:
        robot: the placed robot.
        held: objects in its hand, each with its pose in the flange frame.
    """
    key = (
        robot.model,
        robot.name,
        robot.base.tobytes(),
        robot.base_error,
        *((item.name, item.shape, at.pose.tobytes()) for item, at in held),
    )
    return _KNOWN.get(key, lambda: _collect(robot, held))


def _collect(robot: PlacedRobot, held: Sequence[Held]) -> RobotBodies:
    model, joints = robot.model, placed_joints(robot)
    groups = [entity(robot.name, part.group) for part in model.parts]
    if held:
        solids = list(robot_bodies(robot).solids)
    else:
        solids = [
            Solid(f"{group}:{part.body.name}", part.body, np.eye(4), joints, part.joint)
            for group, part in zip(groups, model.parts, strict=True)
        ]
    solids += [
        Solid(item.name, piece, model.flange @ at.pose, joints, model.dof - 1)
        for item, at in held
        for piece in item.shape.pieces
    ]
    parts, count = len(groups), len(solids)
    # Parts are held apart from a load, it not from itself.
    limits = np.full((count, count), SKIP)
    limits[np.triu_indices(parts, 1, count)] = 0.0
    for i, j in model.never_collide:
        limits[i, j] = SKIP
    q, which = np.zeros((1, model.dof)), np.arange(count, dtype=np.int32)[None]
    return RobotBodies(
        tuple(solids),
        (*groups, *(solid.name for solid in solids[parts:])),
        hull_table(joints, q, q, which, solids),
        limits,
        parts,
    )


def held_by(
    robot: str, placed: Iterable[tuple[CellObject, Attachment | None]]
) -> list[Held]:
    """Return the objects that a robot holds."""
    return [(item, at) for item, at in placed if at is not None and at.holder == robot]

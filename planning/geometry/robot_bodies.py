"""Bodies that move with a robot: its links and the objects that it holds.

The module also bounds the position error of these bodies while a skill is under force control.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, permutations

import numpy as np

from planning.caches import BoundedCache
from planning.cell.workcell import (
    Attachment,
    CellObject,
    PlacedRobot,
    PoseError,
    Workcell,
)
from planning.geometry.exact import Solid
from planning.geometry.hull_table import HullTable, hull_table
from planning.geometry.swept import SKIP
from planning.kinematics.chain import placed_joints
from planning.kinematics.kinematics import joint_poses_of
from planning.transforms import Array, Indices

Held = tuple[CellObject, Attachment]

AllowedPairs = Iterable[frozenset[str]]
"""Unordered pairs of entities that may touch."""

_KNOWN: BoundedCache[RobotBodies] = BoundedCache(4000)
_TABLES: BoundedCache[HullTable] = BoundedCache(4000)


GROUPS = ("arm", "tool")
"""Groups of a robot's bodies, each an entity of its own."""

_SECOND_ORDER = 1.2
"""Bounds of links are this times what the first order says. The proof asks for 1.1, with bounds that are
not quite the same, so what is planned is proved as well."""

UNREACHED = 1e-6
"""Directions in which the flange moves by less than this share of the best one are left out: the joints
cannot go there."""


@dataclass(frozen=True)
class RobotBodies:
    """Bodies that move with a robot: its links, then the pieces of the objects it holds.

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
        """Return the entity number of each body."""
        return np.array([numbers[name] for name in self.entities], dtype=np.int64)

    @cached_property
    def of_entity(self) -> Mapping[str, list[int]]:
        """The bodies of each entity."""
        return indices_by_name(self.entities)

    def limits_within(self, allowed: AllowedPairs) -> Array:
        """Return ``self_limits`` with the allowed contacts between own parts and held objects."""
        limits = self.self_limits.copy()
        mark_allowed_contacts(limits, *self._parts_and_held, allowed)
        return limits

    @cached_property
    def _parts_and_held(self) -> tuple[dict[str, list[int]], dict[str, list[int]]]:
        """The bodies of each entity, split into robot parts and held objects."""
        own = self.of_entity
        return (
            {e: [k for k in own[e] if k < self.parts] for e in own},
            {e: [k for k in own[e] if k >= self.parts] for e in own},
        )


def entity_name(robot: str, group: str) -> str:
    """Return the entity name of a robot's arm or tool in allowed contacts."""
    return f"{robot}/{group}"


def entity_numbers(robots: Iterable[str], things: Iterable[str]) -> dict[str, int]:
    """Return the numbers of entities by name: arm and tool of each robot, then things.

    Args:
        robots: names of the robots.
        things: names of objects and fixtures.
    """
    names = [entity_name(robot, group) for robot in robots for group in GROUPS]
    return {name: number for number, name in enumerate([*names, *things])}


def cell_entities(cell: Workcell) -> dict[str, int]:
    """Return the number of every entity of a cell: robots, fixtures, objects."""
    things = [f.name for f in cell.fixtures] + [item.name for item in cell.objects]
    return entity_numbers((robot.name for robot in cell.robots), things)


def limits_of_entities(
    numbers: Mapping[str, int], least: float, allowed: AllowedPairs
) -> Array:
    """Return the least distances of entities, SKIP where they may touch, shape (e, e) [m].

    Args:
        numbers: of the entities.
        least: distance of those that may not touch [m].
        allowed: unordered pairs that may; of entities without a number, too.
    """
    limits, places = (
        np.full((len(numbers), len(numbers)), least),
        indices_by_name(numbers),
    )
    mark_allowed_contacts(limits, places, places, allowed)
    return limits


def indices_by_name(names: Iterable[str]) -> dict[str, list[int]]:
    """Return the indices at which each name occurs."""
    found: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        found.setdefault(name, []).append(k)
    return found


def mark_allowed_contacts(
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
            for row in rows[one]:
                limits[row, columns[other]] = SKIP


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
    groups = [entity_name(robot.name, part.group) for part in model.parts]
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
    # Equal objects differ in nothing but their names.
    key = joints, *map(_content, solids[parts:])
    return RobotBodies(
        tuple(solids),
        (*groups, *(solid.name for solid in solids[parts:])),
        _TABLES.get(key, lambda: hull_table(joints, q, q, which, solids)),
        limits,
        parts,
    )


def _content(solid: Solid) -> tuple[bytes, ...]:
    """Return the pose, the corners and the capsules of a carried body."""
    body, around = solid.body, solid.body.capsules
    arrays = solid.local, body.vertices, around.start, around.end, around.radius
    return tuple(array.tobytes() for array in arrays)


def objects_held_by(
    robot: str, placed: Iterable[tuple[CellObject, Attachment | None]]
) -> list[Held]:
    """Return the objects that a robot holds."""
    return [(item, at) for item, at in placed if at is not None and at.holder == robot]


def position_error_bound(
    robot: PlacedRobot, path: Array, error: PoseError, solids: Sequence[Solid]
) -> Array:
    """Return a bound on the position error of each body anywhere on a path, shape (solids,) [m].

    Args:
        robot: the robot that follows it.
        path: configurations, shape (s, n).
        error: of the flange.
        solids: bodies of the robot, and what it holds.
    """
    frames, tip = (
        np.stack([joint_poses_of(robot, q) for q in path]),
        robot.model.dof - 1,
    )
    turns = _turns(robot, frames)
    answers = np.linalg.pinv(flange_jacobians(robot, frames), rcond=UNREACHED)
    out = np.zeros(len(solids))
    for k, solid in enumerate(solids):
        if solid.joint < 0:
            continue
        points = solid.vertices
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        if solid.joint == tip:
            at = robot.model.flange[:3, 3]
            out[k] = error.displacement(
                float(np.linalg.norm(points - at, axis=1).max())
            )
            continue
        radius = float(np.linalg.norm(points - middle, axis=1).max())
        frame, own = frames[:, solid.joint + 1], slice(0, solid.joint + 1)
        centre = frame[:, :3, :3] @ middle + frame[:, :3, 3]
        moves = (
            _translational_jacobians(robot, frames, centre)[:, :, own] @ answers[:, own]
        )
        spins = turns[:, :, own] @ answers[:, own]
        of_way, of_turn = (
            _stretch(moves[..., part]) + radius * _stretch(spins[..., part])
            for part in (slice(0, 3), slice(3, 6))
        )
        most = (error.m * of_way + error.rad * of_turn).max()
        out[k] = _SECOND_ORDER * float(most)
    return out


def flange_jacobians(robot: PlacedRobot, frames: Array) -> Array:
    """Return the Jacobians of the flange, translation above rotation, shape (s, 6, n).

    Args:
        robot: the robot.
        frames: world poses of its base and joints, shape (s, n + 1, 4, 4).
    """
    flange = (frames[:, -1] @ robot.model.flange)[:, :3, 3]
    return np.concatenate(
        [_translational_jacobians(robot, frames, flange), _turns(robot, frames)], axis=1
    )


def _axes(robot: PlacedRobot, frames: Array) -> Array:
    """Return the axes of the joints in the world, shape (s, n, 3)."""
    local = robot.model.chain.axis
    return np.asarray(np.einsum("snij,nj->sni", frames[:, 1:, :3, :3], local))


def _translational_jacobians(robot: PlacedRobot, frames: Array, points: Array) -> Array:
    """Return the translational Jacobians of points that all joints carry, shape (s, 3, n)."""
    axes, slides = _axes(robot, frames), np.asarray(robot.model.chain.prismatic)
    turned = np.cross(axes, points[:, None] - frames[:, 1:, :3, 3])
    return np.swapaxes(np.where(slides[:, None], axes, turned), 1, 2)


def _turns(robot: PlacedRobot, frames: Array) -> Array:
    """Return the rotational Jacobians of points that all joints carry, shape (s, 3, n)."""
    slides = np.asarray(robot.model.chain.prismatic)[:, None]
    return np.swapaxes(np.where(slides, 0.0, _axes(robot, frames)), 1, 2)


def _stretch(maps: Array) -> Array:
    """Return the largest singular values of matrices of shape (s, 3, 3), as shape (s,)."""
    return np.asarray(np.linalg.norm(maps, ord=2, axis=(1, 2)))


def with_deviations(
    bodies: RobotBodies, robot: PlacedRobot, path: Array, error: PoseError
) -> RobotBodies:
    """Return the bodies of a robot that may deviate from its path, see ``position_error_bound``."""
    off = position_error_bound(robot, path, error, bodies.solids).tolist()
    solids = tuple(
        replace(solid, deviates=far)
        for solid, far in zip(bodies.solids, off, strict=True)
    )
    table = bodies.hulls
    hulls = hull_table(table.robot, table.q_a, table.q_b, table.solid, solids)
    return replace(bodies, solids=solids, hulls=hulls)

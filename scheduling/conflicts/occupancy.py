"""Occupancy of nodes: the swept volume of a robot, its tool and its handled objects, segment by segment.

The path of every node is divided into straight joint-space segments, in each of which no point of the robot
moves further than ``MOTION``. The swept volume of a segment contains the whole continuous motion, so no
collision between samples is missed.

An object that a node picks up or puts down belongs to the occupancy of the whole node: at rest before
the pick or after the placement, and carried in between. So a conflict with the object at rest is a
conflict with that node.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from planning.cell.body import ConvexBody
from planning.cell.shape import Shape
from planning.cell.workcell import PlacedRobot, PoseError, Workcell
from planning.geometry.exact import Solid, resting_solid
from planning.geometry.hull_table import HullTable, hull_table, standing_hulls
from planning.geometry.robot_bodies import position_error_bound, robot_bodies
from planning.geometry.swept import bound_travel
from planning.kinematics.chain import empty_chain_table, placed_joints, standing_at
from planning.packed import packed
from planning.transforms import Array, Indices, Transform, inverse
from scheduling.conflicts.allowed_contacts import ALWAYS
from scheduling.conflicts.object_spans import ObjectSpan, Rest
from scheduling.conflicts.swept_sequence import LEAF, SweptSequence, swept_sequence
from scheduling.graph.temporal_plan_graph import NodeChain

MOTION = 0.02
"""Largest displacement of any point of the robot within one segment [m]."""

_NO_TASK = np.full(1, ALWAYS, dtype=np.int64)
"""Tasks of a single segment that belongs to no node."""

_Run = tuple[ObjectSpan, int, int]
"""An object, and the segments, ``range(first, stop)``, in which it is present."""

_PieceRun = tuple[ConvexBody, ObjectSpan, int, int]
"""A convex piece of an object, the object, and the segments in which it is present."""


@dataclass(frozen=True)
class Occupancy:
    """Occupancy of one robot, or of one object at rest.

    Attributes:
        sequence: the segments and the tree of swept capsules over them.
        solids: the bodies that occur.
    """

    sequence: SweptSequence
    solids: tuple[Solid, ...]

    @property
    def hulls(self) -> HullTable:
        """Corners of the bodies, and their segments."""
        return self.sequence.hulls

    @property
    def nodes(self) -> int:
        """Number of nodes, one for a resting object or a standing robot."""
        return int(self.sequence.node[-1]) + 1


def _cut_into_segments(
    robot: PlacedRobot,
    chain: NodeChain,
    held: Sequence[tuple[Shape, Transform]] = (),
) -> tuple[Array, Array, Indices, Indices]:
    """Cut the path of a chain into segments that move no point further than MOTION.

    Args:
        robot: the robot.
        chain: its nodes.
        held: objects that move with the robot, with their poses in the flange frame.

    Returns:
        Segment ends, shape (s, n) each; the node of each segment; and the waypoint within its
        node that each segment leads to, counted from 1, shape (s,).
    """
    q_b = np.array(chain.waypoints, dtype=np.float64)
    q_a = np.vstack([chain.start[None], q_b[:-1]])
    node = np.repeat(np.arange(len(chain)), np.diff(chain.first)).astype(np.int64)
    waypoint = np.arange(len(q_b)) - chain.first[node] + 1
    hulls = _with_load_sphere(robot, held)
    while True:
        travel = bound_travel(hulls, q_a, q_b)
        pieces = np.ceil(travel / MOTION).astype(np.int64)
        if np.max(pieces, initial=0) <= 1:
            return q_a, q_b, node, waypoint
        # The bound of a part is not proportional to its length, so the parts are measured again.
        np.maximum(pieces, 1, out=pieces)
        of = np.repeat(np.arange(len(pieces)), pieces)
        k = np.arange(len(of)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
        step = (q_b - q_a)[of] / pieces[of, None]
        cut_a = q_a[of] + k[:, None] * step
        q_b = np.where((k + 1 == pieces[of])[:, None], q_b[of], cut_a + step)
        # The end of a part and the start of the next one are bitwise equal.
        inner = np.flatnonzero(k > 0)
        cut_a[inner] = q_b[inner - 1]
        q_a, node, waypoint = cut_a, node[of], waypoint[of]


def _with_load_sphere(
    robot: PlacedRobot, held: Sequence[tuple[Shape, Transform]]
) -> HullTable:
    """Return a robot's bodies, and a sphere that contains everything it ever holds."""
    hulls = robot_bodies(robot).hulls
    if not held:
        return hulls
    loads = [
        Solid("", body, robot.model.flange @ pose)
        for shape, pose in held
        for body in shape.pieces
    ]
    ends = np.concatenate([load.ends for load in loads])
    radius = np.concatenate([load.body.capsules.radius for load in loads])
    low = (ends - radius[:, None, None]).min(axis=(0, 1))
    high = (ends + radius[:, None, None]).max(axis=(0, 1))
    centre = 0.5 * (low + high)
    with_sphere = hulls._replace(
        joint=np.append(hulls.joint, robot.model.dof - 1),
        corner_first=np.append(hulls.corner_first, hulls.corner_first[-1]),
        capsule_first=np.append(hulls.capsule_first, hulls.capsule_first[-1] + 1),
        ends=np.concatenate([hulls.ends, np.tile(centre, (1, 2, 1))]),
        radius=np.append(hulls.radius, 0.5 * np.linalg.norm(high - low)),
        deviates=np.append(hulls.deviates, 0.0),
    )
    return packed(with_sphere)


class _Segments(NamedTuple):
    """Segments of one robot, in order.

    Attributes:
        q_a, q_b: their ends, shape (s, n).
        node: the node of each, shape (s,).
        task, other_task: tasks of each, see ``is_contact_allowed``, shape (s,).
    """

    q_a: Array
    q_b: Array
    node: Indices
    task: Indices
    other_task: Indices


def chain_occupancy(
    cell: Workcell,
    chain: NodeChain,
    spans: Sequence[ObjectSpan],
    entities: Mapping[str, int],
    deviations: Mapping[int, PoseError] = MappingProxyType({}),
) -> Occupancy:
    """Return the occupancy of the nodes of one chain.

    Args:
        cell: the static cell.
        chain: the nodes.
        spans: the objects of this chain, see ``trace_objects``.
        entities: numbers of the entities.
        deviations: by task, how far the flange may be from its path in its skill nodes.
    """
    robot = cell.robot(chain.robot)
    bodies = {
        (s.object, s.pose.tobytes()): (cell.object(s.object).shape, s.pose)
        for s in spans
        if s.carried
    }
    q_a, q_b, node, waypoint = _cut_into_segments(robot, chain, tuple(bodies.values()))
    task = chain.task[node]
    found = [(span, *_segments_of(span, node, waypoint, chain)) for span in spans]
    runs = sorted((run for run in found if run[1] < run[2]), key=lambda run: run[1])
    segments = _Segments(q_a, q_b, node, task, task)
    deviating = [
        (*np.searchsorted(node, [k, k + 1]).tolist(), deviations[number])
        for k, number in enumerate(chain.task.tolist())
        if chain.skill[k] and number in deviations
    ]
    return _assemble(cell, robot, segments, runs, entities, deviating)


def hold_occupancy(
    cell: Workcell,
    chain: NodeChain,
    holds: Indices,
    spans: Sequence[ObjectSpan],
    entities: Mapping[str, int],
) -> Occupancy:
    """Return the occupancy of some holds of one robot, one segment each.

    Args:
        cell: the static cell.
        chain: the robot's nodes.
        holds: their numbers, ascending, at least one: hold k is before node k, the last one after
            the last node.
        spans: the objects of this chain.
        entities: numbers of the entities.
    """
    before = chain.waypoints[chain.first[holds] - 1]
    q = np.where((holds > 0)[:, None], before, chain.start).astype(np.float64)
    runs: list[_Run] = []
    for span in spans:
        if span.carried:
            # Held before node k: taken in an earlier node, given away in k or later.
            first, stop = np.searchsorted(holds, [span.start[0] + 1, span.end[0] + 1])
            if first < stop:
                runs.append((span, int(first), int(stop)))
    runs.sort(key=lambda run: run[1])
    last = max(len(chain) - 1, 0)
    task, other = (chain.task[np.clip(k, 0, last)] for k in (holds - 1, holds))
    segments = _Segments(q, q, np.arange(len(holds)), task, other)
    return _assemble(cell, cell.robot(chain.robot), segments, runs, entities, leaf=1)


def standing_occupancy(
    cell: Workcell, robot: PlacedRobot, entities: Mapping[str, int]
) -> Occupancy:
    """Return the occupancy of a robot without nodes: at HOME, in one segment."""
    q = np.array(robot.home[None], dtype=np.float64)
    segments = _Segments(q, q, np.zeros(1, dtype=np.int64), _NO_TASK, _NO_TASK)
    return _assemble(cell, robot, segments, [], entities)


def rest_occupancy(
    cell: Workcell,
    rest: Rest,
    entities: Mapping[str, int],
    holder: PlacedRobot | None = None,
) -> Occupancy:
    """Return the occupancy of an object at rest, or held by a standing robot."""
    pieces = cell.object(rest.object).shape.pieces
    solids = tuple(resting_solid(rest.object, body, rest.pose) for body in pieces)
    hulls = standing_hulls(solids)
    if holder is not None and holder.base_error:  # it is displaced as the robot is
        base = standing_at(empty_chain_table(), holder.base, holder.base_error)
        local = inverse(holder.base) @ rest.pose
        solids = tuple(Solid(rest.object, body, local, base) for body in pieces)
        hulls = hull_table(base, hulls.q_a, hulls.q_b, hulls.solid, solids)
    entity = np.full((1, len(solids)), entities[rest.object], dtype=np.int32)
    node = np.zeros(1, dtype=np.int64)
    return Occupancy(swept_sequence(node, _NO_TASK, _NO_TASK, entity, hulls), solids)


def _segments_of(
    span: ObjectSpan, node: Indices, waypoint: Indices, chain: NodeChain
) -> tuple[int, int]:
    """Return the segments, ``range(first, stop)``, in which an object is present."""
    room = int(np.max(np.diff(chain.first))) + 2
    leads_to = node * room + waypoint
    (a, wa), (b, wb) = span.start, span.end
    if not span.carried and (a, wa) == (b, wb):
        # At rest until a node's start, or from its end on: present up to the next waypoint, or from the last.
        if wa == 0:
            wb = 1
        else:
            wa -= 1
    first = np.searchsorted(leads_to - 1, a * room + wa, side="left")
    stop = np.searchsorted(leads_to, b * room + wb, side="right")
    return int(first), int(stop)


def _assemble(
    cell: Workcell,
    robot: PlacedRobot,
    segments: _Segments,
    runs: Sequence[_Run],
    entities: Mapping[str, int],
    deviating: Sequence[tuple[int, int, PoseError]] = (),
    *,
    leaf: int = LEAF,
) -> Occupancy:
    """Collect the bodies of the robot and, in slots, the pieces of objects in each run.

    Where the robot deviates, in segments ``range(first, stop)``, the bodies that move with it are enlarged
    by a bound on the error.
    """
    joints, own = placed_joints(robot), robot_bodies(robot)
    solids = list(own.solids)
    pieces = [
        (piece, *run)
        for run in runs
        for piece in cell.object(run[0].object).shape.pieces
    ]
    slots = _assign_slots(pieces)
    shape = (len(segments.q_a), own.parts + max(slots, default=-1) + 1)
    entity = np.full(shape, -1, dtype=np.int32)
    entity[:, : own.parts] = [entities[name] for name in own.entities]
    solid = np.full(shape, -1, dtype=np.int32)
    solid[:, : own.parts] = np.arange(own.parts)
    for (body, span, first, stop), slot in zip(pieces, slots, strict=True):
        if span.carried:
            local = robot.model.flange @ span.pose
            joint = robot.model.dof - 1
            item = Solid(span.object, body, local, joints, joint)
        else:
            item = resting_solid(span.object, body, span.pose)
        entity[first:stop, own.parts + slot] = entities[span.object]
        solid[first:stop, own.parts + slot] = len(solids)
        solids.append(item)
    for first, stop, error in deviating:
        path = np.vstack([segments.q_a[first], segments.q_b[first:stop]])
        here = solid[first:stop]
        moving = [k for k in np.unique(here[here >= 0]) if solids[k].carrier]
        off = position_error_bound(robot, path, error, [solids[k] for k in moving])
        place_of = np.arange(len(solids) + 1)  # the last one is for -1
        place_of[-1] = -1
        for k, far in zip(moving, off.tolist(), strict=True):
            place_of[k] = len(solids)
            solids.append(replace(solids[k], deviates=far))
        solid[first:stop] = place_of[here]
    hulls = hull_table(joints, segments.q_a, segments.q_b, solid, solids)
    tasks = segments.task, segments.other_task
    sequence = swept_sequence(segments.node, *tasks, entity, hulls, leaf=leaf)
    return Occupancy(sequence, tuple(solids))


def _assign_slots(runs: Sequence[_PieceRun]) -> list[int]:
    """Give runs that overlap different slots; ``runs`` in order of their first segment."""
    slots: list[int] = []
    free_from: list[int] = []
    for _, _, first, stop in runs:
        for slot, free in enumerate(free_from):
            if free <= first:
                free_from[slot] = stop
                slots.append(slot)
                break
        else:
            slots.append(len(free_from))
            free_from.append(stop)
    return slots

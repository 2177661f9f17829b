"""Occupancies of the robots, piece by piece, and which pieces may come near each other at once.

A *piece* is a straight joint-space motion of a node, or a robot that stands between two nodes.
Pieces are dense samples: the middle of the motion, grown by a bound of how far any point gets
from there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from planning.cell.workcell import PlacedRobot
from planning.transforms import Array, Indices
from scheduling.graph.temporal_plan_graph import NodeChain, TemporalPlanGraph
from scheduling.verification.graph_structure import Precedence
from scheduling.verification.object_places import Carried, Resting
from scheduling.verification.reference import TOLERANCE, Part, ReferenceRobot, measure

PIECE = 0.02
"""Motions are cut until no point gets further than this from the middle [m]."""


@dataclass(frozen=True)
class Pieces:
    """All pieces of one robot, in order.

    Attributes:
        q_a, q_b: ends, shape (s, n).
        begin: a node that is complete before ``begin`` starts is over before the piece; -1
            for a piece that may last from the start, shape (s,).
        end: the piece is over once node ``end`` is complete; the number of nodes for a piece
            that may last for ever, shape (s,).
        node: node that moves, or node before which the robot stands, shape (s,).
        standing: True where the robot stands, shape (s,).
        since, until: moments as node * room + waypoint, shape (s,).
        room: see there.
        tasks: tasks that may allow a contact, shape (s, 2).
    """

    q_a: Array
    q_b: Array
    begin: Indices
    end: Indices
    node: Indices
    standing: npt.NDArray[np.bool_]
    since: Indices
    until: Indices
    room: int
    tasks: Indices

    def __len__(self) -> int:
        """Return the number of pieces."""
        return len(self.begin)

    def moment(self, node: int, waypoint: int) -> int:
        """Return a moment as one number."""
        return node * self.room + waypoint


@dataclass(frozen=True)
class Body:
    """A part in the pieces in which it is there.

    Attributes:
        robot: the robot.
        part: the part.
        load: whether it is carried and no part of the robot.
        pieces: which ones, rising, shape (k,).
        turn: rotation of its joint in the middle of each piece, shape (k, 9).
        centre: of the sphere around it in the middle of each piece, shape (k, 3) [m].
        radius: of that sphere, grown by the motion within the piece, shape (k,) [m].
    """

    robot: RobotBodies
    part: Part
    load: bool
    pieces: Indices
    turn: Array
    centre: Array
    radius: Array


class RobotBodies:
    """One robot of the plan.

    Args:
        tpg: the plan.
        placed: the robot.
        robot: its geometry.
        carried: who carries what when.

    Attributes:
        name: of the robot.
        chain: index of its chain, None if it has no node.
        robot: its geometry.
        pieces: its pieces.
        frames: joint frames in the middle of each piece, shape (s, n + 1, 4, 4).
        bodies: its parts, then what it carries.
    """

    def __init__(
        self,
        tpg: TemporalPlanGraph,
        placed: PlacedRobot,
        robot: ReferenceRobot,
        carried: list[Carried],
    ) -> None:
        self.name, self.chain = placed.name, tpg.chain_index.get(placed.name)
        self.robot = robot
        loads = [
            (c, robot.load(c.object, tpg.cell.object(c.object).size, c.pose))
            for c in carried
            if c.chain == self.chain
        ]
        if self.chain is None:
            self.pieces = _standing_for_ever(placed.home)
        else:
            weights = np.array([p.weight for p in self.robot.parts])
            if loads:
                weights = np.vstack([weights, [part.weight for _, part in loads]])
            self.pieces = _cut(tpg.chains[self.chain], weights)
        middle = 0.5 * (self.pieces.q_a + self.pieces.q_b)
        self.frames = robot.joint_frames_along(middle)
        everywhere = np.arange(len(self.pieces))
        self.bodies = [self._body(p, False, everywhere) for p in self.robot.parts]
        for c, part in loads:
            since = self.pieces.moment(*c.start)
            until = self.pieces.moment(*c.end)
            inside = (self.pieces.since >= since) & (self.pieces.until <= until)
            if c.given:
                inside &= ~(self.pieces.standing & (self.pieces.since == since))
            if c.fetched:
                inside &= ~(self.pieces.standing & (self.pieces.until == until))
            if np.any(inside):
                self.bodies.append(self._body(part, True, np.flatnonzero(inside)))

    def _body(self, part: Part, load: bool, pieces: Indices) -> Body:
        frames = self.frames[pieces, part.joint + 1]
        centre = frames[:, :3, :3] @ part.centre + frames[:, :3, 3]
        step = np.abs(self.pieces.q_b[pieces] - self.pieces.q_a[pieces])
        radius = part.radius + 0.5 * step @ part.weight
        turn = frames[:, :3, :3].reshape(-1, 9)
        return Body(self, part, load, pieces, turn, centre, radius)


def _standing_for_ever(home: Array) -> Pieces:
    one = np.zeros(1, dtype=np.int64)
    return Pieces(
        home[None],
        home[None],
        one - 1,
        one,
        one,
        np.ones(1, dtype=np.bool_),
        one,
        one,
        1,
        np.full((1, 2), -1),
    )


def _cut(chain: NodeChain, weights: Array) -> Pieces:
    """Return the pieces of a chain: each hold, then the motions of the node after it."""
    count = len(chain)
    room = int(np.max(np.diff(chain.first))) + 1
    q_a, q_b, rows, tasks = [], [], [], []
    before = chain.start
    for node in range(count + 1):
        near = [int(chain.task[k]) for k in (node - 1, node) if 0 <= k < count]
        q_a.append(before)
        q_b.append(before)
        rows.append((node - 1, node, node, True, node * room, node * room))
        tasks.append((near[0], near[-1]))
        if node == count:
            break
        for k, q in enumerate(
            chain.waypoints[chain.first[node] : chain.first[node + 1]]
        ):
            reach = float(np.max(weights @ np.abs(q - before)))
            parts = max(1, int(np.ceil(0.5 * reach / PIECE)))
            ends = before + np.linspace(0.0, 1.0, parts + 1)[:, None] * (q - before)
            ends[-1] = q
            moment = node * room + k
            for a, b in pairwise(ends):
                q_a.append(a)
                q_b.append(b)
                rows.append((node, node, node, False, moment, moment + 1))
                tasks.append((int(chain.task[node]),) * 2)
            before = q
    begin, end, nodes, standing, since, until = np.array(rows, dtype=np.int64).T
    return Pieces(
        np.array(q_a),
        np.array(q_b),
        begin,
        end,
        nodes,
        standing.astype(np.bool_),
        since,
        until,
        room,
        np.array(tasks, dtype=np.int64),
    )


_BLOCK = 48


def over_before(
    chain: int | None, robot: RobotBodies, precedence: Precedence
) -> Indices:
    """Return, per piece of a robot, how many first nodes of a chain are complete before it."""
    begin = robot.pieces.begin
    if chain is None or robot.chain is None:
        return np.zeros(len(begin), dtype=np.int64)
    known = precedence.complete[chain][robot.chain]
    return np.where(begin >= 0, known[np.maximum(begin, 0)], 0)


def close_pairs(
    x: Body, y: Body, past_a: Indices, past_b: Indices, limit: float
) -> Iterator[tuple[Indices, Indices]]:
    """Yield pairs of pieces that may happen at once and in which two spheres come close.

    They come in groups, as positions in ``x.pieces`` and in ``y.pieces``.
    """
    end_a, end_b = x.robot.pieces.end[x.pieces], y.robot.pieces.end[y.pieces]
    past_a, past_b = past_a[y.pieces], past_b[x.pieces]
    for k in range(0, len(x.pieces), _BLOCK):
        block = slice(k, k + _BLOCK)
        j0 = int(np.searchsorted(end_b, past_b[block].min()))
        j1 = int(np.searchsorted(past_a, end_a[block].max(), side="right"))
        if j0 >= j1:
            continue
        centre, radius = x.centre[block], x.radius[block]
        low, high = centre.min(axis=0), centre.max(axis=0)
        others = y.centre[j0:j1]
        room = y.radius[j0:j1] + (float(radius.max()) + limit)
        gap = np.maximum(np.maximum(low - others, others - high), 0.0)
        near = np.flatnonzero(np.einsum("ij,ij->i", gap, gap) < room * room)
        if not len(near):
            continue
        others, room = others[near], y.radius[j0:j1][near]
        step = centre[:, None] - others[None]
        reach = radius[:, None] + room[None] + limit
        hit = np.einsum("ijk,ijk->ij", step, step) < reach * reach
        hit &= end_a[block][:, None] >= past_a[j0:j1][near][None]
        hit &= end_b[j0:j1][near][None] >= past_b[block][:, None]
        rows, columns = np.nonzero(hit)
        if len(rows):
            yield k + rows, j0 + near[columns]


def unsettled(
    x: Body, y: Body, close: tuple[Indices, Indices], limit: float
) -> Iterator[tuple[int, int]]:
    """Yield the pairs of pieces that one measurement for many of them does not settle.

    What is measured in the middle of two pieces holds for others as well, less what both parts
    are displaced from there to the middle of the others, and move within them.
    """
    rows, columns = close
    while len(rows):
        k = len(rows) // 2
        row, column = int(rows[k]), int(columns[k])
        i, j = int(x.pieces[row]), int(y.pieces[column])
        frame_x = x.robot.frames[i, x.part.joint + 1]
        frame_y = y.robot.frames[j, y.part.joint + 1]
        gap = measure(x.part, frame_x, y.part, frame_y)
        left = gap - _displaced(x, row, rows) - _displaced(y, column, columns)
        unsettled = left < limit - TOLERANCE
        if unsettled[k]:
            unsettled[k] = False
            yield i, j
        rows, columns = rows[unsettled], columns[unsettled]


def _displaced(body: Body, start: int, others: Indices) -> Array:
    """Return how far any point of a body gets from one piece's middle in other pieces [m]."""
    low = min(int(others.min()), start)
    span = slice(low, max(int(others.max()), start) + 1)
    turned = body.turn[span] - body.turn[start]
    shift = body.centre[span] - body.centre[start]
    angle = np.sqrt(np.einsum("ij,ij->i", turned, turned) / 2.0)
    moved = np.sqrt(np.einsum("ij,ij->i", shift, shift))
    within = body.radius[span] - body.part.radius
    return np.asarray((moved + body.part.radius * angle + within)[others - low])


def while_there(
    robot: RobotBodies, rest: Resting, precedence: Precedence
) -> npt.NDArray[np.bool_]:
    """Return, per piece of a robot, whether it may happen while something is at rest."""
    pieces = robot.pieces
    out = np.ones(len(pieces), dtype=np.bool_)
    if robot.chain is None:
        return out
    if rest.put is not None:
        chain, node, waypoint = rest.put
        if chain == robot.chain:
            out &= pieces.until > pieces.moment(node, waypoint)
        else:
            out &= pieces.end >= precedence.complete[robot.chain][chain][node]
    if rest.taken is not None:
        chain, node, waypoint = rest.taken
        if chain == robot.chain:
            out &= pieces.since < pieces.moment(node, waypoint)
        else:
            out &= over_before(chain, robot, precedence) <= node
    return out

"""Geometry of the robots of a plan, piece by piece: poses of their bodies, swept volumes, and deviation bounds.

A *piece* is a straight joint-space motion within a node, or a robot at rest between two nodes.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from planning.cell.workcell import NO_ERROR, PlacedRobot, PoseError
from planning.transforms import Array, Indices
from scheduling.graph.temporal_plan_graph import NodeChain, TemporalPlanGraph
from scheduling.verification.deviating_links import DeviatingLinks, deviating_nodes
from scheduling.verification.graph_structure import Precedence
from scheduling.verification.object_places import Carried, Resting
from scheduling.verification.problems import Moment
from scheduling.witness.motion import Motion
from scheduling.witness.parts import ConvexPart, measure, resting_parts
from scheduling.witness.robot import WitnessRobot
from scheduling.witness.sweeps import SweepBounds

PIECE = 0.02
"""Motions are cut until no point gets further than this from the middle [m]."""


@dataclass(frozen=True)
class Pieces:
    """All pieces of one robot, in order.

    Attributes:
        knots: piece k leads from knot k to knot k + 1, shape (s + 1, n).
        node: node of the motion, or node before which the robot stands; the piece is over once it is
            complete. The number of nodes where the robot stands after its last node, shape (s,).
        standing: True where the robot stands, shape (s,).
        since: moment at which the piece begins, as node * room + waypoint, shape (s,).
        room: factor of the node in ``since``.
        tasks: tasks that may allow a contact, shape (s, 2).
    """

    knots: Array
    node: Indices
    standing: npt.NDArray[np.bool_]
    since: Indices
    room: int
    tasks: Indices

    def __len__(self) -> int:
        """Return the number of pieces."""
        return len(self.node)

    @cached_property
    def keys(self) -> Indices:
        """Key of each piece: the same for all pieces of a node, another one for the standstill before it."""
        return 2 * self.node + self.standing

    @cached_property
    def begin(self) -> Indices:
        """Last node that has started when the piece begins; -1 for none."""
        return self.node - self.standing

    @cached_property
    def until(self) -> Indices:
        """Moment at which the piece ends."""
        return self.since + ~self.standing

    def moment(self, node: int, waypoint: int) -> int:
        """Return the moment of a waypoint in a node as one number."""
        return node * self.room + waypoint


@dataclass(frozen=True)
class Body:
    """A part of a robot, or everything that it carries at any time.

    Attributes:
        motions: motion of the part; or of the parts of loads.
        spans: pieces during which each of them is there.
        which: index of the present one in each piece, -1 for none, shape (s,).
        load: whether it is a load and not a part of the robot.
    """

    motions: tuple[Motion, ...]
    spans: tuple[range, ...]
    which: Indices
    load: bool


class VerifiedRobot:
    """One robot of the plan.

    Args:
        tpg: the plan.
        placed: the robot.
        robot: its geometry.
        carried: the objects carried by each robot over time.
        error: error of its base, None for that of the cell.
        deviations: deviations of its flange by skill, None for those of the cell.

    Attributes:
        name: name of the robot.
        error: error of its base.
        origin: origin of its base, shape (3,) [m].
        home: its HOME, shape (n,).
        chain: index of its chain, None if it has no node.
        pieces: its pieces.
        bodies: its parts, then its loads.
    """

    def __init__(
        self,
        tpg: TemporalPlanGraph,
        placed: PlacedRobot,
        robot: WitnessRobot,
        carried: list[Carried],
        error: PoseError | None = None,
        deviations: Mapping[str, PoseError] | None = None,
    ) -> None:
        self.name, self.chain = placed.name, tpg.chain_index.get(placed.name)
        self.error = placed.base_error if error is None else error
        self.origin = placed.base[:3, 3]
        self.home = placed.home
        self._at_home = robot.joint_frames_along(placed.home[None])[0]
        loads = [
            (c, part)
            for c in carried
            if c.chain == self.chain
            for part in robot.loads(c.object, tpg.cell.object(c.object).shape, c.pose)
        ]
        if self.chain is None:
            self.pieces = _standing_pieces(placed.home)
        else:
            # On the same joint, that with the greatest reach outweighs all others at every joint.
            weights: dict[int, Array] = {}
            for part in [*robot.parts, *(part for _, part in loads)]:
                known = weights.get(part.joint, part.weight)
                weights[part.joint] = np.maximum(known, part.weight)
            self.pieces = _cut(tpg.chains[self.chain], np.array([*weights.values()]))
        knots = self.pieces.knots
        frames = robot.joint_frames_along(knots)
        off = np.zeros((len(self.pieces), 2))
        skills = tpg.cell.deviations if deviations is None else deviations
        if skills and self.chain is not None:
            moving = ~self.pieces.standing
            of_node = deviating_nodes(tpg, tpg.chains[self.chain], skills)
            off[moving] = of_node[self.pieces.node[moving]]
        links = DeviatingLinks(robot, frames, off)
        everywhere = np.zeros(len(self.pieces), dtype=np.int64)

        def moves(part: ConvexPart) -> Motion:
            of_joint = frames[:, part.joint + 1]
            far = links.deviates(part)
            return Motion(robot, part, knots, of_joint, self.error, self.origin, far)

        whole = range(len(self.pieces))
        self.bodies = [
            Body((moves(p),), (whole,), everywhere, False) for p in robot.parts
        ]
        held = [(self._while_held(c), moves(p)) for c, p in loads]
        while held:  # loads that are never held at the same time share a body
            chosen, left = list[tuple[range, Motion]](), list[tuple[range, Motion]]()
            which = np.full(len(self.pieces), -1)
            for inside, motion in held:
                now = which[inside.start : inside.stop]
                free = bool(np.all(now < 0))
                if free:
                    now[:] = len(chosen)
                (chosen if free else left).append((inside, motion))
            spans, motions = zip(*chosen, strict=True)
            self.bodies.append(Body(motions, spans, which, True))
            held = left
        self._which = np.stack([body.which for body in self.bodies])

    @cached_property
    def sweeps(self) -> SweepBounds:
        """Swept volume of each body in each piece."""
        sweeps = SweepBounds.nothing(len(self.pieces), len(self.bodies))
        for x, body in enumerate(self.bodies):
            for motion, inside in zip(body.motions, body.spans, strict=True):
                low, high = motion.extents(np.array(inside, dtype=np.int64))
                sweeps.low[0][:, inside.start : inside.stop, x] = low
                sweeps.high[0][:, inside.start : inside.stop, x] = high
        return sweeps.with_coarser()

    def which(self, bodies: Indices, pieces: Indices) -> Indices:
        """Return the motion index of each body in a piece, shape (k,)."""
        return np.asarray(self._which[bodies, pieces])

    def moment(self, piece: int, body: str) -> Moment:
        """Return the description of a piece in a problem."""
        pieces = self.pieces
        node, task = int(pieces.node[piece]), int(pieces.tasks[piece, 1])
        return Moment(self.name, node, task, bool(pieces.standing[piece]), body)

    def touches_at_home(self, part: ConvexPart, rest: Motion) -> bool:
        """Tell whether a part may touch a fixture that the robot is mounted on: a neighbour, or it does at HOME."""
        gap = measure(part, self._at_home[part.joint + 1], rest.part, rest.frames[0])
        return part.joint <= 0 or gap <= 0.0

    def _while_held(self, c: Carried) -> range:
        """Return the pieces in which an object is held: both kinds of their moments are in order."""
        pieces = self.pieces
        low = int(np.searchsorted(pieces.since, pieces.moment(*c.start)))
        high = int(np.searchsorted(pieces.until, pieces.moment(*c.end), side="right"))
        if c.given and low < len(pieces):  # the stand before the first node
            low += int(pieces.standing[low])
        if c.fetched and high > 0:  # the stand at the end
            high -= int(pieces.standing[high - 1])
        return range(low, max(low, high))


class StillBodies:
    """All objects and fixtures at rest at any time.

    Args:
        resting: objects and fixtures at rest, with poses and intervals.
        robots: standing robots that may hold some of them.

    Attributes:
        resting: the same, one entry per convex part.
        motions: of each part, all without displacement.
    """

    def __init__(
        self, resting: list[Resting], robots: Iterable[VerifiedRobot] = ()
    ) -> None:
        parts = [
            (rest, part)
            for rest in resting
            for part in resting_parts(rest.object, rest.shape, rest.pose)
        ]
        self.resting = [rest for rest, _ in parts]
        hands = {robot.name: (robot.error, robot.origin) for robot in robots}
        lies = NO_ERROR, np.zeros(3)
        knots, frames = np.zeros((2, 0)), np.tile(np.eye(4), (2, 1, 1))
        self.motions = [
            Motion(None, part, knots, frames, *hands.get(rest.hand or "", lies))
            for rest, part in parts
        ]

    @cached_property
    def sweeps(self) -> SweepBounds:
        """Volume of each convex part at rest."""
        sweeps = SweepBounds.nothing(len(self.resting), 1)
        piece = np.zeros(1, dtype=np.int64)
        for k, motion in enumerate(self.motions):
            low, high = motion.extents(piece)
            sweeps.low[0][:, k, 0], sweeps.high[0][:, k, 0] = low[:, 0], high[:, 0]
        return sweeps


def _nodes_complete_before(
    chain: int | None, robot: VerifiedRobot, precedence: Precedence
) -> Indices:
    """Return, per piece of a robot, how many nodes of a chain are complete before it."""
    begin = robot.pieces.begin
    if chain is None or robot.chain is None:
        return np.zeros(len(begin), dtype=np.int64)
    known = precedence.complete[chain][robot.chain]
    return np.where(begin >= 0, known[np.maximum(begin, 0)], 0)


def simultaneous_pieces(
    a: VerifiedRobot, b: VerifiedRobot, precedence: Precedence
) -> tuple[Indices, Indices]:
    """Return, per piece of a robot, the pieces of another that may be simultaneous.

    Returns the ranges ``range(low, high)`` of their numbers.
    """
    low = np.searchsorted(b.pieces.node, _nodes_complete_before(b.chain, a, precedence))
    past = _nodes_complete_before(a.chain, b, precedence)
    high = np.searchsorted(past, a.pieces.node, side="right")
    return low, np.maximum(low, high)


def pieces_during(
    robot: VerifiedRobot, resting: list[Resting], precedence: Precedence
) -> tuple[Indices, Indices]:
    """Return, per part at rest, the range of pieces of a robot that may be simultaneous with its rest."""
    pieces, chain = robot.pieces, robot.chain
    low = np.zeros(len(resting), dtype=np.int64)
    high = np.full(len(resting), len(pieces))
    if chain is None:
        return low, high
    past = {
        c: _nodes_complete_before(c, robot, precedence)
        for c in range(len(precedence.complete))
    }
    for k, rest in enumerate(resting):
        if rest.put is not None:
            c, node, waypoint = rest.put
            if c == chain:
                moment = pieces.moment(node, waypoint)
                low[k] = np.searchsorted(pieces.until, moment, side="right")
            else:
                over = precedence.complete[chain][c][node]
                low[k] = np.searchsorted(pieces.node, over)
        if rest.taken is not None:
            c, node, waypoint = rest.taken
            if c == chain:
                high[k] = np.searchsorted(pieces.since, pieces.moment(node, waypoint))
            else:
                high[k] = np.searchsorted(past[c], node, side="right")
    return low, np.maximum(low, high)


def _standing_pieces(home: Array) -> Pieces:
    one = np.zeros(1, dtype=np.int64)
    stands, tasks = np.ones(1, dtype=np.bool_), np.full((1, 2), -1)
    return Pieces(np.stack([home] * 2), one, stands, one, 1, tasks)


def _cut(chain: NodeChain, weights: Array) -> Pieces:
    """Return the pieces of a chain: each hold, then the motions of the node after it."""
    count, first = len(chain), chain.first
    room = int(np.max(np.diff(first))) + 1
    before = np.vstack([chain.start[None], chain.waypoints[:-1]])
    displacement = chain.waypoints - before
    reach = (np.abs(displacement) @ weights.T).max(axis=1)
    parts = np.maximum(1, np.ceil(0.5 * reach / PIECE).astype(np.int64))
    # Motions, each cut into its parts; then a hold before the first of each node.
    motion = np.repeat(np.arange(len(displacement)), parts)
    start = np.cumsum(parts) - parts
    part = np.arange(len(motion)) - start[motion] + 1
    ends = before[motion] + (part / parts[motion])[:, None] * displacement[motion]
    last = part == parts[motion]
    ends[last] = chain.waypoints
    node = np.repeat(np.arange(count), np.diff(first))[motion]
    moment = node * room + motion - first[node]
    holds = np.arange(count + 1)
    where = np.append(start, len(motion))[first]
    stands = np.vstack([before, chain.waypoints[-1:]])[first]
    near = np.stack([np.maximum(holds - 1, 0), np.minimum(holds, count - 1)], axis=1)

    def interleaved(moving: Indices, still: Indices) -> Indices:
        return np.insert(moving, where, still, axis=0)

    return Pieces(
        np.vstack([chain.start[None], np.insert(ends, where, stands, axis=0)]),
        interleaved(node, holds),
        np.insert(np.zeros(len(motion), dtype=np.bool_), where, True),
        interleaved(moment, holds * room),
        room,
        interleaved(np.repeat(chain.task[node][:, None], 2, axis=1), chain.task[near]),
    )

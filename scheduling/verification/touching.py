"""What may touch, and how deep: contacts that a plan allows, and what is in a hand.

Robots that touch themselves, or touch with an arm what they carry.

Encounters of a plan: parts of two robots, or of a robot and what rests, near and at once. Whoever proves something of
all that may happen at once asks for them here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import numpy.typing as npt

from planning.cell.workcell import CONTACT_DEPTH, Workcell
from planning.transforms import Array, Indices
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.verification.bodies import (
    StillBodies,
    VerifiedRobot,
    at_once,
    while_there,
)
from scheduling.verification.graph_structure import Precedence
from scheduling.verification.object_places import Carried
from scheduling.verification.problems import Moment, Problem, node_problem
from scheduling.witness.measuring import Measuring
from scheduling.witness.motion import Motion
from scheduling.witness.own_motions import OwnMotions
from scheduling.witness.parts import TOLERANCE, ConvexPart, measure
from scheduling.witness.robot import WitnessRobot
from scheduling.witness.sweeps import Close, close_pairs

SLACK = 1e-4
"""Overlaps up to this are none, where nothing says more: hulls are larger than what they contain [m]."""

Depths = Mapping[frozenset[str], list[tuple[frozenset[int], float]]]
"""By pair of names: in which tasks these may touch, and how deep they may then be in each other [m]."""


def allowed_depths(tpg: TemporalPlanGraph) -> Depths:
    """Return how deep things may be in each other where a plan lets them touch.

    A contact counts only if handling needs it: of a tool and an object, of two objects, or of an
    object and a fixture. Robots never touch each other, and an arm never touches anything.
    """
    cell = tpg.cell
    objects = {item.name for item in cell.objects}
    fixtures = {item.name for item in cell.fixtures}
    tools = {f"{robot.name}/tool" for robot in cell.robots}
    out: dict[frozenset[str], list[tuple[frozenset[int], float]]] = {}
    for contact in tpg.allowed:
        pair = frozenset((contact.first, contact.second))
        others = pair - objects
        if len(pair) < 2 or len(others) > 1 or not others <= tools | fixtures:
            continue
        depth = cell.clearances.contact_depth
        if contact.grazing:
            depth = cell.clearances.contact_tolerance
        elif not others.isdisjoint(tools):
            depth = CONTACT_DEPTH
        elif contact.depth is not None:
            depth = min(depth, contact.depth)
        out.setdefault(pair, []).append((contact.tasks, depth))
    return out


def too_deep_in_hand(
    tpg: TemporalPlanGraph,
    geometry: Mapping[str, WitnessRobot],
    carried: list[Carried],
    allowed: Depths,
) -> Iterator[Problem]:
    """Yield what is too deep in the hand that holds it, or in something else in the same hand.

    From then on until it is let go of they move as one, so that one look at each hold is enough.

    Args:
        tpg: the plan.
        geometry: of all robots.
        carried: who carries what when.
        allowed: who may touch whom.
    """
    for k, held in enumerate(carried):
        chain = tpg.chains[held.chain]
        robot = geometry[chain.robot]
        load = _load(tpg, robot, held)
        beside = [part for part in robot.parts if part.joint == robot.dof - 1]
        for other in carried[:k]:
            if other.chain == held.chain and _meet(other, held):
                beside += _load(tpg, robot, other)
        frames = robot.joint_frames_along(chain.start[None])[0]
        tasks = set(chain.task[held.start[0] : held.end[0] + 1].tolist())
        deepest: dict[str, float] = {}
        for part in load:
            for other_part in beside:
                at = frames[part.joint + 1], frames[other_part.joint + 1]
                depth = -measure(part, at[0], other_part, at[1])
                entity = other_part.entity
                deepest[entity] = max(deepest.get(entity, 0.0), depth)
        for entity, depth in deepest.items():
            pair = frozenset((held.object, entity))
            entries = allowed.get(pair, ())
            most = max((d for now, d in entries if tasks & now), default=0.0)
            if depth > max(most + TOLERANCE, SLACK):
                where = held.chain, min(held.start[0], len(chain) - 1)
                text = (
                    f"{held.object!r} is {depth * 1e3:.2f} mm deep in {entity} while"
                    f" {chain.robot!r} holds it, and may be {most * 1e3:g} mm"
                )
                yield node_problem(tpg, "grip", where, text)


def _load(
    tpg: TemporalPlanGraph, robot: WitnessRobot, held: Carried
) -> list[ConvexPart]:
    return robot.loads(held.object, tpg.cell.object(held.object).shape, held.pose)


def _meet(one: Carried, other: Carried) -> bool:
    """Tell whether two holds last at the same time."""
    return one.start < other.end and other.start < one.end


def touching_itself(robot: VerifiedRobot, reference: WitnessRobot) -> Iterator[Problem]:
    """Yield nodes in which parts of a robot touch each other, or what it carries.

    Parts of neighbouring joints touch by design, and those that overlap at HOME only do so because
    hulls are larger than what they contain. What is on the last joint moves with the load.

    Args:
        robot: its pieces, parts and loads.
        reference: its geometry.
    """
    own = OwnMotions(reference, robot.pieces.knots)
    parts = [body for body in robot.bodies if not body.load]
    loads = [body for body in robot.bodies if body.load]
    home = reference.joint_frames_along(robot.home[None])[0]
    everything = np.arange(len(robot.pieces))
    for first, second in combinations([body.motions[0].part for body in parts], 2):
        x, y = sorted((first, second), key=lambda part: part.joint)
        if y.joint - x.joint <= 1:
            continue
        if measure(x, home[x.joint + 1], y, home[y.joint + 1]) <= 0.0:
            continue
        yield from _in_pieces(robot, own, (x, y), everything)
    for body in loads:
        for k, motion in enumerate(body.motions):
            held = np.flatnonzero(body.which == k)
            for arm in parts:
                x = arm.motions[0].part
                if x.joint < motion.part.joint:
                    yield from _in_pieces(robot, own, (x, motion.part), held)


def _in_pieces(
    robot: VerifiedRobot,
    own: OwnMotions,
    parts: tuple[ConvexPart, ConvexPart],
    pieces: Indices,
) -> Iterator[Problem]:
    """Yield the nodes among some pieces in which two parts touch, the inner one given first."""
    found = own.too_close(Measuring(), parts, pieces, -SLACK, robot.pieces.keys)
    for piece, distance in found:
        first, second = (robot.moment(piece, part.entity) for part in parts)
        text = f"{first} overlaps {second.body} by {-distance * 1e3:.2f} mm"
        yield Problem("itself", text, first, second, distance)


@dataclass(frozen=True)
class Side:
    """A part of a robot or what it carries; or what lies in the world, or in a hand that stands.

    Attributes:
        motion: of the part.
        robot: whose; None for what lies.
        tasks: in which it lies there, None for all.
    """

    motion: Motion
    robot: VerifiedRobot | None
    tasks: tuple[int, ...] | None = None

    @property
    def entity(self) -> str:
        """What allowed contacts call it."""
        return self.motion.part.entity

    def in_tasks(self, pieces: Indices, tasks: frozenset[int]) -> npt.NDArray[np.bool_]:
        """Tell in which pieces one of some tasks is done.

        Of what lies in the world it is for the other side to say.
        """
        if self.robot is not None:
            found = np.isin(self.robot.pieces.tasks[pieces], list(tasks))
            return np.asarray(found.any(axis=1))
        there = self.tasks is None or not tasks.isdisjoint(self.tasks)
        return np.full(len(pieces), there)

    def keys(self, pieces: Indices) -> Indices:
        """Return one number for a node, and one for the stand before it; 0 for what lies."""
        if self.robot is None:
            return np.zeros_like(pieces)
        return self.robot.pieces.keys[pieces]

    def moment(self, piece: int) -> Moment:
        """Return a piece as it is named in a problem."""
        if self.robot is None:
            return Moment(None, -1, -1, True, self.entity)
        return self.robot.moment(piece, self.entity)

    def off_by(self, share: float) -> Side:
        """Return it with a share of the errors that its motion has."""
        return replace(self, motion=self.motion.off_by(share))


@dataclass(frozen=True)
class Encounter:
    """Two parts, and the pieces in which they may come near each other at once.

    Attributes:
        first, second: the parts.
        rows, columns: pieces of either, each of shape (k,).
        loaded: whether either is carried and no part of a robot.
        lies: number of what rests, None between two robots.
    """

    first: Side
    second: Side
    rows: Indices
    columns: Indices
    loaded: bool
    lies: int | None = None

    def allowed_by(
        self, depths: Depths
    ) -> Iterator[tuple[npt.NDArray[np.bool_], float]]:
        """Yield in which pairs of pieces the two may touch, shape (k,), and how deep [m]."""
        pair = frozenset((self.first.entity, self.second.entity))
        for tasks, depth in depths.get(pair, ()):
            first = self.first.in_tasks(self.rows, tasks)
            yield first & self.second.in_tasks(self.columns, tasks), depth


class Encounters:
    """All encounters of the robots of a plan, with each other and with what rests.

    Args:
        cell: its cell.
        robots: of the plan.
        still: what rests.
        precedence: what precedes what.

    Attributes:
        pairs: pairs of pieces that may happen at once, as far as they were looked at.
    """

    def __init__(
        self,
        cell: Workcell,
        robots: list[VerifiedRobot],
        still: StillBodies,
        precedence: Precedence,
    ) -> None:
        self._fixtures = {fixture.name for fixture in cell.fixtures}
        self.robots, self._still, self._precedence = robots, still, precedence
        self.pairs = 0

    def all_within(
        self, between: float, from_rest: float
    ) -> Iterator[Iterator[Encounter]]:
        """Yield the encounters of every two robots, then of every robot and what rests.

        Args:
            between: distance up to which two robots are near each other [m].
            from_rest: likewise a robot and what rests [m].
        """
        for a, b in combinations(self.robots, 2):
            yield self._of_robots(a, b, between)
        for robot in self.robots:
            yield self._at_rest(robot, from_rest)

    @property
    def count(self) -> int:
        """How often ``all_within`` yields."""
        robots = len(self.robots)
        return robots * (robots - 1) // 2 + robots

    def _of_robots(
        self, a: VerifiedRobot, b: VerifiedRobot, limit: float
    ) -> Iterator[Encounter]:
        windows = at_once(a, b, self._precedence)
        self.pairs += int((windows[1] - windows[0]).sum())
        limits = np.full((len(a.bodies), len(b.bodies)), limit)
        for close in close_pairs(a.sweeps, b.sweeps, windows, limits):
            which = a.which(close.x, close.i), b.which(close.y, close.j)
            for (x, k, y, m), rows, columns in _groups(close, *which):
                first, second = a.bodies[x], b.bodies[y]
                yield Encounter(
                    Side(first.motions[k], a),
                    Side(second.motions[m], b),
                    rows,
                    columns,
                    first.load or second.load,
                )

    def _at_rest(self, robot: VerifiedRobot, limit: float) -> Iterator[Encounter]:
        still = self._still
        windows = while_there(robot, still.resting, self._precedence)
        self.pairs += int((windows[1] - windows[0]).sum())
        limits: Array = np.full((1, len(robot.bodies)), limit)
        for close in close_pairs(still.sweeps, robot.sweeps, windows, limits):
            groups = _groups(close, close.i, robot.which(close.y, close.j))
            for (_, lies, y, m), _, pieces in groups:
                rest, motion = still.resting[lies], robot.bodies[y].motions[m]
                if motion.part.joint < 0 and rest.object in self._fixtures:
                    continue
                first = Side(motion, robot)
                second = Side(still.motions[lies], None, rest.tasks)
                if rest.hand == robot.name:  # its own: it errs as the robot does
                    first, second = first.off_by(0.0), second.off_by(0.0)
                yield Encounter(
                    first,
                    second,
                    pieces,
                    np.zeros_like(pieces),
                    True,
                    lies,
                )


def _groups(
    close: Close, which_x: Indices, which_y: Indices
) -> Iterator[tuple[tuple[int, int, int, int], Indices, Indices]]:
    """Yield body and motion of both sides, and the pieces in which these two come close."""
    kinds = np.stack([close.x, which_x, close.y, which_y])
    order = np.lexsort(kinds)
    changes = np.any(np.diff(kinds[:, order], axis=1) != 0, axis=0)
    for chosen in np.split(order, np.flatnonzero(changes) + 1):
        x, k, y, m = kinds[:, chosen[0]].tolist()
        yield (x, k, y, m), close.i[chosen], close.j[chosen]

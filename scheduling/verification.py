"""A second, slow proof that a saved plan keeps its guarantee (``twin verify``).

Nothing here is shared with the code that builds the graph: order comes from sets of ancestors,
geometry from pinocchio's own reading of the URDF files and coal's exact shapes, occupancy from
dense samples grown by the motion between them; no capsules, no clocks, no conflict search.
Checked are the structure, and the invariant: (a) nodes of two robots that come too close are
ordered, (b) so are a node and a robot that stands, (c) and a node and an object at rest.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np

from planning.transforms import Array, Transform
from scheduling.temporal_plan_graph import Indices, NodeHandling, TemporalPlanGraph
from scheduling.verification_bodies import Body, Pieces, RobotBodies
from scheduling.verification_geometry import (
    TOLERANCE,
    Part,
    ReferenceRobot,
    measure,
    resting_part,
)
from scheduling.verification_objects import (
    Resting,
    handled_objects,
    object_histories,
    planned_key,
    stand_during,
)
from scheduling.verification_order import Precedence, find_precedence

_Key = tuple[int, int, bool, bool]
"""Nodes of both sides, and whether each robot stands before its node."""

_BLOCK = 48
_FINEST = 1e-5

Progress = Callable[[int, int], None]
"""Called with the pairs of robots (or robots and resting things) done so far, and their number."""


@dataclass(frozen=True)
class Moment:
    """One side of a problem.

    Attributes:
        robot: name of the robot, None for what rests in the world.
        node: the node, or the node before which the robot stands, -1 where there is none.
        task: its task, -1 where there is none.
        standing: True when the robot stands before the node.
        body: what comes close: ``"<robot>/arm"``, ``"<robot>/tool"``, object or fixture.
    """

    robot: str | None
    node: int
    task: int
    standing: bool
    body: str

    def __str__(self) -> str:
        """Describe it in one phrase."""
        if self.robot is None:
            return f"{self.body} at rest"
        if self.standing:
            return f"{self.body} of {self.robot!r} standing before node {self.node}"
        return f"{self.body} of {self.robot!r} in node {self.node} (task {self.task})"


@dataclass(frozen=True)
class Problem:
    """Something that breaks the guarantee.

    Attributes:
        kind: ``"cycle"``, ``"order"`` (an edge or a chain against the planned order),
            ``"dependency"``, ``"handling"``, ``"nodes"``, ``"hold"`` or ``"rest"``.
        message: one sentence.
        first, second: the two sides, None for a cycle.
        distance_m: distance measured where it was first seen, NaN where none was [m].
    """

    kind: str
    message: str
    first: Moment | None = None
    second: Moment | None = None
    distance_m: float = math.nan


@dataclass(frozen=True)
class VerificationReport:
    """The outcome.

    Attributes:
        pairs_checked: pairs of pieces that may happen at once (motions, stands, rests).
        min_distance_robots_m: least distance measured between two robots in such pairs;
            infinite if none came near enough to be measured [m].
        min_distance_objects_m: likewise between a robot or its load and anything else, where
            no contact is allowed [m].
        problems: empty for a plan that keeps its guarantee; cut off at ``limit``.
    """

    pairs_checked: int
    min_distance_robots_m: float
    min_distance_objects_m: float
    problems: tuple[Problem, ...]

    @property
    def ok(self) -> bool:
        """True when nothing is wrong."""
        return not self.problems


def verify_plan(
    tpg: TemporalPlanGraph,
    *,
    dependencies: Indices | None = None,
    limit: int = 100,
    progress: Progress | None = None,
) -> VerificationReport:
    """Check a plan from scratch.

    Args:
        tpg: the plan.
        dependencies: pairs (a, b) of tasks, shape (e, 2), where known: a before b.
        limit: stop after so many problems.
        progress: told how far it has come.
    """
    check = _Verification(tpg, limit, progress)
    precedence = check.structure(dependencies)
    if precedence is not None:
        check.geometry(precedence)
    return VerificationReport(
        check.pairs,
        check.least[True],
        check.least[False],
        tuple(check.problems[:limit]),
    )


class _Verification:
    def __init__(
        self, tpg: TemporalPlanGraph, limit: int, progress: Progress | None
    ) -> None:
        self.tpg, self.limit, self.progress = tpg, limit, progress
        self.problems: list[Problem] = []
        self.pairs = 0
        self.least = {True: math.inf, False: math.inf}
        self.allowed: dict[frozenset[str], list[frozenset[int]]] = {}
        for contact in tpg.allowed:
            pair = frozenset((contact.first, contact.second))
            self.allowed.setdefault(pair, []).append(contact.tasks)

    # structure -------------------------------------------------------------------------

    def structure(self, dependencies: Indices | None) -> Precedence | None:
        """Check order and dependencies; return what precedes what."""
        tpg = self.tpg
        precedence = find_precedence(tpg)
        if precedence is None:
            self.problems.append(Problem("cycle", "the edges form a cycle"))
            return None
        for a, chain in enumerate(tpg.chains):
            keys = [planned_key(tpg, a, v) for v in range(len(chain))]
            for v in range(1, len(keys)):
                if keys[v] < keys[v - 1]:
                    self._ordered(
                        "order", (a, v - 1), (a, v), "against the planned order"
                    )
        for a, u, b, v in tpg.edges.tolist():
            if planned_key(tpg, a, u) >= planned_key(tpg, b, v):
                self._ordered(
                    "order", (a, u), (b, v), "an edge against the planned order"
                )
        for name, events in handled_objects(tpg).items():
            for before, after in pairwise(events):
                a, u, b, v = before.robot, before.node, after.robot, after.node
                if a != b and not precedence.precedes(a, u, b, v):
                    text = f"both handle {name!r} and are not ordered"
                    self._ordered("handling", (a, u), (b, v), text)
            self._passing(name, events, precedence)
        if dependencies is not None:
            self._dependencies(precedence, dependencies)
        return precedence

    def _passing(
        self, name: str, events: list[NodeHandling], precedence: Precedence
    ) -> None:
        """Check that a robot stands still while another one gives it something or takes it."""
        index = {chain.robot: i for i, chain in enumerate(self.tpg.chains)}
        holder: str | None = None
        for event in events:
            a, u = event.robot, event.node
            for robot in {holder, event.holder} - {None, self.tpg.chains[a].robot}:
                b = index[str(robot)]
                v = stand_during(self.tpg, b, (a, u, event.waypoint))[1]
                text = f"{name!r} is passed on and {robot!r} need not stand then"
                if v > 0 and not precedence.precedes(b, v - 1, a, u):
                    self._ordered("handling", (b, v - 1), (a, u), text)
                if v < len(self.tpg.chains[b]) and not precedence.precedes(a, u, b, v):
                    self._ordered("handling", (a, u), (b, v), text)
            holder = event.holder

    def _dependencies(self, precedence: Precedence, dependencies: Indices) -> None:
        nodes: dict[int, tuple[int, int, int]] = {}
        for a, chain in enumerate(self.tpg.chains):
            for task in np.unique(chain.task).tolist():
                own = np.flatnonzero(chain.task == task)
                nodes[task] = (a, int(own[0]), int(own[-1]))
        for first, second in np.asarray(dependencies).reshape(-1, 2).tolist():
            if first in nodes and second in nodes:
                a, _, u = nodes[first]
                b, v, _ = nodes[second]
                if not precedence.precedes(a, u, b, v):
                    text = f"task {second} must wait for task {first}, and does not"
                    self._ordered("dependency", (a, u), (b, v), text)

    def _ordered(
        self, kind: str, u: tuple[int, int], v: tuple[int, int], text: str
    ) -> None:
        first, second = (
            Moment(chain.robot, node, int(chain.task[node]), False, chain.robot)
            for chain, node in ((self.tpg.chains[a], n) for a, n in (u, v))
        )
        names = [
            f"node {m.node} of {m.robot!r} (task {m.task})" for m in (first, second)
        ]
        message = f"{names[0]} and {names[1]}: {text}"
        self.problems.append(Problem(kind, message, first, second))

    # geometry --------------------------------------------------------------------------

    def geometry(self, precedence: Precedence) -> None:
        """Check that whatever may happen at once keeps apart."""
        tpg, cell = self.tpg, self.tpg.cell
        index = {chain.robot: i for i, chain in enumerate(tpg.chains)}
        geometry = {placed.name: ReferenceRobot(placed) for placed in cell.robots}

        def flange(chain: int, node: int) -> Transform:
            c = tpg.chains[chain]
            q = c.start if node == 0 else c.waypoints[c.first[node] - 1]
            return geometry[c.robot].flange_pose(q)

        carried, resting = object_histories(tpg, flange)
        robots = [
            RobotBodies(
                cell,
                geometry[placed.name],
                placed,
                tpg.chains[index[placed.name]] if placed.name in index else None,
                index.get(placed.name),
                carried,
            )
            for placed in cell.robots
        ]
        pairs = list(combinations(robots, 2))
        for done, (a, b) in enumerate(pairs):
            self._robots(a, b, precedence)
            self._tell(done + 1, len(pairs) + len(robots))
        for done, robot in enumerate(robots):
            for rest in resting:
                self._rest(robot, rest, precedence)
            self._tell(len(pairs) + done + 1, len(pairs) + len(robots))

    def _tell(self, done: int, total: int) -> None:
        if self.progress is not None:
            self.progress(done, total)

    def _robots(self, a: RobotBodies, b: RobotBodies, precedence: Precedence) -> None:
        past_a = _over_before(
            a, b, precedence
        )  # per piece of b: ends of a that are over
        past_b = _over_before(b, a, precedence)
        low = np.searchsorted(b.pieces.end, past_b)
        high = np.searchsorted(past_a, a.pieces.end, side="right")
        self.pairs += int(np.maximum(high - low, 0).sum())
        seen: dict[_Key, Problem] = {}
        clearances = self.tpg.cell.clearances
        for x in a.bodies:
            for y in b.bodies:
                if len(self.problems) + len(seen) >= self.limit:
                    break
                both = x.robot and y.robot
                limit = clearances.robot_robot if both else clearances.robot_object
                for close in _close_pairs(
                    a.pieces, x, b.pieces, y, past_a, past_b, limit
                ):
                    if len(self.problems) + len(seen) >= self.limit:
                        break
                    for i, j in _unsettled(a, x, b, y, close, limit):
                        key = _key(a.pieces, i, b.pieces, j)
                        if key in seen or self._may_touch(
                            x.part.entity,
                            y.part.entity,
                            a.pieces.tasks[i].tolist(),
                            b.pieces.tasks[j].tolist(),
                        ):
                            continue
                        found = self._closer(
                            (a, x.part, i), (b, y.part, j), limit, between_robots=both
                        )
                        if found is not None:
                            first = _moment(a, x.part, i)
                            second = _moment(b, y.part, j)
                            seen[key] = _conflict(first, second, found)
        self.problems += _without_repeats(seen)

    def _rest(self, robot: RobotBodies, rest: Resting, precedence: Precedence) -> None:
        part = resting_part(rest.object, rest.size, rest.pose)
        fixture = any(f.name == rest.object for f in self.tpg.cell.fixtures)
        there = _while_there(robot, rest, precedence)
        self.pairs += int(there.sum())
        limit = self.tpg.cell.clearances.robot_object
        world = np.eye(4)
        inverse = rest.pose[:3, :3]
        seen: dict[_Key, Problem] = {}
        for x in robot.bodies:
            if x.part.entity == rest.object or (fixture and x.part.joint < 0):
                continue
            local = (x.centre - rest.pose[:3, 3]) @ inverse
            out = np.linalg.norm(
                np.maximum(np.abs(local) - 0.5 * rest.size, 0.0), axis=1
            )
            close = (out < x.radius + limit) & there[x.pieces]
            for i in x.pieces[close].tolist():
                tasks = robot.pieces.tasks[i].tolist()
                key = (
                    int(robot.pieces.node[i]),
                    -1,
                    bool(robot.pieces.standing[i]),
                    True,
                )
                if key in seen or self._may_touch(
                    x.part.entity, rest.object, tasks, rest.tasks
                ):
                    continue
                found = self._closer((robot, x.part, i), (None, part, world), limit)
                if found is not None:
                    first = _moment(robot, x.part, i)
                    second = Moment(None, -1, -1, True, rest.object)
                    seen[key] = _conflict(first, second, found, kind="rest")
        self.problems += _without_repeats(seen)

    def _may_touch(
        self, x: str, y: str, x_tasks: Iterable[int], y_tasks: Iterable[int] | None
    ) -> bool:
        if x == y:
            return True
        for tasks in self.allowed.get(frozenset((x, y)), ()):
            if tasks.isdisjoint(x_tasks):
                continue
            if y_tasks is None or not tasks.isdisjoint(y_tasks):
                return True
        return False

    def _closer(
        self,
        first: tuple[RobotBodies, Part, int],
        second: tuple[RobotBodies, Part, int] | tuple[None, Part, Array],
        limit: float,
        *,
        between_robots: bool = False,
    ) -> float | None:
        """Return a distance below the limit, None if there is none.

        Both motions are halved until the sample in the middle decides: either it is too close,
        or it is further away than both can move from there.
        """
        a, part_a, i = first
        spans = [(a.pieces.q_a[i], a.pieces.q_b[i])]
        if second[0] is not None:
            b, part_b, j = second
            spans.append((b.pieces.q_a[j], b.pieces.q_b[j]))
            frame_b = b.frames[j, part_b.joint + 1]
        else:
            _, part_b, frame_b = second
        count = 0
        todo = [(0.0, count, spans, a.frames[i, part_a.joint + 1], frame_b)]
        while todo:  # what may be closest first
            _, _, spans, frame_a, frame_b = heapq.heappop(todo)
            gap = measure(part_a, frame_a, part_b, frame_b)
            self.least[between_robots] = min(self.least[between_robots], gap)
            if gap < limit - TOLERANCE:
                return gap
            moved = [
                0.5 * float(np.abs(end - start) @ part.weight)
                for (start, end), part in zip(spans, (part_a, part_b), strict=False)
            ]
            if gap - sum(moved) >= limit - TOLERANCE or max(moved) < _FINEST:
                continue
            cut = int(np.argmax(moved))
            start, end = spans[cut]
            middle = 0.5 * (start + end)
            for half in ((start, middle), (middle, end)):
                q = 0.5 * (half[0] + half[1])
                count += 1
                if cut == 0:
                    frame = a.robot.joint_frames(q)[part_a.joint + 1]
                    entry = ([half, *spans[1:]], frame, frame_b)
                else:
                    assert second[0] is not None
                    frame = second[0].robot.joint_frames(q)[part_b.joint + 1]
                    entry = ([spans[0], half], frame_a, frame)
                heapq.heappush(todo, (gap - sum(moved), count, *entry))
        return None


def _over_before(a: RobotBodies, b: RobotBodies, precedence: Precedence) -> Indices:
    """Return, per piece of b, how many first nodes of a are complete before it may begin."""
    begin = b.pieces.begin
    if a.chain is None or b.chain is None:
        return np.zeros(len(begin), dtype=np.int64)
    known = precedence.complete[a.chain][b.chain]
    return np.where(begin >= 0, known[np.maximum(begin, 0)], 0)


def _close_pairs(
    pieces_a: Pieces,
    x: Body,
    pieces_b: Pieces,
    y: Body,
    past_a: Indices,
    past_b: Indices,
    limit: float,
) -> Iterator[tuple[Indices, Indices]]:
    """Yield pairs of pieces that may happen at once and in which two spheres come close.

    They come in groups, as positions in ``x.pieces`` and in ``y.pieces``.
    """
    end_a, end_b = pieces_a.end[x.pieces], pieces_b.end[y.pieces]
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


def _unsettled(
    a: RobotBodies,
    x: Body,
    b: RobotBodies,
    y: Body,
    close: tuple[Indices, Indices],
    limit: float,
) -> Iterator[tuple[int, int]]:
    """Yield the pairs of pieces that one measurement for many of them does not settle.

    What is measured in the middle of two pieces holds for others as well, less what both parts
    are displaced from there to the middle of the others, and move within them.
    """
    rows, columns = close
    while len(rows):
        k = len(rows) // 2
        row, column = rows[k], columns[k]
        i, j = int(x.pieces[row]), int(y.pieces[column])
        gap = measure(
            x.part,
            a.frames[i, x.part.joint + 1],
            y.part,
            b.frames[j, y.part.joint + 1],
        )
        left = gap - _displaced(a, x, row, rows) - _displaced(b, y, column, columns)
        unsettled = left < limit - TOLERANCE
        if unsettled[k]:
            unsettled[k] = False
            yield i, j
        rows, columns = rows[unsettled], columns[unsettled]


def _displaced(robot: RobotBodies, body: Body, start: int, others: Indices) -> Array:
    """Return how far any point of a body gets from one piece's middle in other pieces [m]."""
    low, high = int(others.min()), int(others.max()) + 1
    low, high = min(low, int(start)), max(high, int(start) + 1)
    frames = robot.frames[body.pieces[low:high], body.part.joint + 1, :3, :3]
    turned = (frames - frames[start - low]).reshape(-1, 9)
    angle = np.sqrt(np.einsum("ij,ij->i", turned, turned) / 2.0)
    moved = np.linalg.norm(body.centre[low:high] - body.centre[start], axis=1)
    within = body.radius[low:high] - body.part.radius
    return np.asarray((moved + body.part.radius * angle + within)[others - low])


def _while_there(
    robot: RobotBodies, rest: Resting, precedence: Precedence
) -> np.ndarray:
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
            known = precedence.complete[chain][robot.chain]
            done = np.where(pieces.begin >= 0, known[np.maximum(pieces.begin, 0)], 0)
            out &= done <= node
    return out


def _moment(robot: RobotBodies, part: Part, piece: int) -> Moment:
    pieces = robot.pieces
    standing = bool(pieces.standing[piece])
    return Moment(
        robot.name,
        int(pieces.node[piece]),
        int(pieces.tasks[piece, 1]),
        standing,
        part.entity,
    )


def _conflict(
    first: Moment, second: Moment, distance: float, kind: str = ""
) -> Problem:
    standing = first.standing or second.standing
    how = (
        f"overlap by {-distance * 1e3:.2f} mm"
        if distance < 0
        else f"come within {distance * 1e3:.2f} mm"
    )
    return Problem(
        kind or ("hold" if standing else "nodes"),
        f"{first} and {second} {how}, and nothing keeps them apart",
        first,
        second,
        distance,
    )


def _key(a: Pieces, i: int, b: Pieces, j: int) -> _Key:
    return int(a.node[i]), int(b.node[j]), bool(a.standing[i]), bool(b.standing[j])


def _without_repeats(seen: dict[_Key, Problem]) -> list[Problem]:
    """Leave out stands next to a motion that is named already: it starts or ends with them."""
    out = []
    for (u, v, u_stands, v_stands), problem in sorted(seen.items(), key=lambda p: p[0]):
        moving = [(n, v, False, v_stands) for n in (u - 1, u) if u_stands]
        moving += [(u, n, u_stands, False) for n in (v - 1, v) if v_stands]
        if not any(key in seen for key in moving):
            out.append(problem)
    return out

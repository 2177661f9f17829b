"""Extension of the committed nodes of a graph by newly planned motions.

The committed nodes are executed whatever the new plan is. They come before all new nodes in the total order, so
edges point from committed to new nodes and there is no cycle. Edges among committed nodes and among new nodes exist
already; only conflicts between the two sets are searched. The combined graph satisfies the same safety
invariant, and is checked like every other graph before execution.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from planning.cell.workcell import Workcell
from planning.tasks.task import AllowedContact, Handling, Task, TaskKind, TimeWindow
from planning.transforms import Indices, read_only_copy
from scheduling.build_tpg import connect_nodes
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.temporal_plan_graph import (
    NO_EDGES,
    Drive,
    NodeChain,
    NodeHandling,
    TemporalPlanGraph,
    join_chains,
    joined_corners,
    joined_drives,
    pose_nodes,
)


def committed_subgraph(
    tpg: TemporalPlanGraph, counts: Sequence[int]
) -> TemporalPlanGraph:
    """Return the committed nodes of a graph, with the edges among them.

    Tasks that have no node left are kept as left out, so that indices stay; those behind the last one
    that has are dropped. What may touch in such tasks may not in others, which get their indices later.
    A skill within which its robot stops for good is a failed attempt, with the part of its path that is left.
    """
    kept = [k for k, count in enumerate(counts) if count]
    chains = tuple(tpg.chains[k].cut(0, counts[k]) for k in kept)
    place = {k: n for n, k in enumerate(kept)}
    done = {int(task) for chain in chains for task in chain.task}
    cut = {
        int(chain.task[n - 1]): _waypoints_of_last_task(chain, n)
        for chain, n in zip(tpg.chains, counts, strict=True)
        if 0 < n < len(chain) and chain.task[n] == chain.task[n - 1]
    }
    tasks = tuple(
        (_interrupted(task, cut[task.index]) if task.index in cut else task)
        if task.index in done
        else _as_omitted_task(task)
        for task in tpg.tasks[: max(done, default=-1) + 1]
    )
    own = [
        (place[k], u, place[i], v)
        for k, u, i, v in tpg.edges.tolist()
        if v < counts[i] and k in place and i in place
    ]
    inside = np.array([v < counts[i] for _, _, i, v in tpg.edges.tolist()], dtype=bool)
    waits = [(a, b) for a, b in tpg.dependencies.tolist() if a in done and b in done]
    none = np.empty(0, dtype=np.int64)
    return replace(
        tpg,
        tasks=tasks,
        chains=chains,
        edges=np.array(own, dtype=np.int64).reshape(-1, 4),
        cause=tpg.cause[inside],
        handlings=tuple(
            replace(h, robot=place[h.robot])
            for h in tpg.handlings
            if h.node < counts[h.robot]
        ),
        allowed=contacts_allowed_during(tpg.allowed, done),
        dependencies=np.array(waits, dtype=np.int64).reshape(-1, 2),
        slots=none,
        products=none,
        windows=tuple(window for window in tpg.windows if window.own <= done),
    )


def contacts_allowed_during(
    allowed: Iterable[AllowedContact], tasks: Collection[int]
) -> tuple[AllowedContact, ...]:
    """Return the contacts allowed in some tasks, and in no others."""
    pairs = ((c, replace(c, tasks=c.tasks.intersection(tasks))) for c in allowed)
    return tuple(own for c, own in pairs if own.tasks or not c.tasks)


def _waypoints_of_last_task(chain: NodeChain, count: int) -> int:
    """Return the number of waypoints of the last task that are in the first nodes of a chain."""
    begin = int(np.argmax(chain.task == chain.task[count - 1]))
    return int(chain.first[count] - chain.first[begin])


def _interrupted(task: Task, waypoints: int) -> Task:
    """Return a task of which only the first waypoints are executed."""
    if task.kind == TaskKind.TRANSIT:
        return replace(task, goal=False)
    return replace(
        task,
        kind=TaskKind.FAILED,
        label=f"{task.label}: interrupted",
        path=task.path[:waypoints],
        handlings=tuple(h for h in task.handlings if h.waypoint <= waypoints),
        actuations=tuple(a for a in task.actuations if a.waypoint <= waypoints),
        goal=False,
    )


def _as_omitted_task(task: Task) -> Task:
    """Return a task marked as omitted."""
    return replace(
        task,
        kind=TaskKind.LEFT_OUT,
        handlings=(),
        actuations=(),
        object=None,
        goal=False,
    )


def extend_graph(
    committed: TemporalPlanGraph,
    new: TemporalPlanGraph,
    cell: Workcell,
    dependencies: Indices,
    windows: Iterable[TimeWindow] | None = None,
    *,
    order: Sequence[str] = (),
) -> TemporalPlanGraph:
    """Return the committed prefix with new nodes after it, reduced and checked.

    Args:
        committed: see ``committed_subgraph``.
        new: a graph that begins in the world at the cut: its tasks are those of the committed nodes and
            then its own, and its robots begin with what they hold in their hands.
        cell: with all objects, as it was at the very start.
        dependencies: between tasks of both, shape (e, 2).
        windows: of time between tasks of both, of which those of tasks that are not done are left out; by default
            those of the committed ones.
        order: robots whose chains come first, in this order, by default that of the committed ones; of one that
            has nothing to do any more, and did nothing, the chain is empty.

    Raises:
        PlanInvariantError: a robot or an object that stands is in the way of a new motion.
    """
    names = [r.name for r in (*cell.robots, *cell.machines)]
    old, more = committed.chain_index, new.chain_index
    # Chains keep their numbers, by which executors refer to them.
    every = dict.fromkeys(
        name for name in (*order, *old, *names) if name in old or name in more
    )
    place = {name: k for k, name in enumerate(every)}
    begins = max((float(c.planned_start[-1]) for c in committed.chains), default=-1.0)
    parts: list[list[NodeChain]] = [[] for _ in every]
    for chain in committed.chains:
        parts[place[chain.robot]].append(chain)
    count = [len(own[0]) if own else 0 for own in parts]
    for chain in new.chains:
        later = replace(chain, planned_start=chain.planned_start + begins + 1.0)
        parts[place[chain.robot]].append(later)
    chains = tuple(_join_chain_parts(own) for own in parts)
    handlings = [
        replace(h, robot=place[committed.chains[h.robot].robot])
        for h in committed.handlings
    ]
    # What a robot has had in its hand all along is not picked again.
    hands = {h.object: h.holder for h in committed.handlings}

    def in_hand(h: NodeHandling) -> bool:
        return new.holds_before(h) and hands.get(h.object) == h.holder

    handlings += [
        _moved(h, place[new.chains[h.robot].robot], count)
        for h in new.handlings
        if not in_hand(h)
    ]
    # A robot that received it from another continues once that has released it.
    given = {
        h.object: committed.task_of(h)
        for h in committed.handlings
        if h.holder not in (None, committed.chains[h.robot].robot)
    }
    passed = [
        (given[h.object].index, new.task_of(h).index)
        for h in new.handlings
        if in_hand(h) and h.object in given
    ]
    done = {int(task) for chain in chains for task in chain.task}
    timed = committed.windows if windows is None else windows
    union = TemporalPlanGraph(
        cell,
        (
            *committed.tasks,
            *(
                _without_repeated_pick(task, hands)
                for task in new.tasks[len(committed.tasks) :]
            ),
        ),
        chains,
        *NO_EDGES,
        tuple(handlings),
        _merge_contacts((*committed.allowed, *new.allowed)),
        _pairs((*committed.dependencies.tolist(), *dependencies.tolist(), *passed)),
        windows=tuple(window for window in timed if window.own <= done),
    )
    known = [
        (place[committed.chains[k].robot], u, place[committed.chains[i].robot], v)
        for k, u, i, v in committed.edges.tolist()
    ]
    for k, u, i, v in new.edges.tolist():
        a, b = (place[new.chains[c].robot] for c in (k, i))
        known.append((a, u + count[a], b, v + count[b]))
    edges = np.array(known, dtype=np.int64).reshape(-1, 4)
    causes = np.concatenate([committed.cause, new.cause])
    searched, failed = [0] * len(every), TaskKind.FAILED
    for chain in committed.chains:
        # Without failed attempts at the end, which have left objects elsewhere.
        kept = [committed.tasks[k].kind != failed for k in chain.task.tolist()]
        searched[place[chain.robot]] = len(kept) - [*kept[::-1], True].index(True)
    tpg = connect_nodes(DerivedTpg(union), (edges, causes), searched, count)
    return _with_idle(tpg, order)


def _with_idle(tpg: TemporalPlanGraph, order: Sequence[str]) -> TemporalPlanGraph:
    """Return a graph in which robots without nodes keep their places in the order of robots."""
    idle = [name for name in order if name not in tpg.chain_index]
    if not idle:
        return tpg
    own = {chain.robot: chain for chain in tpg.chains}
    names = list(dict.fromkeys((*order, *own)))
    new = np.array([names.index(chain.robot) for chain in tpg.chains], dtype=np.int64)
    edges = tpg.edges.copy()
    edges[:, [0, 2]] = new[edges[:, [0, 2]]]
    rows = np.lexsort(edges.T[::-1])
    return replace(
        tpg,
        chains=tuple(own.get(name) or _empty_chain(tpg.cell, name) for name in names),
        edges=edges[rows],
        cause=tpg.cause[rows],
        handlings=tuple(replace(h, robot=int(new[h.robot])) for h in tpg.handlings),
    )


def _empty_chain(cell: Workcell, name: str) -> NodeChain:
    home = cell.robot(name).home
    return pose_nodes(name, home, np.empty((0, len(home))), 0, 0.0)


def _join_chain_parts(parts: Sequence[NodeChain]) -> NodeChain:
    """Return concatenated chains, at rest in between."""
    if len(parts) == 1:
        return parts[0]
    joined = join_chains(parts)
    drives = [part.drive for part in parts if part.drive is not None]
    if len(drives) < len(parts):
        return joined
    first = np.cumsum([0, *(len(part) for part in parts)])
    corners = joined_corners(
        *((p.corners, int(n)) for p, n in zip(parts, first, strict=False))
    )
    return replace(joined, drive=joined_drives(drives), corners=corners)


def _moved(h: NodeHandling, chain: int, count: Sequence[int]) -> NodeHandling:
    return replace(h, robot=chain, node=h.node + count[chain])


def _without_repeated_pick(task: Task, hands: Mapping[str, str | None]) -> Task:
    """Return a task of a robot that already holds what the task would pick up first."""

    def taken(h: Handling) -> bool:
        return h.waypoint == 0 and h.holder == task.robot == hands.get(h.object)

    if not any(taken(h) for h in task.handlings):
        return task
    return replace(task, handlings=tuple(h for h in task.handlings if not taken(h)))


def _merge_contacts(allowed: Sequence[AllowedContact]) -> tuple[AllowedContact, ...]:
    """Return contacts merged by pair of things."""
    tasks: dict[tuple[str, str, bool, float | None], frozenset[int]] = {}
    for c in allowed:
        key = c.first, c.second, c.grazing, c.depth
        tasks[key] = tasks.get(key, frozenset()) | c.tasks
    return tuple(
        AllowedContact(a, b, own, grazing, depth)
        for (a, b, grazing, depth), own in tasks.items()
    )


def _pairs(pairs: Sequence[Sequence[int]]) -> Indices:
    return np.array(sorted({tuple(p) for p in pairs}), dtype=np.int64).reshape(-1, 2)


def with_attempt(
    committed: TemporalPlanGraph,
    tpg: TemporalPlanGraph,
    robot: str,
    node: int,
    changes: Sequence[Handling] = (),
    *,
    missing: bool = False,
) -> TemporalPlanGraph:
    """Return the committed prefix with one more node: a failed attempt at a skill without net motion.

    It has gone back along its own path, which is part of what the skill occupies: the node needs nobody else to
    wait, and what follows is planned from there.

    Args:
        committed: of a graph, up to the node; see ``committed_subgraph``.
        tpg: the graph.
        robot: the robot.
        node: the first node of the skill.
        changes: what has become of the object, at waypoint 1.
        missing: whether what it is about was not there, so that it waited for no machine to bring it.
    """
    whole = tpg.chains[tpg.chain_index[robot]]
    index = int(whole.task[node])
    q = read_only_copy(whole.stands_at(node).copy())
    times = float(whole.duration[node]), float(whole.planned_start[node])
    stood = pose_nodes(robot, q, q[None], index, *times, skill=True)
    if whole.drive is not None:
        stood = replace(stood, drive=_still())
    old = committed.chain_index
    if robot in old:
        at = old[robot]
        chains = list(committed.chains)
        chains[at] = _join_chain_parts([chains[at], stood])
    else:
        at, chains = len(committed.chains), [*committed.chains, stood]
    own = tpg.chain_index[robot]
    place = {chain.robot: k for k, chain in enumerate(chains)}
    brings = tpg.machine_chains() if missing else frozenset[int]()
    rows = [
        row
        for row, (k, _, i, v) in enumerate(tpg.edges.tolist())
        if (i, v) == (own, node) and k not in brings
    ]
    into = [
        (place[tpg.chains[k].robot], u, at, node)
        for k, u, _, _ in tpg.edges[rows].tolist()
    ]
    task = replace(
        tpg.tasks[index],
        kind=TaskKind.FAILED,
        label=f"{tpg.tasks[index].label}: failed",
        path=q[None],
        handlings=tuple(changes),
        actuations=(),
        goal=False,
    )
    tasks = [
        *committed.tasks,
        *map(_as_omitted_task, tpg.tasks[len(committed.tasks) : index + 1]),
    ]
    tasks[index] = task
    handled = [
        NodeHandling(h.object, at, node, h.waypoint, h.holder, h.pose) for h in changes
    ]
    return replace(
        committed,
        tasks=tuple(tasks),
        chains=tuple(chains),
        edges=np.concatenate(
            [committed.edges, np.array(into, dtype=np.int64).reshape(-1, 4)]
        ),
        cause=np.concatenate([committed.cause, tpg.cause[rows]]),
        handlings=(*committed.handlings, *handled),
        allowed=_merge_contacts(
            (*committed.allowed, *contacts_allowed_during(tpg.allowed, {index}))
        ),
    )


def _still() -> Drive:
    """Return the timing of a node without motion."""
    none, one = np.zeros(1), np.ones(1)
    rests, by = np.ones(1, dtype=np.bool_), np.zeros(1, dtype=np.int64)
    return Drive(none, none, none, rests, one, by, one)

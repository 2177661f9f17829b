"""Structure of a saved plan: acyclic, in planned order, with ordered handlings of objects.

Precedence of nodes comes from ancestor sets, stored as bits of integers. Also checked: the handlings of nodes
are those of their tasks, paths are continuous, and speeds are within the limits of the robots.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise, zip_longest

import numpy as np

from planning.tasks.task import Handling, Task, TaskKind
from planning.transforms import Array, Indices
from scheduling.graph.temporal_plan_graph import (
    NodeChain,
    NodeHandling,
    TemporalPlanGraph,
)
from scheduling.verification.object_places import (
    JUMP,
    ObjectLocation,
    distance_of,
    object_locations,
    planned_key,
    stand_during,
)
from scheduling.verification.problems import Problem, node_problem, pair_problem

_Node = tuple[int, int]

_BLOCK = 4096
"""Nodes whose ancestors are counted together: it bounds the memory."""

_SAME = 1e-6
"""Joint values that differ by less are the same [rad or m]."""
_FASTER = 1e-3
"""Share by which a joint may be faster than its limit: what is rounded is far below it."""

_HANDLED_IN = frozenset(
    {
        "pick",
        "place-down",
        "place-up",
        "handover",
        TaskKind.LEAVE_TOOL,
        TaskKind.TAKE_TOOL,
    }
)
"""Kinds of tasks in which the object that they name changes hands."""


def check_structure(tpg: TemporalPlanGraph) -> tuple[Precedence | None, list[Problem]]:
    """Check order, handlings and dependencies.

    Args:
        tpg: the plan.

    Returns:
        What precedes what, None if there is a cycle, and the problems.
    """
    precedence = find_precedence(tpg)
    if precedence is None:
        return None, [Problem("cycle", "the edges form a cycle")]
    problems = list(_order_problems(tpg))
    for name, places in object_locations(tpg).items():
        problems += _unordered_handlings(tpg, precedence, name, places)
    problems += _dependencies_not_kept(tpg, precedence)
    return precedence, problems


def _order_problems(tpg: TemporalPlanGraph) -> Iterator[Problem]:
    for a, chain in enumerate(tpg.chains):
        for v in range(1, len(chain)):
            if planned_key(tpg, a, v) < planned_key(tpg, a, v - 1):
                yield pair_problem(
                    tpg, "order", (a, v - 1), (a, v), "against the planned order"
                )
    for a, u, b, v in tpg.edges.tolist():
        if planned_key(tpg, a, u) >= planned_key(tpg, b, v):
            text = "an edge against the planned order"
            yield pair_problem(tpg, "order", (a, u), (b, v), text)


def _unordered_handlings(
    tpg: TemporalPlanGraph,
    precedence: Precedence,
    name: str,
    places: Sequence[ObjectLocation],
) -> Iterator[Problem]:
    """Yield unordered handlings of an object.

    A robot has to stand still, too, while another one gives it something or takes it.
    """
    for at in places:
        if at.put is not None and at.taken is not None:
            u, v = at.put[:2], at.taken[:2]
            if u[0] != v[0] and not precedence.precedes(*u, *v):
                text = f"both handle {name!r} and are not ordered"
                yield pair_problem(tpg, "handling", u, v, text)
    for before, after in pairwise(places):
        assert after.put is not None
        here, own = after.put[:2], tpg.chains[after.put[0]].robot
        for robot in {before.holder, after.holder} - {None, Handling.GONE, own}:
            b = tpg.chain_index[str(robot)]
            leaves = stand_during(tpg, b, after.put)[1]
            came, goes = (b, leaves - 1), (b, leaves)
            text = f"{name!r} is passed on and {robot!r} need not stand then"
            if leaves > 0 and not precedence.precedes(*came, *here):
                yield pair_problem(tpg, "handling", came, here, text)
            if leaves < len(tpg.chains[b]) and not precedence.precedes(*here, *goes):
                yield pair_problem(tpg, "handling", here, goes, text)


def _dependencies_not_kept(
    tpg: TemporalPlanGraph, precedence: Precedence
) -> Iterator[Problem]:
    starts: dict[int, _Node] = {}
    ends: dict[int, _Node] = {}
    for a, chain in enumerate(tpg.chains):
        for node, task in enumerate(chain.task.tolist()):
            starts.setdefault(task, (a, node))
            ends[task] = (a, node)
    for first, second in tpg.dependencies.tolist():
        if first in ends and second in starts:
            u, v = ends[first], starts[second]
            if not precedence.precedes(*u, *v):
                text = f"task {second} must wait for task {first}, and does not"
                yield pair_problem(tpg, "dependency", u, v, text)


@dataclass(frozen=True)
class Precedence:
    """Precedence between nodes.

    Attributes:
        complete: ``complete[a][b][v]`` is how many of the first nodes of chain ``a`` must be
            complete before node ``v`` of chain ``b`` may start.
    """

    complete: tuple[tuple[Indices, ...], ...]

    def precedes(self, a: int, u: int, b: int, v: int) -> bool:
        """Tell whether node u of chain a must be complete before node v of chain b starts."""
        return bool(self.complete[a][b][v] > u)

    def not_after(self, a: int, u: int, b: int) -> int:
        """Return the number of first nodes of chain b that need not wait for node u of chain a."""
        return int(np.searchsorted(self.complete[a][b], u, side="right"))


def find_precedence(tpg: TemporalPlanGraph) -> Precedence | None:
    """Return the order that type-1 and type-2 edges impose, None for a cycle."""
    lengths = [len(chain) for chain in tpg.chains]
    first = np.cumsum([0, *lengths]).tolist()
    total = first[-1]
    sources: list[list[int]] = [[] for _ in range(total)]
    for a, length in enumerate(lengths):
        for v in range(1, length):
            sources[first[a] + v].append(first[a] + v - 1)
    for a, u, b, v in tpg.edges.tolist():
        sources[first[b] + v].append(first[a] + u)
    try:
        order = list(TopologicalSorter(dict(enumerate(sources))).static_order())
    except CycleError:
        return None
    complete = [[np.zeros(n, dtype=np.int64) for n in lengths] for _ in lengths]
    for a, length in enumerate(lengths):
        for start in range(0, length, _BLOCK):
            stop = min(start + _BLOCK, length)
            counts = _ancestors(sources, order, first[a] + start, first[a] + stop)
            for b in range(len(lengths)):
                complete[a][b] += counts[first[b] : first[b + 1]]
    return Precedence(tuple(tuple(row) for row in complete))


def _ancestors(
    sources: list[list[int]], order: list[int], start: int, stop: int
) -> Indices:
    """Return, for every node, how many of the nodes ``range(start, stop)`` precede it."""
    bits = [0] * len(sources)
    for v in order:
        mine = 0
        for u in sources[v]:
            mine |= bits[u]
            if start <= u < stop:
                mine |= 1 << (u - start)
        bits[v] = mine
    return np.array([b.bit_count() for b in bits], dtype=np.int64)


def not_as_said(
    tpg: TemporalPlanGraph, speeds: Mapping[str, Array]
) -> Iterator[Problem]:
    """Yield deviations of handlings from their tasks, and discontinuities of robots.

    Args:
        tpg: the plan.
        speeds: greatest speed of each joint of each robot, shape (n,) [rad/s or m/s].
    """
    handled: dict[int, list[NodeHandling]] = {}
    for h in tpg.handlings:
        handled.setdefault(int(tpg.chains[h.robot].task[h.node]), []).append(h)
    for changes in handled.values():
        changes.sort(key=lambda h: (h.node, h.waypoint))
    done: dict[int, list[tuple[int, int, int]]] = {}
    for k, chain in enumerate(tpg.chains):
        for index, first, stop in _nodes_of_tasks(chain):
            done.setdefault(index, []).append((k, first, stop))
    for task in tpg.tasks:
        undone = (
            task.kind not in (TaskKind.TRANSIT, TaskKind.LEFT_OUT) or task.handlings
        )
        if task.index not in done and undone:
            text = f"task {task.index} ({task.label}) of {task.robot!r} has no node"
            yield Problem("task", text)
        for own in done.get(task.index, ()):
            for text in _of_task(tpg, task, own, handled.get(task.index, [])):
                yield node_problem(tpg, "task", own[:2], f"{task.label}: {text}")
    for k, chain in enumerate(tpg.chains):
        if not tpg.cell.is_machine(chain.robot):
            yield from _jump_problems(tpg, k, speeds[chain.robot])


def _nodes_of_tasks(chain: NodeChain) -> Iterator[tuple[int, int, int]]:
    """Yield each task of a chain with its first node, and the node after its last."""
    tasks, first, count = np.unique(chain.task, return_index=True, return_counts=True)
    yield from zip(
        tasks.tolist(), first.tolist(), (first + count).tolist(), strict=True
    )


def _of_task(
    tpg: TemporalPlanGraph,
    task: Task,
    nodes: tuple[int, int, int],
    handled: list[NodeHandling],
) -> Iterator[str]:
    """Yield faults in the execution of a task: chain, first node, and the node after its last."""
    done = tpg.chains[nodes[0]]
    if task.robot != done.robot:
        yield f"is done by {done.robot!r}, and is a task of {task.robot!r}"
        return
    path = done.waypoints[done.first[nodes[1]] : done.first[nodes[2]]]
    if task.kind != TaskKind.TRANSIT:
        if len(path) != len(task.path):
            yield f"its path has {len(path)} waypoints, and that of its task {len(task.path)}"
        elif (away := np.abs(path - task.path).max()) > _SAME:
            yield f"its path is up to {away:.3g} rad or m beside that of its task"
    elif task.goal:
        away = np.abs(path[-1:] - task.path[-1:]).max(initial=0.0)
        if away > _SAME:
            yield f"it ends {away:.3g} rad or m beside the goal of its task"
    about = task.object if task.kind in _HANDLED_IN else None
    if about is not None and all(h.object != about for h in handled):
        yield f"{about!r} does not change hands in it"
    for said, h in zip_longest(task.handlings, handled):
        wrong = _otherwise(tpg, task, said, h, nodes[1])
        if wrong:
            yield wrong


def _otherwise(
    tpg: TemporalPlanGraph,
    task: Task,
    said: Handling | None,
    done: NodeHandling | None,
    begins: int,
) -> str:
    """Return the difference of a change of hands from its task, empty for none."""
    if said is None or done is None:
        one = said or done
        assert one is not None
        how = (
            "does not, though its task says so" if done is None else "is no part of it"
        )
        return f"that {_words(one)} {how}"
    if (said.object, said.holder) != (done.object, done.holder):
        return f"{_words(done)}, where its task says that {_words(said)}"
    first = tpg.chains[done.robot].first
    waypoint = int(first[done.node] - first[begins]) + done.waypoint
    if task.kind != TaskKind.TRANSIT and said.waypoint != waypoint:
        at = f"at waypoint {waypoint}, where its task says {said.waypoint}"
        return f"{_words(done)} {at}"
    apart = distance_of(tpg.cell.object(done.object), done.pose, said.pose)
    if apart > JUMP:
        return f"{_words(done)} {apart * 1e3:.2f} mm beside where its task says"
    return ""


def _words(change: Handling | NodeHandling) -> str:
    return f"{change.object!r} goes to {change.holder or 'rest'}"


def _jump_problems(
    tpg: TemporalPlanGraph, index: int, speeds: Array
) -> Iterator[Problem]:
    """Yield robots that do not begin at HOME, and nodes in which they exceed their speed limits."""
    chain = tpg.chains[index]
    away = np.abs(chain.start - tpg.cell.robot(chain.robot).home)
    if tpg.cell.begun is None and len(chain) and away.max() > _SAME:
        text = (
            f"begins {away.max():.3g} rad or m away from HOME (joint {away.argmax()})"
        )
        yield node_problem(tpg, "path", (index, 0), text)
    node = np.repeat(np.arange(len(chain)), np.diff(chain.first))
    passed = np.diff(chain.fraction, prepend=0.0)
    passed[chain.first[:-1]] = chain.fraction[chain.first[:-1]]
    time = passed * chain.duration[node]
    before = np.vstack([chain.start[None], chain.waypoints[:-1]])
    path = np.abs(chain.waypoints - before)
    most = speeds * time[:, None] * (1.0 + _FASTER) + _SAME
    for k in np.unique(node[np.any(path > most, axis=1)]).tolist():
        rows = np.flatnonzero(node == k)
        over = path[rows] - most[rows]
        row, joint = np.unravel_index(int(over.argmax()), over.shape)
        text = (
            f"joint {joint} jumps by {path[rows[row], joint]:.3g} rad or m in"
            f" {time[rows[row]]:.3g} s, and does at most {speeds[joint]:.3g} a second"
        )
        yield node_problem(tpg, "path", (index, k), text)

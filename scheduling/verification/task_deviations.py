"""Checks that the nodes of a saved plan do what its tasks specify.

The handling of objects must agree with the tasks, paths must be continuous, and speeds must be within the
limits of the robots.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import zip_longest

import numpy as np

from planning.tasks.task import Handling, Task, TaskKind
from planning.transforms import Array
from scheduling.graph.temporal_plan_graph import (
    NodeChain,
    NodeHandling,
    TemporalPlanGraph,
)
from scheduling.verification.object_places import JUMP, distance_of
from scheduling.verification.problems import Problem, node_problem

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

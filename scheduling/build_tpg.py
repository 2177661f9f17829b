"""Build the temporal plan graph of a motion plan (APEX-MR IV-C, Algorithm 1)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from planning.errors import PlanInvariantError
from planning.motion.motion_plan import MotionPlan, TaskMotion
from planning.parallel import side_by_side
from planning.tasks.task_graph import TRANSIT, Task
from planning.transforms import Array, Indices, readonly
from scheduling.conflicts.allowed_contacts import EntityNumbers, contact_table
from scheduling.conflicts.conflict_search import (
    ConflictChecker,
    HullChecker,
    find_motion_edges,
    goes_by_hulls,
)
from scheduling.conflicts.object_spans import trace_objects
from scheduling.conflicts.occupancy import Occupancy, chain_occupancy
from scheduling.conflicts.swept_sequence import LEAF
from scheduling.graph.reduction import order_and_reduce
from scheduling.graph.temporal_plan_graph import (
    MOTION_CONFLICT,
    TASK_DEPENDENCY,
    NodeChain,
    NodeHandling,
    TemporalPlanGraph,
)
from scheduling.graph.total_order import planned_ranks
from scheduling.invariant import check_invariant

_SAME = 1e-9
"""Joint values that differ by less are the same configuration [rad or m]."""


def build_tpg(
    plan: MotionPlan,
    *,
    checker: ConflictChecker | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> TemporalPlanGraph:
    """Return the temporal plan graph of a motion plan, reduced and checked.

    Args:
        plan: sequential or not; its planned times decide who goes first where.
        checker: decides conflicts; exact convex hulls by default.
        progress: called as the conflict search goes on, see ``find_motion_edges``.

    Raises:
        PlanInvariantError: the plan is not consistent, or a robot or object that stands is in
            the way of a motion planned meanwhile.
    """
    return connect_nodes(build_nodes(plan), checker=checker, progress=progress)


def connect_nodes(
    tpg: TemporalPlanGraph,
    *,
    checker: ConflictChecker | None = None,
    progress: Callable[[int, int], None] | None = None,
    occupied: tuple[EntityNumbers, list[Occupancy]] | None = None,
) -> TemporalPlanGraph:
    """Return the graph of nodes that have planned times, reduced and checked.

    Args:
        tpg: its nodes; its edges are not looked at.
        checker: decides conflicts; exact convex hulls by default.
        progress: called as the conflict search goes on, see ``find_motion_edges``.
        occupied: what ``occupancies_of`` returns, where that is known already.

    Raises:
        PlanInvariantError: a robot or object that stands is in the way of a motion planned
            meanwhile.
    """
    ranks = planned_ranks(tpg.chains)
    task_edges = dependency_edges(tpg.tasks, tpg.dependencies, tpg.chains)
    order, _ = order_and_reduce(ranks, task_edges)
    entities, occupancies = occupied or occupancies_of(tpg, ranks, checker)
    table = contact_table(entities, tpg.allowed, tpg.cell.clearances)
    motion_edges = find_motion_edges(
        occupancies,
        ranks,
        order,
        table,
        checker or HullChecker(table),
        progress,
    )
    edges = np.concatenate([task_edges, motion_edges])
    cause = np.repeat(
        np.array([TASK_DEPENDENCY, MOTION_CONFLICT], dtype=np.uint8),
        [len(task_edges), len(motion_edges)],
    )
    order, keep = order_and_reduce(ranks, edges)
    edges, cause = edges[keep], cause[keep]
    by_edge = np.lexsort(edges.T[::-1])
    tpg = replace(tpg, edges=edges[by_edge], cause=cause[by_edge])
    check_invariant(tpg, occupancies=occupancies, searched=True)
    return tpg


def build_nodes(plan: MotionPlan) -> TemporalPlanGraph:
    """Return the nodes of a plan without any type-2 edge: safe only one task after another.

    Raises:
        PlanInvariantError: the plan is not consistent.
    """
    chains, handlings = build_chains(plan)
    return TemporalPlanGraph(
        plan.cell,
        plan.tasks,
        chains,
        np.empty((0, 4), dtype=np.int64),
        np.empty(0, dtype=np.uint8),
        handlings,
        plan.allowed,
        np.asarray(plan.dependencies, dtype=np.int64).reshape(-1, 2),
    )


def occupancies_of(
    tpg: TemporalPlanGraph,
    ranks: tuple[Indices, ...],
    checker: ConflictChecker | None = None,
) -> tuple[EntityNumbers, list[Occupancy]]:
    """Return the occupancy of every chain, and the numbers of the entities in them.

    Args:
        tpg: its nodes.
        ranks: place of every node in the total order.
        checker: who will decide conflicts; exact convex hulls by default.
    """
    by_hulls = checker is None or goes_by_hulls(checker)
    leaf = LEAF if by_hulls else 1
    handled = dict.fromkeys(handling.object for handling in tpg.handlings)
    entities = EntityNumbers((r.name for r in tpg.cell.robots), handled)
    spans = trace_objects(tpg, ranks).spans
    return entities, side_by_side(
        lambda i: chain_occupancy(tpg, i, spans, entities, leaf=leaf),
        range(len(tpg.chains)),
    )


def build_chains(
    plan: MotionPlan,
) -> tuple[tuple[NodeChain, ...], tuple[NodeHandling, ...]]:
    """Return the nodes of every robot that has any, and what changes hands in them.

    Each waypoint of a transit but the first becomes a pose node, a skill one node. Pose nodes
    that do not move, waits of the input plan, are dropped (APEX-MR IV-C).

    Raises:
        PlanInvariantError: paths do not join, times fall, or arrays do not fit.
    """
    chains: list[NodeChain] = []
    handlings: list[tuple[float, NodeHandling]] = []
    for robot in plan.cell.robots:
        own = [
            (task, motion)
            for task, motion in zip(plan.tasks, plan.motions, strict=True)
            if task.robot == robot.name
        ]
        builder = _ChainBuilder(len(chains))
        for task, motion in own:
            builder.add(task, motion)
        if builder.task:
            chains.append(builder.chain(robot.name))
            handlings += builder.handlings
    handlings.sort(key=lambda item: item[0])
    return tuple(chains), tuple(handling for _, handling in handlings)


class _ChainBuilder:
    """Collects the nodes of one robot."""

    def __init__(self, index: int) -> None:
        self._index = index
        self._start: Array | None = None
        self._end: Array | None = None
        self._waypoints: list[Array] = []
        self._fraction: list[float] = []
        self._first: list[int] = [0]
        self._skill: list[bool] = []
        self._duration: list[float] = []
        self._planned: list[float] = []
        self.task: list[int] = []
        self.handlings: list[tuple[float, NodeHandling]] = []

    def add(self, task: Task, motion: TaskMotion) -> None:
        path, time = self._checked(task, motion)
        if self._start is None:
            self._start = path[0]
        if task.kind == TRANSIT:
            self._add_poses(task, path, time)
        else:
            self._add_skill(task, path, time)
        self._end = path[-1]

    def _checked(self, task: Task, motion: TaskMotion) -> tuple[Array, Array]:
        path = np.asarray(motion.path, dtype=np.float64)
        time = np.asarray(motion.time, dtype=np.float64)
        name = f"task {task.index} ({task.label}) of robot {task.robot!r}"
        if path.ndim != 2 or len(path) == 0 or time.shape != (len(path),):
            raise PlanInvariantError(
                f"{name}: {time.shape} times for a path of shape {path.shape}"
            )
        if np.any(np.diff(time) < 0.0):
            raise PlanInvariantError(f"{name}: its planned times fall")
        if self._end is not None and np.max(np.abs(path[0] - self._end)) > _SAME:
            raise PlanInvariantError(
                f"{name} starts {np.max(np.abs(path[0] - self._end)):.3g} away from where"
                f" task {self.task[-1] if self.task else 'before it'} ended"
            )
        for handling in task.handlings:
            if not 0 <= handling.waypoint < len(path):
                raise PlanInvariantError(
                    f"{name}: handles {handling.object!r} at waypoint"
                    f" {handling.waypoint} of a path with {len(path)}"
                )
        return path, time

    def _add_poses(self, task: Task, path: Array, time: Array) -> None:
        handled = {h.waypoint for h in task.handlings}
        where: dict[int, tuple[int, int]] = {}
        moves = np.any(path[1:] != path[:-1], axis=1).tolist()
        for k in range(1, len(path)):
            if not (moves[k - 1] or k in handled or (k == 1 and 0 in handled)):
                continue
            node = self._append(
                task.index, False, time[k - 1], time[k], path[k : k + 1]
            )
            self._fraction.append(1.0)
            where[k] = (node, 1)
            if k == 1:
                where[0] = (node, 0)
        if handled and not where:
            node = self._append(task.index, False, time[0], time[0], path[:1])
            self._fraction.append(1.0)
            where[0] = (node, 0)
        self._add_handlings(task, time, where)

    def _add_skill(self, task: Task, path: Array, time: Array) -> None:
        reference = path[1:] if len(path) > 1 else path
        node = self._append(task.index, True, time[0], time[-1], reference)
        span = time[-1] - time[0]
        if len(path) == 1:
            fraction = np.ones(1)
        elif span > 0.0:
            fraction = (time[1:] - time[0]) / span
        else:
            fraction = np.arange(1, len(path)) / (len(path) - 1)
        fraction[-1] = 1.0
        self._fraction += fraction.tolist()
        where = {k: (node, k) for k in range(len(path))}
        self._add_handlings(task, time, where)

    def _append(
        self, task: int, skill: bool, start: float, end: float, waypoints: Array
    ) -> int:
        self._waypoints.append(waypoints)
        self._first.append(self._first[-1] + len(waypoints))
        self.task.append(task)
        self._skill.append(skill)
        self._duration.append(float(end - start))
        self._planned.append(float(start))
        return len(self.task) - 1

    def _add_handlings(
        self, task: Task, time: Array, where: dict[int, tuple[int, int]]
    ) -> None:
        for h in task.handlings:
            node, waypoint = where[h.waypoint]
            self.handlings.append(
                (
                    float(time[h.waypoint]),
                    NodeHandling(
                        h.object,
                        self._index,
                        node,
                        waypoint,
                        h.holder,
                        readonly(h.pose),
                    ),
                )
            )

    def chain(self, robot: str) -> NodeChain:
        def frozen(values: list[int]) -> Indices:
            out = np.array(values, dtype=np.int64)
            out.setflags(write=False)
            return out

        assert self._start is not None
        skill = np.array(self._skill, dtype=np.bool_)
        skill.setflags(write=False)
        return NodeChain(
            robot,
            readonly(self._start),
            readonly(np.concatenate(self._waypoints)),
            readonly(self._fraction),
            frozen(self._first),
            frozen(self.task),
            skill,
            readonly(self._duration),
            readonly(self._planned),
        )


def dependency_edges(
    all_tasks: Sequence[Task], dependencies: Indices, chains: tuple[NodeChain, ...]
) -> Indices:
    """Return a type-2 edge for every task dependency between robots, shape (e, 4).

    From the last node of the task that must be complete to the first node of the task that
    then may start. A task without nodes passes on what it waits for.

    Raises:
        PlanInvariantError: a dependency goes against the plan's own order within a robot.
    """
    index = {chain.robot: i for i, chain in enumerate(chains)}
    before: dict[int, list[int]] = {}
    for a, b in dependencies.tolist():
        before.setdefault(b, []).append(a)
    previous: dict[str, int] = {}
    for task in all_tasks:
        if task.robot in previous:
            before.setdefault(task.index, []).append(previous[task.robot])
        previous[task.robot] = task.index
    tasks = {task.index: task for task in all_tasks}
    nodes: dict[int, tuple[int, int, int]] = {}
    for task in all_tasks:
        chain = index.get(task.robot)
        if chain is not None:
            first, stop = np.searchsorted(
                chains[chain].task, [task.index, task.index + 1]
            ).tolist()
            if first < stop:
                nodes[task.index] = (chain, first, stop - 1)
    ends: dict[int, frozenset[tuple[int, int]]] = {}

    def last_nodes(task: int) -> frozenset[tuple[int, int]]:
        """Return the nodes whose completion says that a task is complete."""
        todo = [task]
        while todo:
            t = todo[-1]
            if t in ends:
                todo.pop()
            elif t in nodes:
                ends[t] = frozenset([(nodes[t][0], nodes[t][2])])
            else:
                missing = [s for s in before.get(t, ()) if s not in ends]
                if any(s in todo for s in missing):
                    raise PlanInvariantError(f"task {t} depends on itself")
                if missing:
                    todo += missing
                else:
                    ends[t] = frozenset().union(*(ends[s] for s in before.get(t, ())))
        return ends[task]

    edges: set[tuple[int, int, int, int]] = set()
    for b, sources in before.items():
        if b not in nodes:
            continue
        chain, first, _ = nodes[b]
        for a in sources:
            if a not in tasks:
                raise PlanInvariantError(
                    f"task {b} depends on task {a}, which is not there"
                )
            for robot, node in last_nodes(a):
                if robot != chain:
                    edges.add((robot, node, chain, first))
                elif node >= first:
                    raise PlanInvariantError(
                        f"task {b} depends on task {a}, which robot"
                        f" {chains[chain].robot!r} does after it"
                    )
    return np.array(sorted(edges), dtype=np.int64).reshape(-1, 4)

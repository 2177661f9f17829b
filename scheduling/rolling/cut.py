"""Division of a temporal plan graph at a point of its execution, into a committed part and a part to be replanned.

The *committed prefix* contains all released nodes, and all nodes that can be completed without the steps to be
replaced. The other nodes come after the cut. Committed nodes wait only for committed nodes, so they can be
executed to the end whatever is planned after the cut. No robot that stops at the cut blocks a committed node: a
node that it would block must wait for a node after the cut, and is therefore not committed.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from typing import NamedTuple

from planning.cell.workcell import WorldState
from planning.tasks.task import (
    AllowedContact,
    Handling,
    StepTasks,
    Task,
    TaskKind,
    apply_handlings,
)
from scheduling.conflicts.object_spans import handlings_in_order
from scheduling.graph.task_edges import TaskNodes, task_nodes
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.graph.total_order import planned_ranks

Counts = tuple[int, ...]
"""How many nodes of each chain, from its first on."""


def cut_after(
    tpg: TemporalPlanGraph,
    released: Sequence[int],
    never: Collection[tuple[int, int]] = (),
    *,
    steps: bool = True,
    continue_s: Sequence[float] = (),
) -> Counts:
    """Return a cut: the number of committed nodes of each chain.

    Args:
        tpg: the graph.
        released: how many nodes of each chain have been released: they are committed.
        never: nodes (chain, node) that are not executed any more, nor what waits for them; they may
            have been released.
        steps: whether a robot continues to the end of what it does for the step that it has begun a
            skill of; else to the end of its task.
        continue_s: for how long each robot continues, task by task, beyond its released nodes [s].

    Returns:
        A number of nodes a chain. Where something can be committed, a robot stops neither within a
        transit nor within a skill. Time that is to pass after what is committed passes.
    """
    found = _Commitment(tpg, released, never)
    for k in range(len(tpg.chains)):
        found.finish_task(k)
    if steps:
        for k in range(len(tpg.chains)):
            found.finish_step(k)
    for k, seconds in enumerate(continue_s):
        found.continue_for(k, released[k], seconds)
    for k in range(len(tpg.chains)):
        found.finish_lag(k)
    return tuple(found.counts)


class _Commitment:
    """Committed prefix, closed under predecessors."""

    def __init__(
        self,
        tpg: TemporalPlanGraph,
        released: Sequence[int],
        never: Collection[tuple[int, int]],
    ) -> None:
        self.tpg = tpg
        self.limit = [len(chain) for chain in tpg.chains]
        for k, node in never:
            self.limit[k] = min(self.limit[k], node)
        self.counts = [min(a, b) for a, b in zip(released, self.limit, strict=True)]
        self._sources: dict[tuple[int, int], list[tuple[int, int]]] = {}
        for k, u, i, v in tpg.edges.tolist():
            self._sources.setdefault((i, v), []).append((k, u))
        self._of_node = [
            {n: own for own in tasks for n in range(own.first, own.stop)}
            for tasks in task_nodes(tpg.chains)
        ]

    def commit(self, chain: int, count: int) -> bool:
        """Commit the nodes of a chain up to a number, with all their predecessors, if possible."""
        counts, todo = list(self.counts), [(chain, count)]
        while todo:
            k, upto = todo.pop()
            if upto > self.limit[k]:
                return False
            fresh = range(counts[k], upto)
            counts[k] = max(counts[k], upto)
            for node in fresh:
                todo += [(i, u + 1) for i, u in self._sources.get((k, node), ())]
        self.counts = counts
        return True

    def finish_task(self, chain: int) -> None:
        """Commit the rest of the current task of a robot."""
        while (own := self._within(chain)) is not None:
            if not self.commit(chain, own.stop):
                return

    def finish_step(self, chain: int) -> None:
        """Commit the rest of the current step of a robot, task by task."""
        tasks, chains = self.tpg.tasks, self.tpg.chains
        at = self.counts[chain]
        own = chains[chain].task[:at]
        skills = own[chains[chain].skill[:at]]
        if len(skills) == 0:
            return
        step = tasks[int(skills[-1])].step
        while (node := self.counts[chain]) < len(chains[chain]):
            following = self._of_node[chain][node]
            if tasks[following.task].step != step:
                return
            if not self.commit(chain, following.stop):
                return

    def continue_for(self, chain: int, released: int, seconds: float) -> None:
        """Commit further tasks of a chain for a duration beyond its released nodes [s]."""
        duration = self.tpg.chains[chain].duration
        while (node := self.counts[chain]) < len(duration):
            following = self._of_node[chain][node].stop
            if duration[released:node].sum() >= seconds:
                return
            if not self.commit(chain, following):
                return

    def finish_lag(self, chain: int) -> None:
        """Commit the minimum time lag after a step if it starts automatically."""
        node = self.counts[chain]
        own = self._of_node[chain].get(node)
        if own is None or self.tpg.tasks[own.task].kind != TaskKind.LAG:
            return
        if all(u < self.counts[k] for k, u in self._sources.get((chain, node), ())):
            self.commit(chain, own.stop)

    def _within(self, chain: int) -> TaskNodes | None:
        node = self.counts[chain]
        own = self._of_node[chain].get(node)
        return None if own is None or own.first == node else own


def complete_tasks(tpg: TemporalPlanGraph, counts: Sequence[int]) -> frozenset[int]:
    """Return the tasks that are complete after a number of nodes of each chain.

    A task without nodes is complete as soon as all before it are.
    """
    index, found = tpg.chain_index, set()
    stop: dict[str, int] = {}
    for chain, count in zip(tpg.chains, counts, strict=True):
        if count < len(chain):
            stop[chain.robot] = int(chain.task[count])
    for task in tpg.tasks:
        if task.kind == TaskKind.LEFT_OUT or task.robot not in index:
            continue
        if task.index < stop.get(task.robot, task.index + 1):
            found.add(task.index)
    return frozenset(found)


def world_state_after(tpg: TemporalPlanGraph, counts: Sequence[int]) -> WorldState:
    """Return the world state at rest after a number of complete nodes of each chain.

    Args:
        tpg: the graph.
        counts: nodes of each chain; what a node of them waits for is among them.
    """
    state = tpg.cell.start_state()
    for chain, count in zip(tpg.chains, counts, strict=True):
        state = state.with_robot(chain.robot, chain.stands_at(count))
    done = [
        Handling(h.object, h.waypoint, h.holder, h.pose)
        for h in handlings_in_order(tpg, planned_ranks(tpg.chains))
        if h.node < counts[h.robot]
    ]
    return apply_handlings(state, done)


def planned_steps(tpg: TemporalPlanGraph) -> tuple[StepTasks, ...]:
    """Return the tasks of a graph grouped by step, with their dependencies and contacts.

    Nothing of what is brought or taken out, and no attempts that failed.
    """
    by_step: dict[int, list[Task]] = {}
    step_of: dict[int, int] = {}
    for task in tpg.tasks:
        if task.kind not in (
            TaskKind.LEFT_OUT,
            TaskKind.BROUGHT,
            TaskKind.FAILED,
            TaskKind.TAKEN_OUT,
        ):
            by_step.setdefault(task.step, []).append(task)
            step_of[task.index] = task.step
    waits: dict[int, list[tuple[int, int]]] = {}
    for a, b in tpg.dependencies.tolist():
        if a in step_of and step_of[a] == step_of.get(b):
            waits.setdefault(step_of[a], []).append((a, b))
    allowed: dict[int, list[AllowedContact]] = {}
    for contact in tpg.allowed:
        for step in {step_of[t] for t in contact.tasks if t in step_of}:
            allowed.setdefault(step, []).append(contact)
    return tuple(
        StepTasks(
            step,
            tuple(tasks),
            tuple(waits.get(step, ())),
            tuple(allowed.get(step, ())),
        )
        for step, tasks in sorted(by_step.items())
    )


class KeptHold(NamedTuple):
    """A placed part that is, or was, still held.

    Attributes:
        part: its name.
        robot: the robot that holds it.
        last: what has come by which it stands; nothing as long as nothing has.
        left: whether its robot has left it.
    """

    part: str
    robot: str
    last: str
    left: bool


def active_holds(
    tpg: TemporalPlanGraph, complete: Collection[int]
) -> Iterator[KeptHold]:
    """Yield the placed parts that are, or were, held when some tasks are complete.

    The retreat of a robot that holds a part is a task of its own, with the part as its object but without a
    handling; it waits for the placements until then. Other retreats belong to the placing skill.
    """
    until: dict[int, Task] = {}
    for first, second in tpg.dependencies.tolist():
        if tpg.tasks[first].kind == "place-down":
            until[second] = tpg.tasks[first]
    before: dict[str, Task] = {}
    for task in tpg.tasks:
        if task.kind in (TaskKind.LEFT_OUT, TaskKind.FAILED):
            continue
        put = before.get(task.robot)
        before[task.robot] = task
        if put is None or task.kind != TaskKind.TRANSIT or put.kind != "place-down":
            continue
        if task.object == put.object is not None and put.index in complete:
            own = until.get(task.index)
            there = own is not None and own.index in complete
            last = str(own.object) if own is not None and there else ""
            yield KeptHold(put.object, task.robot, last, task.index in complete)

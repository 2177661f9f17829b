"""Parts lie where the scenario says on their way, and for as long as machines work at them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise

import numpy as np

from planning.tasks.task import GONE, Task
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.audit.edge_order import NodeSpans
from twin.audit.motion.executed import ObjectRow, Recording
from twin.audit.places import PLACED, distance_of
from twin.audit.violation import Violation
from twin.audit.wanted import Wanted, WantedRest

_TICK = 1e-6
"""Times of tables may differ by their rounding [s]."""


def rest_violations(
    tpg: TemporalPlanGraph,
    recording: Recording,
    wanted: Wanted,
    spans: Mapping[str, NodeSpans],
) -> Iterator[Violation]:
    """Yield parts that were not put down on their way, or did not lie there while machines worked.

    Each part comes to rest at its stops in their order. Each process that no robot does is one task
    of its name at its part; from its begin to its end the part lies where the scenario has it by
    then, its door is shut when it ends, and what it comes after is complete.

    Args:
        tpg: says which tasks are processes, and of which machines.
        recording: what was executed, to its end.
        wanted: where the scenario wants what, in which order.
        spans: when nodes were started and completed, by robot or machine.
    """
    rows: dict[str, list[ObjectRow]] = {item.name: [] for item in tpg.cell.objects}
    for row in recording.objects:
        rows[row.object].append(row)
    looked: dict[str, int] = {}
    times: dict[str, tuple[float, float]] = {}
    work = machine_work(tpg, wanted, spans)
    for k, rest in enumerate(wanted.rests):
        own = rows[rest.part]
        # To be put down somewhere it comes to rest anew.
        first = looked.get(rest.part, 0) + (rest.process is None)
        at = next((n for n in range(first, len(own)) if _lies(tpg, own[n], rest)), None)
        if at is None:
            yield _violation(recording.end, rest, "it never lies where it should")
            continue
        looked[rest.part] = at
        if rest.process is None:
            continue
        if k not in work:
            yield _violation(recording.end, rest, "was not done")
            continue
        task, begin, end = work[k]
        since = own[at].t
        until = own[at + 1].t if at + 1 < len(own) else np.inf
        if not since - _TICK <= begin <= end <= until + _TICK:
            words = (
                f"was done from {begin:.3f} s to {end:.3f} s, and {rest.part} lies there from"
                f" {since:.3f} s to {until:.3f} s"
            )
            yield _violation(begin, rest, words)
        door = next((h.object for h in task.handlings), None)
        if door in wanted.doors and not _shut(rows[str(door)], begin, end):
            yield _violation(begin, rest, f"{door} was not shut until its end")
        if rest.name is not None:
            times[rest.name] = begin, end
    for rest in wanted.rests:
        for after in rest.after:
            begin, _ = times.get(rest.name or "", (np.inf, np.inf))
            _, end = times.get(after, (-np.inf, -np.inf))
            if begin < end - _TICK:
                yield _violation(begin, rest, f"begins before {after} is complete")


def machine_work(
    tpg: TemporalPlanGraph, wanted: Wanted, spans: Mapping[str, NodeSpans]
) -> dict[int, tuple[Task, float, float]]:
    """Return who works at parts without a robot, by number of the wanted rest: task, begin, end [s].

    Tasks that are alike are taken in the plan's order. What is not in the plan is left out.
    """
    left = {task.index: task for task in tpg.tasks if tpg.cell.is_machine(task.robot)}
    work = {}
    for k, rest in enumerate(wanted.rests):
        index = next((n for n, task in left.items() if _is(rest, task)), None)
        if rest.process is not None and index is not None:
            task = left.pop(index)
            work[k] = task, *_span(tpg, spans, task.robot, index)
    return work


def _is(rest: WantedRest, task: Task) -> bool:
    """Tell whether a task of a machine is one that is wanted."""
    return (
        task.kind == rest.process
        and task.object == rest.part
        and rest.machine in (None, task.robot)
    )


def _lies(tpg: TemporalPlanGraph, row: ObjectRow, rest: WantedRest) -> bool:
    item = tpg.cell.object(rest.part)
    return row.holder is None and distance_of(item, row.pose, rest.pose) <= PLACED


def _span(
    tpg: TemporalPlanGraph, spans: Mapping[str, NodeSpans], machine: str, index: int
) -> tuple[float, float]:
    """Return from when to when a machine was at a task [s]."""
    nodes = np.flatnonzero(tpg.chains[tpg.chain_index[machine]].task == index)
    own = spans[machine]
    return float(own.begin[nodes].min()), float(own.end[nodes].max())


def _shut(rows: Sequence[ObjectRow], begin: float, end: float) -> bool:
    """Tell whether a door was shut within some time, and until the end of it [s]."""
    return any(
        shut.holder is None
        and opened.holder == GONE
        and begin - _TICK <= shut.t <= end
        and opened.t >= end - _TICK
        for shut, opened in pairwise(rows)
    )


def _violation(t: float, rest: WantedRest, words: str) -> Violation:
    by = rest.machine or "world"
    return Violation(t, t, rest.words, by, 0.0, words, "process")

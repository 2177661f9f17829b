"""Audit of the positions of parts at intermediate places, and at machines while these work on them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from planning.tasks.task import Handling, Task
from twin.audits.case import AuditCase, Violation
from twin.audits.expectations import ExpectedRest
from twin.audits.motion.executed import Stay
from twin.audits.places import rests_at

_TICK = 1e-6
"""Rounding tolerance of times in tables [s]."""


def rest_violations(case: AuditCase) -> Iterator[Violation]:
    """Yield parts missing at intermediate places, or at machines while these worked.

    What was done before the plan began is not looked at. Each part comes to rest at its stops in their order. Each process that no robot does is one task
    of its name at its part; from its begin to its end the part lies where the scenario has it by
    then, its door is shut when it ends, and what it comes after is complete. Only where a log says
    when machines worked.
    """
    wanted, begun = case.wanted, case.cell.begun
    before = () if begun is None else begun.steps
    looked: dict[str, int] = {}
    times: dict[str, tuple[float, float]] = {}
    work = machine_work_spans(case)
    for k, rest in enumerate(wanted.rests):
        if rest.step in before:
            continue
        own, item = case.stays[rest.part], case.cell.object(rest.part)
        # A placement requires a new stay.
        first = looked.get(rest.part, 0) + (rest.process is None)
        at = next(
            (n for n in range(first, len(own)) if rests_at(item, own[n], rest.pose)),
            None,
        )
        if at is None:
            yield _violation(case.end, rest, "it never lies where it should")
            continue
        looked[rest.part] = at
        if rest.process is None:
            continue
        if k not in work:
            yield _violation(case.end, rest, "was not done")
            continue
        task, begin, end = work[k]
        since, until = own[at].t, own[at].until
        if not since - _TICK <= begin <= end <= until + _TICK:
            words = (
                f"was done from {begin:.3f} s to {end:.3f} s, and {rest.part} lies there from"
                f" {since:.3f} s to {until:.3f} s"
            )
            yield _violation(begin, rest, words)
        door = next((h.object for h in task.handlings), None)
        if door in wanted.doors and not _shut(case.stays[str(door)], begin, end):
            yield _violation(begin, rest, f"{door} was not shut until its end")
        if rest.name is not None:
            times[rest.name] = begin, end
    for rest in wanted.rests:
        for after in rest.after:
            begin, _ = times.get(rest.name or "", (np.inf, np.inf))
            _, end = times.get(after, (-np.inf, -np.inf))
            if begin < end - _TICK:
                yield _violation(begin, rest, f"begins before {after} is complete")


def machine_work_spans(case: AuditCase) -> dict[int, tuple[Task, float, float]]:
    """Return machine tasks at parts, by number of the expected rest: task, begin, end [s].

    Tasks that are alike are taken in the plan's order; the parts of a batch have one in common. What is not in
    the plan is left out.
    """
    tpg, cell = case.tpg, case.cell
    left = {task.index: task for task in tpg.tasks if cell.is_machine(task.robot)}
    work: dict[int, tuple[Task, float, float]] = {}
    batches: dict[int, tuple[Task, float, float]] = {}
    for k, rest in enumerate(case.wanted.rests):
        if rest.process is not None and rest.step in batches:
            work[k] = batches[rest.step]
            continue
        index = next((n for n, task in left.items() if _is(rest, task)), None)
        if rest.process is not None and index is not None:
            task = left.pop(index)
            nodes = tpg.chains[tpg.chain_index[task.robot]].task == index
            own = case.logged[task.robot]
            times = float(own.begin[nodes].min()), float(own.end[nodes].max())
            work[k] = batches[rest.step] = task, *times
    return work


def _is(rest: ExpectedRest, task: Task) -> bool:
    """Return whether a machine task is an expected one."""
    return (
        task.kind == rest.process
        and task.object == rest.part
        and rest.machine in (None, task.robot)
    )


def _shut(stays: Sequence[Stay], begin: float, end: float) -> bool:
    """Return whether a door was shut within an interval, up to its end [s]."""
    return any(
        shut.holder is None
        and opened.holder == Handling.GONE
        and begin - _TICK <= shut.t <= end
        and opened.t >= end - _TICK
        for shut, opened in pairwise(stays)
    )


def _violation(t: float, rest: ExpectedRest, words: str) -> Violation:
    by = rest.machine or "world"
    return Violation(t, t, rest.words, by, 0.0, words, "process")

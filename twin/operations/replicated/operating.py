"""Replications with replanning after failures, as in ``twin operate``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from planning.tasks.task import TaskKind
from planning.transforms import Indices
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.planned_motions import PlannedMotions
from twin.durations.nanoseconds import NANOSECONDS, Nanoseconds
from twin.engine.execution_model import ExecutionModel
from twin.engine.model_holds import with_model_holds
from twin.operations.operation import Operation, operate
from twin.operations.replicated.hindsight import Hindsight
from twin.scenario.sections.scenario import Scenario

RUNGS = ("done_again", "begun_anew", "not_done_any_more", "robots_out", "asked")
"""Kinds of recovery from failures for good: retry with the same object, the step with another object, none;
then outages of robots, and questions to a person."""

SAME = "same"
"""Outcome of a replication that equals its reference and need not be computed."""


@dataclass(frozen=True)
class OperatedRows:
    """Results of operations, one column per replication; only ``knew_ns`` where no skill failed for good.

    Attributes:
        versions: graphs that took over, shape (r,).
        recoveries: count of each kind of recovery, in the order of RUNGS, shape (5, r).
        steps: numbers of all steps, shape (s,).
        given_up: 1 for an abandoned step, shape (s, r).
        skills: those that may fail, shape (k,).
        failed: 1 for a skill of which an attempt failed in a replication that was operated, shape (k, r).
        knew_ns: makespan of the plan with hindsight; -1 without one, shape (r,) [ns].
    """

    versions: Indices
    recoveries: Indices
    steps: Indices
    given_up: Indices
    skills: npt.NDArray[Any]
    failed: Indices
    knew_ns: Nanoseconds

    def columns(self, makespan_ns: Nanoseconds) -> dict[str, Any]:
        """Return the columns of ``replications.parquet`` in addition to those of every study."""
        known = self.knew_ns >= 0
        lost = (makespan_ns - self.knew_ns) / NANOSECONDS
        gone = [self.steps[own > 0].tolist() for own in self.given_up.T]
        return {
            "versions": self.versions,
            **dict(zip(RUNGS, self.recoveries, strict=True)),
            "given_up": [" ".join(map(str, own)) for own in gone],
            "regret_s": np.where(known, lost, np.nan),
        }


@dataclass(frozen=True)
class OperatingWorkload:
    """Data to operate a plan, sent along with its timing graph.

    Attributes:
        scenario: scenario with its recovery section.
        motions: base motions of the plan, with all candidates.
        tpg: the plan.
        skills: those that may fail.
        only: numbers of the replications to operate for a comparison with existing ones; None for
            all, with plans with hindsight.
    """

    scenario: Scenario
    motions: PlannedMotions
    tpg: TemporalPlanGraph
    skills: tuple[str, ...]
    only: frozenset[int] | None = None

    @property
    def robots(self) -> tuple[str, ...]:
        """All robots, as idle ones may get tasks."""
        return tuple(robot.name for robot in self.motions.cell.robots)

    def leaves(self, replication: int) -> bool:
        """Return whether a replication need not be operated."""
        return self.only is not None and replication not in self.only

    def rows(self, count: int) -> OperatedRows:
        """Return rows of replications without failures."""
        steps = sorted(choice.step for choice in self.motions.task_plan.choices)
        return OperatedRows(
            np.zeros(count, dtype=np.int64),
            np.zeros((len(RUNGS), count), dtype=np.int64),
            np.array(steps, dtype=np.int64),
            np.zeros((len(steps), count), dtype=np.int64),
            np.array(self.skills, dtype=str),
            np.zeros((len(self.skills), count), dtype=np.int64),
            np.full(count, -1, dtype=np.int64),
        )


class Operator:
    """Operates replications of a plan, one after the other."""

    def __init__(
        self, operated: OperatingWorkload, model: ExecutionModel, seed: int
    ) -> None:
        self._operated, self._model, self._seed = operated, model, seed
        about = operated.scenario, operated.motions, operated.tpg
        self._hindsight = Hindsight(*about, model)
        self._held = with_model_holds(operated.tpg, model)

    def run(self, replication: int) -> Operation:
        """Operate a replication."""
        own = self._operated
        return operate(
            own.scenario,
            own.motions,
            own.tpg,
            self._model,
            seed=self._seed,
            replication=replication,
            held=self._held,
        )

    def enter(self, rows: OperatedRows, place: int, done: Operation) -> None:
        """Enter the result of a replication."""
        own = self._operated
        rows.versions[place] = len(done.versions)
        rows.recoveries[:, place] = _recoveries(own.tpg, done)
        rows.given_up[:, place] = np.isin(rows.steps, list(done.given_up))
        rows.failed[:, place] = np.isin(rows.skills, _failed_skills(own.tpg, done))
        if done.versions and own.only is None:
            knew = self._hindsight.makespan_ns(done)
            rows.knew_ns[place] = -1 if knew is None else knew


def _recoveries(first: TemporalPlanGraph, done: Operation) -> list[int]:
    """Return the count of each kind of recovery, in the order of RUNGS."""
    counts = dict.fromkeys(RUNGS, 0)
    tasks = done.tpg.tasks
    # Where a process has failed, a part that is handled goes into the bin.
    handled = {t.step for t in first.tasks if t.kind in TaskKind.HANDLING}
    for k, task in enumerate(tasks):
        if task.kind != TaskKind.FAILED:
            continue
        after = [
            later.object
            for later in tasks[k + 1 :]
            if later.step == task.step
            and later.object is not None
            and later.kind
            not in (TaskKind.TRANSIT, TaskKind.STRAIGHT, TaskKind.TAKEN_OUT)
            and (later.kind not in TaskKind.HANDLING or later.step in handled)
        ]
        rung = "not_done_any_more"
        if after:
            rung = "done_again" if after[0] == task.object else "begun_anew"
        counts[rung] += 1
    counts["robots_out"], counts["asked"] = len(done.out), len(done.asks)
    return list(counts.values())


def _failed_skills(first: TemporalPlanGraph, done: Operation) -> Sequence[str]:
    """Return the skills with failed attempts, for good or not."""
    kinds: dict[int, str] = {}
    for graph in (first, *(version.tpg for version in done.versions)):
        for k, task in enumerate(graph.tasks):
            kinds.setdefault(k, task.kind)
    return sorted(
        {
            kinds[int(chain.task[stand.node])]
            for chain, stands in zip(
                done.tpg.chains, done.record.standstills, strict=True
            )
            for stand in stands
            if stand.cause == "retry"
        }
    )

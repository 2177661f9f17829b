"""The durations that duration models give the nodes of a TPG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from planning.transforms import Array
from scheduling.temporal_plan_graph import NodeChain, TemporalPlanGraph
from twin.draws import uniforms
from twin.durations.model import DurationModel
from twin.durations.nanoseconds import NANOSECONDS, Nanoseconds, to_nanoseconds


class NodeDurations(Protocol):
    """What gives every node of a TPG its duration in one replication."""

    def sample(
        self, tpg: TemporalPlanGraph, *, seed: int, replication: int = 0
    ) -> tuple[Nanoseconds, ...]:
        """Return durations per chain, each of shape (nodes,) [ns]."""
        ...


@dataclass(frozen=True)
class SkillDurations:
    """Skills vary, motions take their nominal time.

    A duration belongs to the task, not to the run: the same task has the same draw under every
    policy and however its nodes were cut.

    Attributes:
        models: duration model of each skill; a skill without one keeps its nominal duration.
    """

    models: Mapping[str, DurationModel]

    def sample(
        self, tpg: TemporalPlanGraph, *, seed: int, replication: int = 0
    ) -> tuple[Nanoseconds, ...]:
        """Return durations per chain, each of shape (nodes,) [ns]."""
        return tuple(
            self._sample_chain(tpg, chain, seed, replication) for chain in tpg.chains
        )

    def _sample_chain(
        self, tpg: TemporalPlanGraph, chain: NodeChain, seed: int, replication: int
    ) -> Nanoseconds:
        out = to_nanoseconds(chain.duration)
        nodes = np.flatnonzero(chain.skill)
        by_skill: dict[str, list[int]] = {}
        for task in dict.fromkeys(chain.task[nodes].tolist()):
            if tpg.tasks[task].kind in self.models:
                by_skill.setdefault(tpg.tasks[task].kind, []).append(task)
        for skill, tasks in by_skill.items():
            count = len(tasks)
            u = uniforms(
                seed,
                replication,
                [chain.robot] * count,
                tasks,
                [skill] * count,
                "duration",
            )
            totals = to_nanoseconds(self.models[skill].ppf(u)).tolist()
            for task, total in zip(tasks, totals, strict=True):
                low, high = np.searchsorted(chain.task, (task, task + 1))
                own = np.arange(low, high)[chain.skill[low:high]]
                out[own] = _share(total, chain.duration[own])
        return out


def _share(total: int, weights: Array) -> Nanoseconds:
    """Split a whole number in proportion to weights; the parts add up to it exactly."""
    if len(weights) == 1:
        return np.array([total], dtype=np.int64)
    cumulative = np.cumsum(weights)
    if cumulative[-1] <= 0:
        cumulative = np.arange(1.0, len(weights) + 1)
    bounds = np.rint(cumulative / cumulative[-1] * total).astype(np.int64)
    return np.asarray(np.diff(bounds, prepend=0), dtype=np.int64)


def nominal_durations(tpg: TemporalPlanGraph) -> tuple[Nanoseconds, ...]:
    """Return the planned duration of every node, per chain [ns]."""
    return tuple(to_nanoseconds(chain.duration) for chain in tpg.chains)


def total_duration_s(durations: Sequence[Nanoseconds]) -> float:
    """Return the sum of all durations [s]: the makespan of one robot at a time."""
    return sum(int(d.sum()) for d in durations) / NANOSECONDS

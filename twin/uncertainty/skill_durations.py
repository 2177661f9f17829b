"""The durations that duration models give the nodes of a TPG."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from planning.transforms import Indices
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations.model import DurationModel
from twin.durations.nanoseconds import NANOSECONDS, Nanoseconds, to_nanoseconds
from twin.uncertainty.skill_draws import SkillDraws, bind_draws


class NodeDurations(Protocol):
    """What gives every node of a TPG its duration in one replication."""

    def sample(
        self, tpg: TemporalPlanGraph, *, seed: int, replication: int = 0
    ) -> tuple[Nanoseconds, ...]:
        """Return durations per chain, each of shape (nodes,) [ns]."""
        ...


@dataclass(frozen=True)
class DurationOverride:
    """An exception: a skill done by one robot, to one type of object, or both.

    Attributes:
        skill: which skill.
        model: its durations.
        robot: who does it, None for anyone.
        object_kind: type of what it is done to, None for anything.
    """

    skill: str
    model: DurationModel
    robot: str | None = None
    object_kind: str | None = None


@dataclass(frozen=True)
class SkillDurations:
    """Skills vary, motions take their nominal time.

    A duration belongs to the task, not to the run: the same task has the same draw under every
    policy and however its nodes were cut.

    Attributes:
        models: duration model of each skill; a skill without one keeps its nominal duration.
        overrides: exceptions; robot and object beat robot alone, that beats object alone, and
            every exception beats ``models``.
        antithetic: draw in pairs: where replication 2k uses the uniform u, replication 2k + 1
            uses 1 - u. Replications of even number are the same as without it.
    """

    models: Mapping[str, DurationModel]
    overrides: tuple[DurationOverride, ...] = ()
    antithetic: bool = False

    def bind(self, tpg: TemporalPlanGraph) -> SkillDraws:
        """Return the draws of one TPG; keep it where the same TPG is asked again and again."""
        return bind_draws(tpg, self.model_of, antithetic=self.antithetic)

    def model_of(
        self, skill: str, robot: str, object_kind: str | None
    ) -> DurationModel | None:
        """Return the model of a skill done by a robot to an object of a kind, None if none."""
        exceptions = {
            (item.robot, item.object_kind): item.model
            for item in self.overrides
            if item.skill == skill
        }
        for key in ((robot, object_kind), (robot, None), (None, object_kind)):
            if key in exceptions:
                return exceptions[key]
        return self.models.get(skill)

    def sample(
        self, tpg: TemporalPlanGraph, *, seed: int, replication: int = 0
    ) -> tuple[Nanoseconds, ...]:
        """Return durations per chain, each of shape (nodes,) [ns]."""
        bulk = self.bind(tpg).durations(seed=seed, replications=[replication])
        return tuple(np.ascontiguousarray(rows[0]) for rows in bulk)

    def sample_bulk(
        self, tpg: TemporalPlanGraph, *, seed: int, replications: npt.ArrayLike
    ) -> tuple[Nanoseconds, ...]:
        """Return what sample returns for several replications, bit by bit.

        Args:
            tpg: the plan.
            seed: names the draws.
            replications: numbers of the replications, such as ``range(1000, 2000)``.

        Returns:
            Per chain, shape (replications, nodes) [ns]; views whose columns are contiguous.
            All nodes are there, so ask for some thousand replications at a time.
        """
        return self.bind(tpg).durations(seed=seed, replications=replications)

    def sample_totals(
        self, tpg: TemporalPlanGraph, *, seed: int, replications: npt.ArrayLike
    ) -> tuple[Indices, Nanoseconds]:
        """Return the durations of the tasks that vary, the skill nodes of a task together.

        This is far less than sample_bulk returns, and says as much: every other node takes its
        nominal time, and a task of several skill nodes shares its total among them by
        ``share_duration(total, nominal durations of its skill nodes)``.

        Args:
            tpg: the plan.
            seed: names the draws.
            replications: numbers of the replications, such as ``range(1000, 2000)``.

        Returns:
            Indices of the tasks, rising, shape (s,), and their durations in every replication,
            shape (replications, s) [ns]; a view whose columns are contiguous.
        """
        draws = self.bind(tpg)
        return draws.tasks, draws.totals(seed=seed, replications=replications)


def nominal_durations(tpg: TemporalPlanGraph) -> tuple[Nanoseconds, ...]:
    """Return the planned duration of every node, per chain [ns]."""
    return tuple(to_nanoseconds(chain.duration) for chain in tpg.chains)


def total_duration_s(durations: Sequence[Nanoseconds]) -> float:
    """Return the sum of all durations [s]: the makespan of one robot at a time."""
    return sum(int(d.sum()) for d in durations) / NANOSECONDS

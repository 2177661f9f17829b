"""One draw at a time: what the twin only ever draws in bulk."""

from __future__ import annotations

import numpy as np

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations.model import Nanoseconds
from twin.uncertainty.disturbances import Disturbances
from twin.uncertainty.draws import uniforms
from twin.uncertainty.node_times import NodeTimes, NodeTimeSampler
from twin.uncertainty.skill_durations import SkillDurations


def uniform(
    seed: int,
    replication: int,
    robot: str,
    task: int,
    kind: str,
    purpose: str,
    index: int = 0,
) -> float:
    """The uniform in (0, 1) of one named draw."""
    return float(
        uniforms(seed, [replication], [robot], task, [kind], purpose, index)[0, 0]
    )


def sample(
    durations: SkillDurations,
    tpg: TemporalPlanGraph,
    *,
    seed: int,
    replication: int = 0,
) -> tuple[Nanoseconds, ...]:
    """Durations of one replication per chain, each of shape (nodes,) [ns]."""
    rows = durations.bind(tpg).durations(seed=seed, replications=[replication])
    return tuple(np.ascontiguousarray(own[:, 0]) for own in rows)


def sample_node_times(
    tpg: TemporalPlanGraph,
    durations: SkillDurations,
    disturbances: Disturbances | None = None,
    *,
    seed: int,
    replication: int = 0,
) -> NodeTimes:
    """What every node of a graph takes in one replication."""
    sampler = NodeTimeSampler(tpg, durations, disturbances or Disturbances())
    return sampler.sample(seed=seed, replication=replication)

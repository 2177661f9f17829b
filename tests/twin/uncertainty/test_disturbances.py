from __future__ import annotations

import numpy as np
import pytest
from pydantic import ValidationError

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.one_draw import sample_node_times
from tests.twin.twin_toys import random_tpg
from twin.uncertainty.disturbances import Disturbances, Stalls
from twin.uncertainty.skill_durations import SkillDurations


def stalls_of(
    stalls: Stalls, tpg: TemporalPlanGraph, seed: int, replication: int = 0
) -> tuple[np.ndarray, ...]:
    return sample_node_times(
        tpg,
        SkillDurations({}),
        Disturbances(stalls=stalls),
        seed=seed,
        replication=replication,
    ).stall


def test_every_robot_stalls_as_often_as_asked_and_within_bounds() -> None:
    tpg = random_tpg(2, tasks=10)
    stalls = stalls_of(Stalls(count_per_robot=3, duration_s=(1.0, 20.0)), tpg, seed=7)
    for chain, stall in zip(tpg.chains, stalls, strict=True):
        assert len(stall) == len(chain)
        hit = stall[stall > 0]
        assert len(hit) == 3
        assert np.all((hit >= 1e9) & (hit <= 20e9))


def test_a_robot_with_few_nodes_stalls_at_all_of_them() -> None:
    tpg = random_tpg(2, tasks=3, nodes_per_transit=1)
    for stall in stalls_of(
        Stalls(count_per_robot=50, duration_s=(1.0, 2.0)), tpg, seed=7
    ):
        assert np.all(stall > 0)


def test_stalls_fall_on_all_nodes_alike() -> None:
    tpg = random_tpg(2, tasks=4)
    length = len(tpg.chains[0])
    counts = np.zeros(length)
    for replication in range(2000):
        stall = stalls_of(
            Stalls(count_per_robot=2), tpg, seed=0, replication=replication
        )[0]
        counts += stall > 0
    expected = 2000 * 2 / length
    assert np.all(np.abs(counts - expected) < 5 * np.sqrt(expected))


def test_same_seed_same_stalls() -> None:
    tpg = random_tpg(2, tasks=10)
    stalls = Stalls(count_per_robot=2)
    first, again = stalls_of(stalls, tpg, seed=1), stalls_of(stalls, tpg, seed=1)
    other = stalls_of(stalls, tpg, seed=2)
    assert all(map(np.array_equal, first, again))
    assert not all(map(np.array_equal, first, other))


@pytest.mark.parametrize(
    ("count", "duration"), [(-1, (1.0, 2.0)), (1, (-1.0, 2.0)), (1, (3.0, 2.0))]
)
def test_impossible_stalls_are_refused(
    count: int, duration: tuple[float, float]
) -> None:
    with pytest.raises(ValidationError, match="Stalls"):
        Stalls(count_per_robot=count, duration_s=duration)

"""When a graph will be complete of which some is executed, against one robot after the other by hand."""

from __future__ import annotations

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.transforms import Array
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.rolling.forecast import Clock, forecast_s
from tests.scheduling.rolling.test_cut import precedence
from tests.shipped_runs import ShippedRuns


def executed(tpg: TemporalPlanGraph, seed: int) -> tuple[list[Array], list[Array]]:
    """Begin and end of every node where each takes a while longer than planned."""
    rng, graph = np.random.default_rng(seed), precedence(tpg)
    begun = [np.zeros(len(chain)) for chain in tpg.chains]
    ended = [np.zeros(len(chain)) for chain in tpg.chains]
    for k, n in nx.topological_sort(graph):
        before = [ended[i][u] for i, u in graph.predecessors((k, n))]
        begun[k][n] = max(before, default=0.0) + rng.choice([0.0, 0.4])
        took = tpg.chains[k].duration[n] * rng.uniform(1.0, 2.0)
        ended[k][n] = begun[k][n] + took
    return begun, ended


@pytest.fixture(scope="module")
def tpg(shipped: ShippedRuns) -> TemporalPlanGraph:
    return shipped("lego/cliff").planned.tpg


@settings(max_examples=15, deadline=None)
@given(
    seed=st.integers(0, 1000),
    share=st.floats(0.0, 1.0),
    planning_s=st.sampled_from([0.0, 3.0, 40.0]),
)
def test_it_is_the_longest_path_from_what_is_known(
    tpg: TemporalPlanGraph, seed: int, share: float, planning_s: float
) -> None:
    begun, ended = executed(tpg, seed)
    now = share * max(own[-1] for own in ended)
    counts = [int((own <= now).sum()) for own in begun]
    done = [int((own <= now).sum()) for own in ended]
    clock = Clock(
        now,
        tuple(own[:n] for own, n in zip(begun, counts, strict=True)),
        tuple(own[:n] for own, n in zip(ended, done, strict=True)),
    )
    graph, ends = precedence(tpg), dict[tuple[int, int], float]()
    for k, n in nx.topological_sort(graph):
        took = tpg.chains[k].duration[n]
        if n < done[k]:
            ends[k, n] = ended[k][n]
        elif n < counts[k]:
            ends[k, n] = max(begun[k][n] + took, now)
        else:
            may = [ends[node] for node in graph.predecessors((k, n))]
            ends[k, n] = max([*may, now + planning_s]) + took
    found = forecast_s(tpg, counts, clock, planning_s)
    assert found == pytest.approx(max(ends.values()))
    for k, chain in enumerate(tpg.chains):
        left = clock.left_s(chain, k, counts[k])
        due = (
            begun[k][counts[k] - 1] + chain.duration[counts[k] - 1]
            if counts[k]
            else 0.0
        )
        assert left == pytest.approx(
            max(due - now, 0.0) if done[k] < counts[k] else 0.0
        )

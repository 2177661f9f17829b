"""Earliest times against longest paths in networkx, in seconds and in nanoseconds."""

from __future__ import annotations

import networkx as nx
import numpy as np
import pytest

from scheduling.build_tpg import build_tpg
from scheduling.graph.dispatcher import earliest_times
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.scheduling.mini_world import random_plan


@pytest.fixture(scope="module")
def tpg() -> TemporalPlanGraph:
    return build_tpg(random_plan(3, 5))


def _plain_ends(
    tpg: TemporalPlanGraph, durations: list[np.ndarray]
) -> dict[tuple[int, int], float]:
    graph = nx.DiGraph()
    for r, chain in enumerate(tpg.chains):
        nx.add_path(graph, [(r, n) for n in range(len(chain))])
    graph.add_edges_from(((r, u), (s, v)) for r, u, s, v in tpg.edges.tolist())
    ends: dict[tuple[int, int], float] = {}
    for node in nx.topological_sort(graph):
        start = max((ends[p] for p in graph.predecessors(node)), default=0)
        ends[node] = start + durations[node[0]][node[1]]
    return ends


def test_ends_are_longest_paths(tpg: TemporalPlanGraph) -> None:
    rng = np.random.default_rng(1)
    durations = [
        rng.integers(0, 10**9, len(chain)).astype(np.int64) for chain in tpg.chains
    ]
    rollout = earliest_times(tpg, durations)
    plain = _plain_ends(tpg, durations)
    for r, end in enumerate(rollout.end):
        assert end.dtype == np.int64
        assert end.tolist() == [plain[(r, n)] for n in range(len(end))]
        assert np.array_equal(end - rollout.start[r], durations[r])
        assert end[-1] >= durations[r].sum()
    assert rollout.makespan == max(plain.values())


def test_seconds_and_nanoseconds_agree(tpg: TemporalPlanGraph) -> None:
    whole = [np.rint(c.duration * 1e9).astype(np.int64) for c in tpg.chains]
    seconds, exact = earliest_times(tpg), earliest_times(tpg, whole)
    assert exact.makespan * 1e-9 == pytest.approx(seconds.makespan, abs=1e-6)
    assert isinstance(exact.makespan, int)


def test_a_graph_beats_its_sequential_plan(tpg: TemporalPlanGraph) -> None:
    busiest = max(float(chain.duration.sum()) for chain in tpg.chains)
    makespan = earliest_times(tpg).makespan
    sequential = sum(float(chain.duration.sum()) for chain in tpg.chains)
    assert busiest <= makespan <= sequential
    assert sequential == pytest.approx(
        max(float(c.planned_start[-1] + c.duration[-1]) for c in tpg.chains)
    )

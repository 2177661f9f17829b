"""Replications side by side against longest paths, against events, and against trying it out."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scheduling.graph.dispatcher import earliest_times
from scheduling.graph.temporal_plan_graph import (
    MOTION_CONFLICT,
    TASK_DEPENDENCY,
    TemporalPlanGraph,
)
from tests.twin.driven_toys import driven_tpg
from tests.twin.twin_toys import random_tpg
from twin.durations.bounded import Uniform
from twin.durations.model import Nanoseconds
from twin.engine.bulk.max_plus import (
    OTHER,
    completions,
    end_times,
    explain,
    makespans,
    precedence_arrays,
)
from twin.engine.engine import Simulator
from twin.engine.execution_model import ExecutionModel, Messages
from twin.uncertainty.contraction import contract
from twin.uncertainty.skill_durations import SkillDurations

REPLICATIONS = 70


def _busy(seed: int, nodes: int, longest: int = 5) -> Nanoseconds:
    """Few different durations, so that ties and zeros are common."""
    rng = np.random.default_rng(seed)
    return rng.integers(0, longest, (nodes, REPLICATIONS)).astype(np.int64)


def _per_chain(tpg: TemporalPlanGraph, column: Nanoseconds) -> list[Nanoseconds]:
    cuts = np.cumsum([len(chain) for chain in tpg.chains])[:-1]
    return np.split(column, cuts)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 4))
def test_every_replication_is_a_longest_path(seed: int, robots: int) -> None:
    tpg = random_tpg(seed, dofs=(2,) * robots, edges=12 if robots > 1 else 0)
    busy = _busy(seed, sum(len(chain) for chain in tpg.chains))
    found = completions(precedence_arrays(tpg), busy)
    for r in range(0, REPLICATIONS, 23):
        oracle = earliest_times(tpg, _per_chain(tpg, busy[:, r]))
        assert np.array_equal(np.concatenate(oracle.end), found.end_ns[:, r])
        assert found.makespan_ns[r] == oracle.makespan
        for chain in range(robots):
            assert found.waited_ns[chain, :, r].sum() == (
                oracle.end[chain][-1] - oracle.duration[chain].sum()
            )


@pytest.mark.parametrize("contracted", [False, True])
def test_events_give_the_same_times(contracted: bool) -> None:
    tpg = random_tpg(5, dofs=(2, 3, 2), tasks=12, edges=15)
    durations = SkillDurations({"pick": Uniform(low_s=0.5, high_s=4.0)})
    simulator = Simulator(tpg, ExecutionModel(durations))
    runs = [simulator.run(seed=3, replication=r) for r in range(20)]
    busy = np.stack([np.concatenate(run.duration_ns) for run in runs], axis=1)
    if contracted:
        short = contract(tpg)
        columns = [_per_chain(tpg, busy[:, r]) for r in range(20)]
        sums = [np.concatenate(short.sums(column)) for column in columns]
        found = completions(precedence_arrays(short.tpg), np.stack(sums, axis=1))
    else:
        found = completions(precedence_arrays(tpg), busy)
        ends = np.stack([np.concatenate(run.end_ns) for run in runs], axis=1)
        assert np.array_equal(found.end_ns, ends)
    assert found.makespan_ns.tolist() == [run.makespan_ns for run in runs]
    waits = [[run.wait_ns(k) for run in runs] for k in range(3)]
    assert found.waited_ns.sum(axis=1).tolist() == waits


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6))
def test_slack_is_what_a_node_can_take_and_no_more(seed: int) -> None:
    tpg = random_tpg(seed, dofs=(2, 2, 2), edges=12)
    graph = precedence_arrays(tpg)
    busy = _busy(seed, sum(len(chain) for chain in tpg.chains))[:, :1]
    found = completions(graph, busy)
    for node in range(0, len(busy), 3):
        for extra, later in ((0, 0), (1, 1)):
            longer = busy.copy()
            longer[node] += found.slack_ns[node] + extra
            grown = makespans(graph, end_times(graph, longer)) - found.makespan_ns
            assert grown.tolist() == [later]


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6))
def test_a_critical_path_adds_up_to_the_makespan(seed: int) -> None:
    tpg = random_tpg(seed, dofs=(2, 3, 2), edges=14)
    busy = _busy(seed, sum(len(chain) for chain in tpg.chains))
    found = completions(precedence_arrays(tpg), busy)
    total = np.where(found.critical, busy, 0).sum(axis=0)
    assert np.array_equal(total, found.makespan_ns)
    assert not np.any(found.slack_ns[found.critical])
    assert found.slack_ns.min() >= 0


@pytest.mark.parametrize("driven", [False, True])
def test_slack_of_what_was_executed_counts_neither_messages_nor_braking(
    driven: bool,
) -> None:
    tpg = (driven_tpg if driven else random_tpg)(6, dofs=(2, 3, 2), tasks=12, edges=14)
    durations = SkillDurations({"pick": Uniform(low_s=0.5, high_s=4.0)})
    late = Messages.of_seconds(3, 0.3, 0.1)
    simulator = Simulator(tpg, ExecutionModel(durations, messages=late))
    runs = [simulator.run(seed=3, replication=r) for r in range(5)]
    start, end = (
        np.stack([np.concatenate(getattr(run, name)) for run in runs], axis=1)
        for name in ("start_ns", "end_ns")
    )
    found = explain(precedence_arrays(tpg), start, end)
    assert found.waited_ns[:, OTHER].sum() > 0
    assert not np.any(found.slack_ns[found.critical])
    assert found.slack_ns.min() == 0 < found.slack_ns.max()


def test_a_wait_has_the_cause_of_the_edge_that_ended_it() -> None:
    tpg = random_tpg(2, dofs=(2, 2), tasks=8, edges=14)
    busy = _busy(2, sum(len(chain) for chain in tpg.chains), longest=10**6)
    for cause in (TASK_DEPENDENCY, MOTION_CONFLICT):
        one = replace(tpg, cause=np.full(len(tpg.edges), cause, dtype=np.uint8))
        found = completions(precedence_arrays(one), busy)
        assert found.waited_ns[:, cause].sum() > 0
        assert found.waited_ns[:, 1 - cause].sum() == 0
        assert found.waited_ns[:, OTHER].sum() == 0


def test_the_clock_holds_nodes_back() -> None:
    tpg = random_tpg(4, dofs=(2, 2), edges=0)
    nodes = sum(len(chain) for chain in tpg.chains)
    busy = _busy(4, nodes)
    late = np.arange(nodes, dtype=np.int64) * 7
    found = completions(precedence_arrays(tpg, late), busy)
    assert np.all(found.start_ns >= late[:, None])
    for r in (0, REPLICATIONS - 1):
        clock = 0
        for n in range(len(tpg.chains[0])):
            clock = max(clock, late[n]) + busy[n, r]
            assert found.end_ns[n, r] == clock
    assert found.waited_ns[:, :OTHER].sum() == 0
    still = found.chain_end_ns.sum() - busy.sum()
    assert found.waited_ns[:, OTHER].sum() == still > 0


def test_edges_can_be_traced_to_the_graph() -> None:
    tpg = random_tpg(7, dofs=(2, 2, 2), edges=14)
    graph = precedence_arrays(tpg)
    order = np.lexsort((tpg.edges[:, 3], tpg.edges[:, 2]))
    rows = tpg.edges[order]
    sources = graph.first[rows[:, 0]] + rows[:, 1]
    assert np.array_equal(graph.source, sources)
    assert np.array_equal(graph.cause, tpg.cause[order])

"""The dispatcher releases what the edges allow, and nothing else; earliest times are longest paths."""

import random

import networkx as nx
import numpy as np
import pytest

from planning.errors import PlanInvariantError
from scheduling.build_tpg import build_tpg
from scheduling.graph.dispatcher import Dispatcher
from scheduling.graph.rollout import earliest_times
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.scheduling.mini_world import random_plan


@pytest.fixture(scope="module", params=[(2, 4), (3, 5), (5, 2)])
def tpg(request: pytest.FixtureRequest) -> TemporalPlanGraph:
    return build_tpg(random_plan(*request.param))


def test_any_order_of_completions_ends(tpg: TemporalPlanGraph) -> None:
    edges = tpg.edges.tolist()
    assert edges
    for seed in range(5):
        rng = random.Random(seed)
        dispatcher = Dispatcher(tpg)
        released = list(dispatcher.ready())
        done: set[tuple[int, int]] = set()
        while not dispatcher.finished:
            assert sorted(released) == dispatcher.ready()
            node = released.pop(rng.randrange(len(released)))
            for r, u, s, v in edges:
                assert (s, v) != node or (r, u) in done
            done.add(node)
            released += dispatcher.complete(*node)
        assert released == []
        assert len(done) == sum(len(chain) for chain in tpg.chains)


def test_what_a_node_waits_for_is_named(tpg: TemporalPlanGraph) -> None:
    r, u, s, v = tpg.edges.tolist()[0]
    dispatcher = Dispatcher(tpg)
    assert (r, u) in dispatcher.waits_for(s, v)
    assert not dispatcher.is_safe(s, v)
    while not dispatcher.is_safe(s, v):
        # Everyone else first, so that the node stands ready but waits.
        node = next(n for n in dispatcher.ready() if n != (s, v))
        dispatcher.complete(*node)
    assert dispatcher.waits_for(s, v) == []


def test_breaches_of_the_protocol_are_refused(tpg: TemporalPlanGraph) -> None:
    dispatcher = Dispatcher(tpg)
    robot, node = dispatcher.ready()[0]
    with pytest.raises(PlanInvariantError, match=f"node {node + 1} comes after"):
        dispatcher.complete(robot, node + 1)
    dispatcher.complete(robot, node)
    with pytest.raises(PlanInvariantError, match="complete already"):
        dispatcher.complete(robot, node)
    with pytest.raises(PlanInvariantError, match="no node"):
        dispatcher.complete(robot, 10**6)
    with pytest.raises(PlanInvariantError, match="no node"):
        dispatcher.complete(99, 0)


def test_a_node_that_was_not_released_cannot_be_complete(
    tpg: TemporalPlanGraph,
) -> None:
    r, u, s, v = tpg.edges.tolist()[0]
    dispatcher = Dispatcher(tpg)
    while dispatcher.completed(s) < v:
        dispatcher.complete(*next(n for n in dispatcher.ready() if n != (r, u)))
    with pytest.raises(PlanInvariantError, match="was completed before node"):
        dispatcher.complete(s, v)


def test_copies_go_on_independently(tpg: TemporalPlanGraph) -> None:
    first = Dispatcher(tpg)
    first.complete(*first.ready()[0])
    second = first.copy()
    before = first.ready()
    while not second.finished:
        second.complete(*second.ready()[-1])
    assert first.ready() == before
    assert not first.finished


def test_what_was_observed_counts_even_when_it_was_not_allowed(
    tpg: TemporalPlanGraph,
) -> None:
    """Nodes are observed in any order; afterwards the state is that of proper completions."""
    rng = random.Random(3)
    nodes = [(k, n) for k, chain in enumerate(tpg.chains) for n in range(len(chain))]
    rng.shuffle(nodes)
    observer = Dispatcher(tpg)
    done = [0] * len(tpg.chains)
    for k, n in nodes[: len(nodes) // 3]:
        observer.observe(k, n)
        done[k] = max(done[k], n + 1)
    for k, chain in enumerate(tpg.chains):
        assert observer.completed(k) == done[k]
        for n in range(done[k], len(chain)):
            waits = [
                (a, m)
                for a, m, b, v in tpg.edges.tolist()
                if (b, v) == (k, n) and m >= done[a]
            ]
            assert observer.waits_for(k, n) == waits
        if done[k] < len(chain):
            free = not observer.waits_for(k, done[k])
            assert observer.is_safe(k, done[k]) == free
    for k, chain in enumerate(tpg.chains):
        if len(chain):
            observer.observe(k, len(chain) - 1)
    assert observer.finished


def _plain_ends(
    tpg: TemporalPlanGraph, durations: list[np.ndarray]
) -> dict[tuple[int, int], float]:
    graph: nx.DiGraph[tuple[int, int]] = nx.DiGraph()
    for r, chain in enumerate(tpg.chains):
        nx.add_path(graph, [(r, n) for n in range(len(chain))])
    graph.add_edges_from(((r, u), (s, v)) for r, u, s, v in tpg.edges.tolist())
    ends: dict[tuple[int, int], float] = {}
    for node in nx.topological_sort(graph):
        start = max((ends[p] for p in graph.predecessors(node)), default=0)
        ends[node] = start + durations[node[0]][node[1]]
    return ends


@pytest.mark.parametrize("unit", [1, 2**24 + 1], ids=["exact in floats", "too large"])
def test_ends_are_longest_paths(tpg: TemporalPlanGraph, unit: int) -> None:
    rng = np.random.default_rng(1)
    durations = [
        rng.integers(0, 10**9, len(chain)).astype(np.int64) * unit
        for chain in tpg.chains
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

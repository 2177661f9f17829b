"""Cuts are closed under what they wait for, and the world at a cut is what has been executed.

When what is left will be complete, against one robot after the other by hand.
"""

from __future__ import annotations

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.transforms import Array
from scheduling.graph.dispatcher import Dispatcher
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.rolling.cut import complete_tasks, cut_after, world_state_after
from scheduling.rolling.extension import committed_subgraph
from scheduling.rolling.forecast import Clock, forecast_s
from tests.shipped_runs import ShippedRuns


@pytest.fixture(scope="module", params=["lego/cliff", "assembly/shapes"])
def tpg(request: pytest.FixtureRequest, shipped: ShippedRuns) -> TemporalPlanGraph:
    return shipped(request.param).planned.tpg


def some_prefix(tpg: TemporalPlanGraph, seed: int, share: float) -> list[int]:
    """Complete nodes in any order that the dispatcher allows, for a share of all."""
    rng, dispatcher = np.random.default_rng(seed), Dispatcher(tpg)
    ready = dispatcher.ready()
    for _ in range(int(share * sum(map(len, tpg.chains)))):
        ready += dispatcher.complete(*ready.pop(int(rng.integers(len(ready)))))
    return [dispatcher.completed(k) for k in range(len(tpg.chains))]


def precedence(tpg: TemporalPlanGraph) -> nx.DiGraph[tuple[int, int]]:
    graph: nx.DiGraph[tuple[int, int]] = nx.DiGraph()
    for k, chain in enumerate(tpg.chains):
        nx.add_path(graph, [(k, n) for n in range(len(chain))])
    graph.add_edges_from(((k, u), (i, v)) for k, u, i, v in tpg.edges.tolist())
    return graph


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 1000), share=st.floats(0.0, 1.0), fails=st.booleans())
def test_a_cut_is_closed_and_leaves_out_what_waits_for_what_never_happens(
    tpg: TemporalPlanGraph, seed: int, share: float, fails: bool
) -> None:
    released = some_prefix(tpg, seed, share)
    chain = seed % len(tpg.chains)
    never = []
    if fails and released[chain] < len(tpg.chains[chain]):
        never = [(chain, released[chain])]
    counts = cut_after(tpg, released, never)
    graph = precedence(tpg)
    inside = {(k, n) for k, count in enumerate(counts) for n in range(count)}
    assert all(a >= b for a, b in zip(counts, released, strict=True))
    for node in inside:
        assert set(graph.predecessors(node)) <= inside
    for node in never:
        later = nx.descendants(graph, node)
        assert not inside & ({node} | later)
    # The world is what a plain replay in the planned order comes to.
    committed = committed_subgraph(tpg, counts)
    state = world_state_after(tpg, counts)
    holders: dict[str, str | None]
    holders = {o.name: None for o in tpg.cell.objects if not o.later}
    starts = [c.planned_start for c in tpg.chains]
    done = [h for h in tpg.handlings if h.node < counts[h.robot]]
    for h in sorted(done, key=lambda h: (starts[h.robot][h.node], h.waypoint)):
        holders[h.object] = h.holder
    found = {name: at.holder for name, at in state.attachments.items()}
    assert {k: v for k, v in holders.items() if v != "(gone)"} == found
    assert [len(c) for c in committed.chains] == [n for n in counts if n]
    for k, chain_ in enumerate(tpg.chains):
        last = counts[k] - 1
        q = chain_.start if last < 0 else chain_.waypoints[chain_.first[last + 1] - 1]
        assert np.array_equal(state.configurations[chain_.robot], q)
    complete = complete_tasks(tpg, counts)
    for k, chain_ in enumerate(tpg.chains):
        whole = set(chain_.task.tolist()) - set(chain_.task[counts[k] :].tolist())
        assert whole <= complete
        assert not complete & set(chain_.task[counts[k] :].tolist())


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
def cliff(shipped: ShippedRuns) -> TemporalPlanGraph:
    return shipped("lego/cliff").planned.tpg


@settings(max_examples=15, deadline=None)
@given(
    seed=st.integers(0, 1000),
    share=st.floats(0.0, 1.0),
    planning_s=st.sampled_from([0.0, 3.0, 40.0]),
)
def test_it_is_the_longest_path_from_what_is_known(
    cliff: TemporalPlanGraph, seed: int, share: float, planning_s: float
) -> None:
    begun, ended = executed(cliff, seed)
    now = share * max(own[-1] for own in ended)
    counts = [int((own <= now).sum()) for own in begun]
    done = [int((own <= now).sum()) for own in ended]
    clock = Clock(
        now,
        tuple(own[:n] for own, n in zip(begun, counts, strict=True)),
        tuple(own[:n] for own, n in zip(ended, done, strict=True)),
    )
    graph, ends = precedence(cliff), dict[tuple[int, int], float]()
    for k, n in nx.topological_sort(graph):
        took = cliff.chains[k].duration[n]
        if n < done[k]:
            ends[k, n] = ended[k][n]
        elif n < counts[k]:
            ends[k, n] = max(begun[k][n] + took, now)
        else:
            may = [ends[node] for node in graph.predecessors((k, n))]
            ends[k, n] = max([*may, now + planning_s]) + took
    found = forecast_s(cliff, counts, clock, planning_s)
    assert found == pytest.approx(max(ends.values()))
    for k, chain in enumerate(cliff.chains):
        left = clock.left_s(chain, k, counts[k])
        due = (
            begun[k][counts[k] - 1] + chain.duration[counts[k] - 1]
            if counts[k]
            else 0.0
        )
        assert left == pytest.approx(
            max(due - now, 0.0) if done[k] < counts[k] else 0.0
        )

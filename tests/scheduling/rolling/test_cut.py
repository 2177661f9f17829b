"""Cuts are closed under what they wait for, and the world at a cut is what has been executed."""

from __future__ import annotations

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scheduling.graph.dispatcher import Dispatcher
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.rolling.cut import complete_tasks, cut_after, state_at
from scheduling.rolling.extension import committed_part
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


def precedence(tpg: TemporalPlanGraph) -> nx.DiGraph:
    graph = nx.DiGraph()
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
        assert not inside & ({node} | nx.descendants(graph, node))
    # The world is what a plain replay in the planned order comes to.
    committed = committed_part(tpg, counts)
    state = state_at(tpg, counts)
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

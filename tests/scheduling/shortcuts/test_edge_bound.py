"""Edges that a bound excludes make the whole graph end too late, and nothing is lost with them."""

import numpy as np
import pytest

from planning.motion.speed import L1Speed
from scheduling.build_tpg import build_tpg
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.shortcuts.candidates import LINE, candidate_path, find_spans, new_nodes
from scheduling.shortcuts.edge_bound import EdgeBound
from scheduling.shortcuts.rewiring import Edge, Swap, rewire
from scheduling.shortcuts.shortcutting import shorten_tpg
from tests.scheduling.mini_world import random_plan


def test_an_edge_is_excluded_where_the_graph_with_it_ends_too_late() -> None:
    graph, found = DerivedTpg(build_tpg(random_plan(3, 3, rounds=6, step=0.5))), set()
    rng, speed = np.random.default_rng(2), L1Speed()
    ranks = graph.ranks
    for span in find_spans(graph):
        swap, chain = Swap(*vars(span).values()), graph.tpg.chains[span.chain]
        old = chain.waypoints[chain.first[span.first] - 1 : chain.first[span.last + 1]]
        path = candidate_path(old, LINE, rng)
        new = new_nodes(chain, span.first, span.last, path, speed, 0.5)
        if new is None:
            continue
        for _ in range(30):
            other = int(rng.choice([k for k in range(3) if k != span.chain]))
            u = int(rng.integers(len(ranks[other])))
            v = int(rng.integers(span.first, span.last + 1))
            edge: Edge = other, u, span.chain, v
            if ranks[other][u] > ranks[span.chain][v]:
                edge = span.chain, v, other, u
            makespan = rewire(graph, swap, new, [edge]).rollout.makespan
            for latest in (0.9 * makespan, makespan - 1e-3, makespan + 1e-3):
                bound = EdgeBound.of(graph, swap, new.duration, latest)
                least = rewire(graph, swap, new, ()).rollout.makespan
                excluded = bound.excludes(edge)
                # One edge alone delays the end along the longest path through it only.
                assert excluded == (max(least, makespan) > latest) or least > latest
                found.add(excluded)
    assert found == {True, False}


@pytest.mark.parametrize("sidesteps", [0, 60])
def test_without_a_bound_the_same_plan_is_found(
    sidesteps: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = random_plan(4, 1, rounds=9, step=0.5)
    speeds, asked = {robot.name: L1Speed() for robot in plan.cell.robots}, list[bool]()
    excludes = EdgeBound.excludes

    def shortened(*, bounded: bool) -> TemporalPlanGraph:
        def watched(bound: EdgeBound, edge: Edge) -> bool:
            asked.append(excludes(bound, edge))
            return asked[-1] and bounded

        monkeypatch.setattr(EdgeBound, "excludes", watched)
        tpg = build_tpg(plan)
        return shorten_tpg(tpg, speeds, step=0.5, candidates=150, sidesteps=sidesteps)

    one, other = shortened(bounded=True), shortened(bounded=False)
    assert any(asked)
    assert np.array_equal(one.edges, other.edges)
    assert np.array_equal(one.cause, other.cause)
    for a, b in zip(one.chains, other.chains, strict=True):
        assert np.array_equal(a.waypoints, b.waypoints)
        assert np.array_equal(a.duration, b.duration)

"""Vector clocks and the one-pass reduction against networkx on random chains."""

import networkx as nx
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.errors import PlanInvariantError
from scheduling.graph.total_order import transitive_reduction

Ranks = list[npt.NDArray[np.int64]]


@st.composite
def graphs(draw: st.DrawFn) -> tuple[Ranks, list[tuple[int, int, int, int]]]:
    """Chains woven into one random order, and random edges along it."""
    robots = draw(st.integers(2, 5))
    order = draw(st.lists(st.integers(0, robots - 1), min_size=2, max_size=40))
    ranks = [
        np.array([k for k, r in enumerate(order) if r == robot], dtype=np.int64)
        for robot in range(robots)
    ]
    place = [(r, order[:k].count(r)) for k, r in enumerate(order)]
    pairs = st.tuples(
        st.integers(0, len(order) - 1), st.integers(0, len(order) - 1)
    ).map(sorted)
    edges = [
        (*place[a], *place[b])
        for a, b in draw(st.lists(pairs, max_size=60))
        if place[a][0] != place[b][0]
    ]
    return ranks, edges


def _graph(
    ranks: Ranks, edges: list[tuple[int, int, int, int]]
) -> "nx.DiGraph[tuple[int, int]]":
    graph: nx.DiGraph[tuple[int, int]] = nx.DiGraph()
    for r, chain in enumerate(ranks):
        graph.add_nodes_from((r, n) for n in range(len(chain)))
        nx.add_path(graph, [(r, n) for n in range(len(chain))])
    graph.add_edges_from(((r, u), (s, v)) for r, u, s, v in edges)
    return graph


@settings(max_examples=300, deadline=None)
@given(graphs())
def test_reduction_and_order_are_exact(
    case: tuple[Ranks, list[tuple[int, int, int, int]]],
) -> None:
    ranks, edges = case
    graph = _graph(ranks, edges)
    order, keep = transitive_reduction(
        ranks, np.array(edges, dtype=np.int64).reshape(-1, 4)
    )
    kept = [edge for edge, k in zip(edges, keep, strict=True) if k]
    reduced = {
        (*u, *v) for u, v in nx.transitive_reduction(graph).edges if u[0] != v[0]
    }
    assert set(kept) == reduced
    assert len(kept) == len(reduced)
    for node in graph:
        ancestors = nx.ancestors(graph, node)
        for other in graph:
            assert order.precedes(*other, *node) == (other in ancestors)
    for i, chain in enumerate(ranks):
        for k, others in enumerate(ranks):
            if i == k:
                continue
            first = order.first_after(i, k)
            for v in range(len(chain)):
                after = [w for w in range(len(others)) if order.precedes(i, v, k, w)]
                assert first[v] == min(after, default=len(others))


def test_of_equal_edges_the_first_one_stays() -> None:
    ranks = [np.array([0, 2]), np.array([1, 3])]
    edges = np.array([[0, 0, 1, 0], [0, 0, 1, 0], [0, 0, 1, 1]])
    assert transitive_reduction(ranks, edges)[1].tolist() == [True, False, False]


def test_an_edge_against_the_order_is_refused() -> None:
    ranks = [np.array([0, 2]), np.array([1, 3])]
    with pytest.raises(
        PlanInvariantError, match="node 1 of robot 1 to node 1 of robot 0"
    ):
        transitive_reduction(ranks, np.array([[0, 0, 1, 0], [1, 1, 0, 1]]))


def test_no_robots_and_no_edges() -> None:
    order, keep = transitive_reduction([], np.empty((0, 4), dtype=np.int64))
    assert len(keep) == 0
    assert order.clock.shape == (0, 0)

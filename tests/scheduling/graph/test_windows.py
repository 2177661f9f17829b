"""Windows of time: what is held back ends in time where it can, waits for nothing else, and every run ends."""

from __future__ import annotations

from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.tasks.task import TimeWindow
from scheduling.graph.dispatcher import Dispatcher
from scheduling.graph.temporal_plan_graph import EVER, TemporalPlanGraph
from scheduling.graph.windows import (
    Times,
    least_gaps,
    plan_cost,
    window_gaps,
    window_nodes,
    with_window_hold_edges,
)
from tests.twin.twin_toys import random_tpg


def windowed_tpg(
    seed: int, *, windows: int = 2, robots: int = 3, tasks: int = 12, edges: int = 14
) -> TemporalPlanGraph:
    """Return a random graph with random windows, each from a skill to a later one that waits for it."""
    rng = np.random.default_rng(seed)
    dofs = tuple(rng.integers(1, 3, robots).tolist())
    tpg = random_tpg(seed, dofs=dofs, tasks=tasks, edges=edges)
    skills = [t.index for t in tpg.tasks if t.index % 2 == 1]
    first: dict[int, tuple[int, int]] = {}
    last: dict[int, tuple[int, int]] = {}
    for k, chain in enumerate(tpg.chains):
        for node, task in enumerate(chain.task.tolist()):
            first.setdefault(task, (k, node))
            last[task] = (k, node)
    found, rows = [], tpg.edges.tolist()
    for _ in range(windows):
        a, b = sorted(rng.choice(skills, 2, replace=False).tolist())
        most = float(rng.uniform(0.0, 4.0))
        found.append(TimeWindow(a, a, b, 0.0, most, f"{b} after {a}"))
        if last[a][0] != first[b][0]:
            rows.append([*last[a], *first[b]])
    edges_now = np.unique(np.array(rows, dtype=np.int64).reshape(-1, 4), axis=0)
    cause = np.ones(len(edges_now), dtype=np.uint8)
    return replace(tpg, edges=edges_now, cause=cause, windows=tuple(found))


def nominal(tpg: TemporalPlanGraph) -> Times:
    seconds = np.concatenate([chain.duration for chain in tpg.chains])
    return np.rint(seconds * 1e9).astype(np.int64)[:, None]


def plain_times(tpg: TemporalPlanGraph, busy: Times) -> tuple[Times, Times]:
    """Return start and end of every node, by a walk through a graph of networkx."""
    graph = plain_graph(tpg)
    start: Times = np.zeros(len(busy), dtype=np.int64)
    for node in nx.topological_sort(graph):
        for source in graph.predecessors(node):
            met = start[source] + min(
                int(busy[source, 0]), graph.edges[source, node]["patience"]
            )
            start[node] = max(start[node], met)
    return start, start + busy[:, 0]


def plain_graph(tpg: TemporalPlanGraph) -> nx.DiGraph[int]:
    graph: nx.DiGraph[int] = nx.DiGraph()
    first = np.cumsum([0, *(len(chain) for chain in tpg.chains)]).tolist()
    for low, high in zip(first, first[1:], strict=False):
        graph.add_nodes_from(range(low, high))
        for node in range(low + 1, high):
            graph.add_edge(node - 1, node, patience=EVER)
    waits = tpg.patience.tolist() or [EVER] * len(tpg.edges)
    for (a, u, b, v), patience in zip(tpg.edges.tolist(), waits, strict=True):
        pair = first[a] + u, first[b] + v
        before = graph.edges[pair]["patience"] if graph.has_edge(*pair) else 0
        graph.add_edge(*pair, patience=max(before, patience))
    return graph


def longest(graph: nx.DiGraph[int], busy: Times, begin: int, end: int) -> int:
    """Return the longest way from the start of a node to the start of another."""
    later, earlier = nx.descendants(graph, begin), nx.ancestors(graph, end)
    inside = later & earlier | {begin, end}
    far = {begin: 0}
    for node in nx.topological_sort(graph.subgraph(inside)):
        for source in graph.predecessors(node):
            if source in far and source in inside:
                far[node] = max(far.get(node, 0), far[source] + int(busy[source, 0]))
    return far[end]


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 10**6), st.integers(2, 4))
def test_one_window_is_kept_where_its_own_way_is_short_enough(
    seed: int, robots: int
) -> None:
    tpg = windowed_tpg(seed, windows=1, robots=robots)
    busy = nominal(tpg)
    begun, done, due = window_nodes(tpg)[0].tolist()
    held = with_window_hold_edges(tpg, busy, 0.9, 1)
    start, end = plain_times(held, busy)
    way = longest(plain_graph(tpg), busy, begun, due)
    own = int(busy[begun : done + 1].sum())
    assert tpg.windows[0].most is not None
    most = max(tpg.windows[0].most * 1e9, way - own)
    assert start[due] - end[done] <= most + 1
    # It ends no sooner than without, and where nothing is late nothing waits.
    free_start, free_end = plain_times(tpg, busy)
    assert end.max() >= free_end.max()
    if free_start[due] - free_end[done] <= tpg.windows[0].most * 1e9:
        assert start[begun] >= free_start[begun]


@given(st.integers(0, 10**6), st.floats(0.0, 9.0))
def test_a_window_that_was_open_before_is_due_and_nobody_is_held_back_for_it(
    seed: int, ago: float
) -> None:
    tpg = windowed_tpg(seed, windows=1)
    open_before = replace(
        tpg.windows[0], begun=TimeWindow.EARLIER, done=TimeWindow.EARLIER, ago=ago
    )
    tpg, busy = replace(tpg, windows=(open_before,)), nominal(tpg)
    start, end = plain_times(tpg, busy)
    due = int(window_nodes(tpg)[0, 2])
    passed = int(start[due]) + ago * 1e9
    assert window_gaps(tpg, start, end)[0] == pytest.approx(passed, abs=1)
    assert window_gaps(tpg, start / 1e9, end / 1e9)[0] == pytest.approx(passed / 1e9)
    assert least_gaps(tpg, busy)[0, 0] == pytest.approx(passed, abs=1)
    assert open_before.most is not None
    late = max(passed / 1e9 - open_before.most, 0.0)
    assert plan_cost(tpg)[0] == pytest.approx(late, abs=1e-6)
    assert len(with_window_hold_edges(tpg, busy, 0.9, 1).edges) == len(tpg.edges)


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 4))
def test_edges_of_time_make_no_circle_and_every_order_of_reports_ends(
    seed: int, windows: int
) -> None:
    tpg = windowed_tpg(seed, windows=windows)
    rng = np.random.default_rng(seed)
    busy = nominal(tpg) * rng.integers(1, 20, (1, 30))
    held = with_window_hold_edges(tpg, busy, float(rng.uniform(0.1, 0.999)), 1)
    assert nx.is_directed_acyclic_graph(plain_graph(held))
    assert np.array_equal(held.edges[: len(tpg.edges)], tpg.edges)
    assert np.all(held.patience[: len(tpg.edges)] == EVER)
    assert np.all(held.patience[len(tpg.edges) :] > 0)
    dispatcher = Dispatcher(held)
    timers = held.edges[held.patience < EVER].tolist()
    while not dispatcher.finished:
        ready = dispatcher.ready()
        assert ready
        if timers and rng.random() < 0.3:
            a, u, b, v = timers.pop(int(rng.integers(len(timers))))
            dispatcher.lift((a, u), (b, v))
            dispatcher.lift((a, u), (b, v))
            continue
        dispatcher.complete(*ready[int(rng.integers(len(ready)))])


def test_the_least_time_is_the_longest_way_between() -> None:
    for seed in range(40):
        tpg = windowed_tpg(seed)
        busy = nominal(tpg)
        graph = plain_graph(tpg)
        for (_, done, due), gap in zip(
            window_nodes(tpg).tolist(), least_gaps(tpg, busy)[:, 0], strict=True
        ):
            assert gap == longest(graph, busy, done, due) - busy[done, 0]
        start, end = plain_times(tpg, busy)
        gaps: Times = np.asarray(window_gaps(tpg, start, end))
        assert np.all(gaps >= least_gaps(tpg, busy)[:, 0])

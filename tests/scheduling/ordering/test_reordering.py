"""A better order of tasks: against every order there is, the rebuilt graph and the slow proof."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.errors import PlanInvariantError
from planning.tasks.time_window import EARLIER, TimeWindow
from scheduling.build_tpg import build_tpg, connect_nodes
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.dispatcher import earliest_times
from scheduling.graph.temporal_plan_graph import NodeChain, TemporalPlanGraph
from scheduling.graph.windows import worth
from scheduling.ordering.beam_search import (
    TaskOrderSearch,
    find_blocks,
    put_in_order,
    reorder_tasks,
)
from scheduling.ordering.relations import TaskRelations, connect_in_order
from scheduling.verification.verify import verify_plan
from tests.scheduling.algorithm_one import check_conflicts_are_ordered
from tests.scheduling.mini_world import random_plan
from tests.scheduling.two_arms import random_turns
from tests.shipped_runs import ShippedRuns
from twin.trial.simulation import audit_standing_states


def _parts(
    tpg: TemporalPlanGraph,
) -> tuple[TaskRelations, list[tuple[int, ...]], TaskOrderSearch]:
    relations = TaskRelations(DerivedTpg(tpg))
    blocks = find_blocks(tpg.chains, relations)
    return relations, blocks, TaskOrderSearch(relations, blocks)


def _connected(
    tpg: TemporalPlanGraph, chains: tuple[NodeChain, ...]
) -> TemporalPlanGraph:
    return connect_nodes(DerivedTpg(replace(tpg, chains=chains)))


def _interleavings(own: Sequence[Sequence[int]]) -> Iterator[list[int]]:
    """Yield every way to mix sequences without changing the order within one."""
    if not any(own):
        yield []
    for k, sequence in enumerate(own):
        if sequence:
            rest = [s[1:] if i == k else s for i, s in enumerate(own)]
            for tail in _interleavings(rest):
                yield [sequence[0], *tail]


def _makespan(
    tpg: TemporalPlanGraph, relations: TaskRelations, order: Sequence[tuple[int, ...]]
) -> float | None:
    """Return the makespan of the graph built for an order, None where that is not safe."""
    done: set[int] = set()
    for block in order:
        if any(not relations.before[unit] <= done for unit in block):
            return None
        done.update(block)
    chains = put_in_order(tpg.chains, relations, order)
    try:
        return float(earliest_times(_connected(tpg, chains)).makespan)
    except PlanInvariantError:
        return None


@pytest.mark.parametrize(
    ("robots", "seed"),
    [(3, 13), *(pytest.param(2, s, marks=pytest.mark.nightly) for s in (17, 43))],
)
def test_no_safe_order_is_better(robots: int, seed: int) -> None:
    tpg = build_tpg(random_plan(robots, seed, rounds=4, step=0.5))
    relations, blocks, search = _parts(tpg)
    found = [blocks[b] for b in search.best_way(width=50).order()]
    every = [
        _makespan(tpg, relations, [(unit,) for unit in order])
        for order in _interleavings(relations.of_chain)
    ]
    safe = [makespan for makespan in every if makespan is not None]
    assert _makespan(tpg, relations, found) == pytest.approx(min(safe))
    assert min(safe) < 0.97 * earliest_times(tpg).makespan


@pytest.mark.parametrize(("seed", "ago"), [(10, None), (43, None), (43, 0.1)])
def test_windows_of_time_come_before_the_makespan(seed: int, ago: float | None) -> None:
    """Those that were open before the plan begins, so long ago, as well."""
    plain = build_tpg(random_plan(2, seed, rounds=3, step=0.5))
    units = TaskRelations(DerivedTpg(plain)).units
    better = 0
    pairs = [
        (a.task, b.task)
        for a, b in combinations(sorted(units, key=lambda u: u.task), 2)
        if a.chain != b.chain
    ]
    for done, due in pairs[1::2]:
        needs = np.array([[done, due]], dtype=np.int64)
        free = _connected(replace(plain, dependencies=needs), plain.chains)
        window = TimeWindow(done, done, due, 0.0, 0.2, "")
        if ago is not None:
            window = replace(window, begun=EARLIER, done=EARLIER, ago=ago)
        tpg = replace(free, windows=(window,))
        relations, blocks, search = _parts(tpg)
        order = [blocks[b] for b in search.best_way(width=50).order()]
        found = _connected(tpg, put_in_order(tpg.chains, relations, order))
        every = []
        for mixed in _interleavings(relations.of_chain):
            single = [(unit,) for unit in mixed]
            if _makespan(tpg, relations, single) is not None:
                chains = put_in_order(tpg.chains, relations, single)
                every.append(worth(_connected(tpg, chains)))
        assert worth(found)[0] <= min(every)[0] + 1e-6
        again = reorder_tasks(free)
        better += worth(found)[0] < worth(replace(again, windows=tpg.windows))[0] - 1e-6
        assert worth(reorder_tasks(tpg)) <= worth(tpg)
    assert better


@pytest.mark.parametrize("seed", range(6))
def test_the_search_knows_when_everyone_will_be_done(seed: int) -> None:
    tpg = build_tpg(random_plan(2 + seed % 3, seed, rounds=8, step=0.5))
    relations, blocks, search = _parts(tpg)
    best = search.best_way(width=10)
    chains = put_in_order(tpg.chains, relations, [blocks[b] for b in best.order()])
    rollout = earliest_times(_connected(tpg, chains))
    assert best.clocks == pytest.approx([end[-1] for end in rollout.end])


def test_orders_get_better_at_all() -> None:
    plans = [random_turns(seed, 6, gap=0.62) for seed in range(4)]
    before = [earliest_times(build_tpg(plan)).makespan for plan in plans]
    after = [earliest_times(reorder_tasks(build_tpg(plan))).makespan for plan in plans]
    assert all(b <= a for a, b in zip(before, after, strict=True))
    assert sum(after) < 0.98 * sum(before)


@given(st.integers(2, 5), st.integers(0, 10_000))
@settings(max_examples=10, deadline=None)
def test_conflicting_nodes_stay_ordered_and_paths_stay_as_they_are(
    robots: int, seed: int
) -> None:
    before = build_tpg(random_plan(robots, seed, rounds=7, step=0.5))
    tpg = reorder_tasks(before)
    assert earliest_times(tpg).makespan <= earliest_times(before).makespan
    for old, new in zip(before.chains, tpg.chains, strict=True):
        assert np.array_equal(old.waypoints, new.waypoints)
        assert np.array_equal(old.duration, new.duration)
    check_conflicts_are_ordered(tpg)


@pytest.mark.parametrize("seed", [3])
def test_a_plan_in_another_order_is_proved_safe(seed: int) -> None:
    before = build_tpg(random_turns(seed, 6, gap=0.62))
    tpg = reorder_tasks(before)
    assert not np.array_equal(tpg.edges, before.edges)
    assert verify_plan(tpg).problems == ()
    assert audit_standing_states(tpg).violations == ()


def test_tasks_that_take_turns_node_by_node_stay_together() -> None:
    tpg = build_tpg(random_turns(2, 6, gap=0.62))
    relations, blocks, _ = _parts(tpg)
    assert all(len(block) == 1 for block in blocks)
    units = relations.units
    a, b = next(
        (a, b)
        for a in range(len(units))
        for b in range(len(units))
        if units[a].chain != units[b].chain and relations.stairs(a, b) is not None
    )
    # Let both start at once: neither could be complete before the other starts.
    chains = list(tpg.chains)
    for unit in (a, b):
        u = units[unit]
        start = chains[u.chain].planned_start.copy()
        start += 100.0 - start[u.first]
        chains[u.chain] = replace(chains[u.chain], planned_start=start)
    together = find_blocks(chains, relations)
    assert any({a, b} <= set(block) for block in together)
    flat = [unit for block in together for unit in block]
    assert sorted(flat) == list(range(len(units)))


def test_one_robot_is_left_alone() -> None:
    tpg = build_tpg(random_plan(2, 5, rounds=1, step=0.5))
    alone = replace(tpg, chains=tpg.chains[:1])
    assert reorder_tasks(alone) is alone


@pytest.mark.parametrize(
    "name",
    [
        "lego/cliff",
        "multi_arm/tray",
        pytest.param("multi_arm/assembly", marks=pytest.mark.nightly),
    ],
)
def test_edges_are_those_of_a_search_among_all_nodes(
    name: str, shipped: ShippedRuns
) -> None:
    planned = shipped(name).planned
    tpg = planned.turns or planned.tpg
    relations = TaskRelations(DerivedTpg(tpg))
    blocks = find_blocks(tpg.chains, relations)
    way = TaskOrderSearch(relations, blocks).best_way(8)
    order = [blocks[b] for b in way.order()]
    assert order != blocks
    chains = put_in_order(tpg.chains, relations, order)
    found = connect_in_order(chains, relations, order)
    searched = connect_nodes(DerivedTpg(replace(tpg, chains=chains)))
    assert np.array_equal(found.edges, searched.edges)
    makespan = float(DerivedTpg(found).rollout.makespan)
    assert makespan == pytest.approx(max(way.clocks), abs=1e-6)

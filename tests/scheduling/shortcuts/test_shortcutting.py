"""Shortcuts keep every guarantee: against brute force, networkx and the slow verification.

Sidesteps: the plan ends sooner, nothing else changes, and the guarantee stays.
"""

import gc
import itertools
import time
import weakref
from dataclasses import replace
from pathlib import Path

import networkx as nx
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from planning.errors import PlanInvariantError
from planning.geometry.exact import TOLERANCE
from planning.motion.motion_plan import MotionPlan
from planning.motion.speed import L1Speed
from scheduling.build_tpg import build_tpg
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.conflicts.object_spans import Rest
from scheduling.graph.plan_files import load_plan, save_plan
from scheduling.graph.rollout import earliest_times, latest_ends
from scheduling.graph.temporal_plan_graph import MOTION_CONFLICT, TemporalPlanGraph
from scheduling.invariant import check_invariant
from scheduling.shortcuts import stand_check, static_scene
from scheduling.shortcuts.rewiring import Swap, splice_edges
from scheduling.shortcuts.shortcut_search import ShortcutSearch
from scheduling.shortcuts.shortcutting import (
    critical_conflict_nodes,
    shorten_tpg,
    spans_beside_waits,
)
from scheduling.verification.verify import verify_plan
from tests.scheduling.algorithm_one import (
    PlainGraph,
    check_conflicts_are_ordered,
    graph_of,
    order_of,
)
from tests.scheduling.mini_world import random_plan
from tests.scheduling.random_dispatch import run_at_random
from tests.scheduling.two_arms import random_turns
from tests.shipped_runs import ShippedRuns
from twin.verification.standing_states import audit_standing_states

CASES = [(2, 0), (2, 4), (2, 7), (3, 3), (3, 5), (4, 1), (5, 2)]


def _shorten(
    plan: MotionPlan,
    step: float,
    candidates: int = 150,
    *,
    seed: int = 0,
    sidesteps: int = 0,
) -> TemporalPlanGraph:
    speeds = {robot.name: L1Speed() for robot in plan.cell.robots}
    return shorten_tpg(
        build_tpg(plan),
        speeds,
        step=step,
        candidates=candidates,
        seed=seed,
        sidesteps=sidesteps,
    )


@pytest.mark.nightly
@pytest.mark.parametrize(("robots", "seed"), CASES[:3])
def test_after_any_time_the_graph_is_whole_and_no_longer(
    robots: int, seed: int
) -> None:
    """A clock that counts how often it is asked: once before, once before each candidate."""
    plan = random_plan(robots, seed, rounds=9, step=0.5)
    speeds = {robot.name: L1Speed() for robot in plan.cell.robots}
    before = build_tpg(plan)
    longest = earliest_times(before).makespan
    for budget in (0, 1, 2, 7, 40, 200):
        drawn: list[float] = []

        def note(done: float, total: float, out: list[float] = drawn) -> None:
            out.append(done / total)

        tpg = shorten_tpg(
            before,
            speeds,
            step=0.5,
            candidates=10**6,
            seconds=budget + 0.5,
            clock=itertools.count().__next__,
            progress=note,
        )
        check_invariant(DerivedTpg(tpg))
        check_conflicts_are_ordered(tpg)
        assert earliest_times(tpg).makespan <= longest + 1e-9
        # As many were drawn as there was time for: the same as with a limit of their number.
        counted = shorten_tpg(before, speeds, step=0.5, candidates=budget)
        if budget <= 40:
            assert [c.waypoints.tobytes() for c in counted.chains] == [
                c.waypoints.tobytes() for c in tpg.chains
            ]
        assert drawn[-1] == 1.0


def test_a_budget_in_seconds_is_kept() -> None:
    plan = random_plan(3, 3, rounds=9, step=0.5)
    speeds = {robot.name: L1Speed() for robot in plan.cell.robots}
    tpg = build_tpg(plan)
    shorten_tpg(tpg, speeds, step=0.5, candidates=20)
    begin = time.monotonic()
    shorten_tpg(tpg, speeds, step=0.5, candidates=10**9, seconds=0.5)
    assert 0.5 <= time.monotonic() - begin < 5.0


@given(st.integers(2, 5), st.integers(0, 10_000), st.integers(0, 100))
@settings(max_examples=10, deadline=None)
def test_conflicting_nodes_stay_ordered_and_ends_stay_where_they_are(
    robots: int, seed: int, draws: int
) -> None:
    plan = random_plan(robots, seed, rounds=9, step=0.5)
    before = build_tpg(plan)
    tpg = _shorten(plan, 0.5, seed=draws)
    check_conflicts_are_ordered(tpg)
    assert earliest_times(tpg).makespan <= earliest_times(before).makespan + 1e-9
    for old, new in zip(before.chains, tpg.chains, strict=True):
        assert np.array_equal(old.waypoints[-1], new.waypoints[-1])
        assert new.duration.sum() <= old.duration.sum() + 1e-9
        skills = [c.waypoints[np.repeat(c.skill, np.diff(c.first))] for c in (old, new)]
        assert np.array_equal(skills[0], skills[1])


def test_shortcuts_are_found_at_all() -> None:
    for seed in (3, 5):
        plan = random_plan(3, seed, rounds=10, step=0.5)
        before, after = build_tpg(plan), _shorten(plan, 0.5)
        assert earliest_times(after).makespan < 0.99 * earliest_times(before).makespan


@pytest.mark.parametrize("seed", range(2))
def test_a_shortened_plan_is_proved_safe_and_stands_still_safely(seed: int) -> None:
    plan = random_turns(seed, 5, gap=0.62)
    before, tpg = build_tpg(plan), _shorten(plan, 0.05, candidates=120)
    assert earliest_times(tpg).makespan < earliest_times(before).makespan
    assert verify_plan(tpg).problems == ()
    assert audit_standing_states(tpg).violations == ()


def test_the_papers_rule_loses_an_order_of_three_robots() -> None:
    # u = (1, 0) -> (0, 1), (0, 2) -> w = (2, 1), and u -> w, which reduction leaves to those.
    edges = np.array([[0, 2, 2, 1], [1, 0, 0, 1]])
    first, last = 1, 3

    def waits(rows: np.ndarray) -> bool:
        return nx.has_path(graph_of((5, 2, 2), rows), (1, 0), (2, 1))

    papers = edges.copy()
    papers[0, 1], papers[1, 3] = first - 1, last
    assert not waits(papers)
    ours, _ = splice_edges(edges, np.zeros(2, dtype=np.uint8), Swap(0, first, last))
    assert waits(ours)


def test_the_same_seed_gives_the_same_plan() -> None:
    plan = random_plan(4, 1, rounds=9, step=0.5)
    one, two, other = (_shorten(plan, 0.5, seed=s) for s in (1, 1, 2))
    assert np.array_equal(one.edges, two.edges)
    for a, b in zip(one.chains, two.chains, strict=True):
        assert np.array_equal(a.waypoints, b.waypoints)
    assert any(
        len(a) != len(b) or not np.array_equal(a.waypoints, b.waypoints)
        for a, b in zip(one.chains, other.chains, strict=True)
    )


def test_graphs_before_a_shortcut_are_forgotten() -> None:
    """Were each kept, or only the arrays of its chains, memory would grow with the square."""
    board = ShortcutSearch(
        build_tpg(random_plan(3, 3, rounds=10, step=0.5)),
        {f"arm{k}": L1Speed() for k in range(3)},
        0.5,
    )
    rng, before = np.random.default_rng(0), list[weakref.ref[object]]()
    for _ in range(150):
        graph = board.graph
        board.step(rng)
        if board.graph is not graph:
            before.append(weakref.ref(graph))
            # Arrays and not chains: a piece of one may be what keeps it.
            before += (
                weakref.ref(old.waypoints)
                for old, new in zip(
                    graph.tpg.chains, board.graph.tpg.chains, strict=True
                )
                if old is not new
            )
    del graph
    gc.collect()
    assert len(before) >= 6
    assert not [ref for ref in before if ref() is not None]


def test_scenes_that_are_forgotten_change_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plan = random_turns(1, 5, gap=0.62)
    kept = _shorten(plan, 0.05, candidates=120)
    monkeypatch.setattr(static_scene, "_KEPT_SCENES", 1)
    forgotten = _shorten(plan, 0.05, candidates=120)
    assert np.array_equal(kept.edges, forgotten.edges)
    for a, b in zip(kept.chains, forgotten.chains, strict=True):
        assert np.array_equal(a.waypoints, b.waypoints)


def test_a_shortened_plan_is_saved_and_loaded(tmp_path: Path) -> None:
    tpg = _shorten(random_turns(0, 4, gap=0.62), 0.05, candidates=40)
    folder = tmp_path / "plan"
    save_plan(tpg, folder)
    again = load_plan(folder, {r.model.name: r.model for r in tpg.cell.robots})
    assert np.array_equal(tpg.edges, again.edges)
    assert np.array_equal(tpg.chains[0].waypoints, again.chains[0].waypoints)


@pytest.mark.parametrize(("robots", "seed"), CASES[:4])
def test_latest_ends_are_the_longest_ways_to_the_end(robots: int, seed: int) -> None:
    tpg = build_tpg(random_plan(robots, seed, rounds=8, step=0.5))
    rollout = earliest_times(tpg)
    graph = order_of(tpg)
    tail: dict[tuple[int, int], float] = {}
    for node in reversed(list(nx.topological_sort(graph))):
        tail[node] = max(
            (tail[n] + rollout.duration[n[0]][n[1]] for n in graph.successors(node)),
            default=0.0,
        )
    latest = latest_ends(tpg, rollout)
    for (r, n), rest in tail.items():
        assert latest[r][n] == pytest.approx(float(rollout.makespan) - rest)


@st.composite
def chains_and_cut(
    draw: st.DrawFn,
) -> tuple[list[int], list[tuple[int, int, int, int]], tuple[int, int, int]]:
    """Chains with forward edges, and a run of one of them to replace."""
    sizes = draw(st.lists(st.integers(3, 8), min_size=2, max_size=5))
    order = [(r, n) for n in range(8) for r in range(len(sizes)) if n < sizes[r]]
    pairs = draw(
        st.lists(
            st.tuples(st.integers(0, len(order) - 1), st.integers(0, len(order) - 1)),
            max_size=25,
        )
    )
    edges = sorted(
        {
            (*order[min(a, b)], *order[max(a, b)])
            for a, b in pairs
            if order[a][0] != order[b][0]
        }
    )
    chain = draw(st.integers(0, len(sizes) - 1))
    first = draw(st.integers(1, sizes[chain] - 1))
    last = draw(st.integers(first, sizes[chain] - 1))
    return sizes, edges, (chain, first, last)


@given(chains_and_cut())
@settings(max_examples=300, deadline=None)
# An order hangs on one node that is replaced.
@example(([3, 4, 3], [(0, 0, 1, 1), (1, 1, 2, 1)], (1, 1, 3)))
def test_replacing_nodes_loses_no_order_among_the_others(
    case: tuple[list[int], list[tuple[int, int, int, int]], tuple[int, int, int]],
) -> None:
    sizes, edges, (chain, first, last) = case

    rows = np.array(edges, dtype=np.int64).reshape(-1, 4)
    # What matters is a reduced graph: an order may hang on the replaced nodes alone.
    reduced = nx.transitive_reduction(graph_of(sizes, rows))
    keep = np.array([((r, u), (s, v)) in reduced.edges for r, u, s, v in rows.tolist()])
    rows = rows[keep.astype(bool)] if len(rows) else rows
    swap = Swap(chain, first, last)
    spliced, cause = splice_edges(rows, np.zeros(len(rows), dtype=np.uint8), swap)
    assert len(cause) == len(spliced)
    before = graph_of(sizes, rows)
    after = graph_of(sizes, spliced)
    assert nx.is_directed_acyclic_graph(after)

    gone = {(chain, n) for n in range(first, last)}
    reach = {node: nx.descendants(after, node) for node in after}
    for u in set(before) - gone:
        assert nx.descendants(before, u) - gone <= reach[u]


@pytest.fixture(scope="module")
def cliff(shipped: ShippedRuns) -> TemporalPlanGraph:
    return build_tpg(shipped("lego/cliff").planned.motions.motion_plan)


def the_gift(tpg: TemporalPlanGraph) -> Rest:
    rests = DerivedTpg(tpg).history.rests
    (gift,) = [rest for rest in rests if rest.holder is not None]
    return gift


def take_detours(tpg: TemporalPlanGraph) -> int:
    """Offer quick ways back by where the giver held the brick; return how many were taken."""
    gift = the_gift(tpg)
    assert gift.after is not None
    giver, given = gift.after
    chain = tpg.chains[giver]
    reference = chain.waypoints[chain.first[given] : chain.first[given + 1]]
    taken = 0
    for halfway in reference[:-1]:
        for last in range(given + 3, given + 12):
            board = ShortcutSearch(
                tpg, {c.robot: L1Speed(20.0) for c in tpg.chains}, 0.05
            )
            which = next(
                k
                for k, span in enumerate(board.spans)
                if span.chain == giver and span.first <= given + 1 <= span.last
            )
            ends = chain.first[given + 1] - 1, chain.first[last + 1] - 1
            path = np.array(
                [chain.waypoints[ends[0]], halfway, chain.waypoints[ends[1]]]
            )
            if board.try_candidate(which, given + 1, last, path):
                check_invariant(DerivedTpg(board.graph.tpg))
                taken += 1
    return taken


def test_no_way_back_is_taken_through_what_was_given(
    cliff: TemporalPlanGraph, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert take_detours(cliff) > 0
    # Who does not look at the brick takes one that is not safe.
    monkeypatch.setattr(stand_check, "_are_received_objects_clear", lambda *_: True)
    with pytest.raises(PlanInvariantError, match="in a standing robot's hand"):
        take_detours(cliff)


def makespan(tpg: TemporalPlanGraph) -> float:
    return float(earliest_times(tpg).makespan)


@given(st.integers(2, 5), st.integers(0, 10_000), st.integers(0, 100))
@settings(max_examples=8, deadline=None)
def test_the_plan_ends_no_later_and_what_is_done_stays(
    robots: int, seed: int, draws: int
) -> None:
    plan = random_plan(robots, seed, rounds=9, step=0.5)
    before = _shorten(plan, 0.5, seed=draws)
    tpg = _shorten(plan, 0.5, seed=draws, sidesteps=60)
    check_conflicts_are_ordered(tpg)
    assert makespan(tpg) <= makespan(before) + 1e-9
    for old, new in zip(before.chains, tpg.chains, strict=True):
        assert np.array_equal(old.waypoints[-1], new.waypoints[-1])
        skills = [c.waypoints[np.repeat(c.skill, np.diff(c.first))] for c in (old, new)]
        assert np.array_equal(skills[0], skills[1])


@pytest.mark.parametrize("seed", [7, 9])
def test_they_gain_where_shortcuts_have_ended(seed: int) -> None:
    plan = random_plan(3, seed, rounds=10)
    without, tpg = (_shorten(plan, 0.15, sidesteps=n) for n in (0, 200))
    assert makespan(tpg) < 0.98 * makespan(without)
    plain = PlainGraph(tpg, -TOLERANCE)
    run_at_random(tpg, plain, np.random.default_rng(seed), set())


@given(st.integers(2, 4), st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_waits_are_conflicts_that_the_makespan_hangs_on(robots: int, seed: int) -> None:
    tpg = build_tpg(random_plan(robots, seed, rounds=8, step=0.5))
    graph = DerivedTpg(tpg)
    found = critical_conflict_nodes(graph)
    rollout, latest = graph.rollout, latest_ends(tpg, graph.rollout, flat=graph.flat)
    for chain, node in found:
        assert latest[chain][node] == pytest.approx(rollout.end[chain][node])
    conflicts = {
        tuple(edge)
        for edge, cause in zip(tpg.edges.tolist(), tpg.cause.tolist(), strict=True)
        if cause == MOTION_CONFLICT
    }
    for (k, v), (i, u) in zip(found[::2], found[1::2], strict=True):
        assert (i, u, k, v) in conflicts
        assert rollout.start[k][v] == pytest.approx(rollout.end[i][u])
    if not found:
        # Then no conflict makes the plan longer than dependencies of tasks alone.
        kept = tpg.cause != MOTION_CONFLICT
        alone = replace(tpg, edges=tpg.edges[kept], cause=tpg.cause[kept])
        assert makespan(alone) == pytest.approx(makespan(tpg))


def test_spans_beside_waits_hold_the_node_that_waits_or_is_waited_for() -> None:
    plan = random_plan(3, 8, rounds=10)
    speeds = {robot.name: L1Speed() for robot in plan.cell.robots}
    board = ShortcutSearch(build_tpg(plan), speeds, 0.15)
    beside, ends = spans_beside_waits(board), set(critical_conflict_nodes(board.graph))
    assert beside
    for which, node in beside:
        span = board.spans[which]
        assert span.first <= node <= span.last
        assert (span.chain, node) in ends


def test_the_same_seed_steps_aside_alike() -> None:
    plan = random_plan(3, 7, rounds=10)
    one, two = (_shorten(plan, 0.15, sidesteps=100) for _ in range(2))
    for a, b in zip(one.chains, two.chains, strict=True):
        assert np.array_equal(a.waypoints, b.waypoints)

"""Sidesteps: the plan ends sooner, nothing else changes, and the guarantee stays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.geometry.exact import TOLERANCE
from planning.motion.known_motions import MotionPlan
from planning.motion.speed import L1Speed
from scheduling.build_tpg import build_tpg
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.dispatcher import earliest_times, latest_ends
from scheduling.graph.temporal_plan_graph import MOTION_CONFLICT, TemporalPlanGraph
from scheduling.shortcuts.candidates import runs_beside_waits, waits
from scheduling.shortcuts.shortcutting import Board, shorten_tpg
from tests.scheduling.algorithm_one import PlainGraph, check_conflicts_are_ordered
from tests.scheduling.mini_world import random_plan
from tests.scheduling.random_dispatch import run_at_random


def shortened(
    plan: MotionPlan, step: float, sidesteps: int, seed: int = 0
) -> TemporalPlanGraph:
    speeds = {robot.name: L1Speed() for robot in plan.cell.robots}
    return shorten_tpg(
        build_tpg(plan),
        speeds,
        step=step,
        candidates=150,
        seed=seed,
        sidesteps=sidesteps,
    )


def makespan(tpg: TemporalPlanGraph) -> float:
    return float(earliest_times(tpg).makespan)


@given(st.integers(2, 5), st.integers(0, 10_000), st.integers(0, 100))
@settings(max_examples=8, deadline=None)
def test_the_plan_ends_no_later_and_what_is_done_stays(
    robots: int, seed: int, draws: int
) -> None:
    plan = random_plan(robots, seed, rounds=9, step=0.5)
    before = shortened(plan, 0.5, 0, draws)
    tpg = shortened(plan, 0.5, 60, draws)
    check_conflicts_are_ordered(tpg)
    assert makespan(tpg) <= makespan(before) + 1e-9
    for old, new in zip(before.chains, tpg.chains, strict=True):
        assert np.array_equal(old.waypoints[-1], new.waypoints[-1])
        skills = [c.waypoints[np.repeat(c.skill, np.diff(c.first))] for c in (old, new)]
        assert np.array_equal(*skills)


@pytest.mark.parametrize("seed", [7, 9])
def test_they_gain_where_shortcuts_have_ended(seed: int) -> None:
    plan = random_plan(3, seed, rounds=10)
    without, tpg = (shortened(plan, 0.15, n) for n in (0, 200))
    assert makespan(tpg) < 0.98 * makespan(without)
    plain = PlainGraph(tpg, -TOLERANCE)
    run_at_random(tpg, plain, np.random.default_rng(seed), set())


@given(st.integers(2, 4), st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_waits_are_conflicts_that_the_makespan_hangs_on(robots: int, seed: int) -> None:
    tpg = build_tpg(random_plan(robots, seed, rounds=8, step=0.5))
    graph = DerivedTpg(tpg)
    found = waits(graph)
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


def test_runs_beside_waits_hold_the_node_that_waits_or_is_waited_for() -> None:
    plan = random_plan(3, 8, rounds=10)
    speeds = {robot.name: L1Speed() for robot in plan.cell.robots}
    board = Board(build_tpg(plan), speeds, 0.15)
    beside, ends = runs_beside_waits(board), set(waits(board.graph))
    assert beside
    for which, node in beside:
        span = board.spans[which]
        assert span.first <= node <= span.last
        assert (span.chain, node) in ends


def test_the_same_seed_gives_the_same_plan() -> None:
    plan = random_plan(3, 7, rounds=10)
    one, two = (shortened(plan, 0.15, 100) for _ in range(2))
    for a, b in zip(one.chains, two.chains, strict=True):
        assert np.array_equal(a.waypoints, b.waypoints)

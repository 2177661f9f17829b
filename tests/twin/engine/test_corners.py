"""Robots that pass corners at speed: within limits and cleared nodes, and both engines agree."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.motion_times import blended_path, chain_bends, within_limits
from tests.twin.bent_toys import BENT_TPGS, bent_tpg
from tests.twin.drawn_runs import ANYTHING, VARIED
from tests.twin.engine.driven_checks import (
    MESSAGES,
    NOMINAL,
    QUIET,
    assert_engines_agree,
    assert_inside_cleared_nodes,
    assert_takes_as_planned,
    assert_within_limits,
    travelled,
)
from tests.twin.simulated import simulate
from twin.durations.model import NANOSECONDS
from twin.engine.execution_model import ExecutionModel, Messages
from twin.run.events import Policy
from twin.run.trajectory import robot_trajectories
from twin.uncertainty.disturbances import Disturbances, EmergencyStop


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(BENT_TPGS, MESSAGES, QUIET, st.integers(0, 99))
def test_robots_keep_to_limits_inside_cleared_nodes(
    tpg: TemporalPlanGraph, messages: Messages, disturbances: Disturbances, seed: int
) -> None:
    run = simulate(tpg, VARIED, seed=seed, messages=messages, disturbances=disturbances)
    assert run.outcome == "completed"
    assert_within_limits(tpg, run)
    assert_inside_cleared_nodes(tpg, run, messages.report_ns + messages.release_ns)


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(BENT_TPGS, ANYTHING, MESSAGES, st.integers(0, 99))
def test_whatever_happens_robots_are_inside_cleared_nodes(
    tpg: TemporalPlanGraph, disturbances: Disturbances, messages: Messages, seed: int
) -> None:
    run = simulate(tpg, VARIED, seed=seed, messages=messages, disturbances=disturbances)
    assert_inside_cleared_nodes(tpg, run)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    BENT_TPGS,
    QUIET,
    st.sampled_from(["asynchronous", "sequential", "open-loop"]),
    st.sampled_from([None, 1, 4]),
    st.integers(0, 99),
)
def test_both_engines_give_the_same_nanoseconds(
    tpg: TemporalPlanGraph,
    disturbances: Disturbances,
    policy: Policy,
    depth: int | None,
    seed: int,
) -> None:
    model = ExecutionModel(VARIED, policy, Messages.of_seconds(depth), disturbances)
    assert_engines_agree(tpg, model, seed)


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(BENT_TPGS, st.integers(0, 99))
def test_nobody_who_is_cleared_in_time_takes_longer_than_planned(
    tpg: TemporalPlanGraph, seed: int
) -> None:
    assert_takes_as_planned(tpg, seed, within_s=1e-6)


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(BENT_TPGS, QUIET, st.integers(0, 99))
def test_what_is_executed_is_the_curve_that_was_checked(
    tpg: TemporalPlanGraph, disturbances: Disturbances, seed: int
) -> None:
    """The oracle is the distance from all chords of the chain."""
    run = simulate(tpg, VARIED, seed=seed, disturbances=disturbances)
    for chain, motion in zip(tpg.chains, robot_trajectories(tpg, run), strict=True):
        if chain.corners is None:
            continue
        points = np.vstack([chain.start[None], chain.waypoints])
        a, b = points[:-1], points[1:]
        times = np.linspace(0, run.makespan_ns, 300).astype(np.int64)
        for q in motion.at(times):
            way, off = b - a, q - a
            share = np.sum(off * way, axis=1) / np.maximum(
                np.sum(way**2, axis=1), 1e-30
            )
            near = a + np.clip(share, 0.0, 1.0)[:, None] * way
            # Gentle corners of skills are cut by as much.
            assert np.min(np.abs(q - near).sum(axis=1)) <= 3e-4


def test_a_corner_is_passed_at_speed_and_a_robot_that_is_not_cleared_stops_within_it() -> (
    None
):
    tpg = next(
        tpg
        for seed in range(100)
        if (tpg := bent_tpg(seed, dofs=(2, 2), tasks=2, edges=0)).chains[0].corners
        is not None
    )
    chain = tpg.chains[0]
    assert chain.drive is not None
    bend = next(chain_bends(chain))
    middle = (bend.begin + bend.stop) // 2
    inside = ~chain.drive.rests[bend.begin : bend.stop - 1]
    assert np.all(inside)
    free = simulate(tpg, NOMINAL, seed=0)
    motion = robot_trajectories(tpg, free)[0]
    assert motion.v is not None
    rows = (motion.node >= bend.begin) & (motion.node < bend.stop - 1)
    stands = np.all(np.abs(motion.v[rows]) < 1e-9, axis=1)
    assert np.count_nonzero(stands) <= 1  # at most where the stretch begins
    waits = np.array([[1, len(tpg.chains[1]) - 1, 0, middle]])
    held = replace(tpg, edges=waits, cause=np.ones(1, dtype=np.uint8))
    run = simulate(held, NOMINAL, seed=0)
    assert_within_limits(held, run)
    assert_inside_cleared_nodes(held, run)
    if run.end_ns[1][-1] > free.start_ns[0][middle]:
        moved = robot_trajectories(held, run)[0]
        before = travelled(moved, run.end_ns[1][-1:] - 1)[0]
        after = travelled(moved, run.end_ns[1][-1:] + 10**9)[0]
        assert after > before


def test_a_robot_that_stands_in_a_corner_leaves_no_more_rows_the_longer_it_stands() -> (
    None
):
    tpg = bent_tpg(3, dofs=(3,), tasks=2, edges=0)
    corners = tpg.chains[0].corners
    assert corners is not None
    inside = int(corners.begin[0] + corners.stop[0]) // 2
    at_s = simulate(tpg, NOMINAL, seed=0).start_ns[0][inside] / NANOSECONDS
    rows = []
    for length_s in (100.0, 3600.0):
        stop = EmergencyStop(at_s=at_s, duration_s=length_s)
        stops = Disturbances(emergency_stops=(stop,))
        run = simulate(tpg, NOMINAL, seed=0, disturbances=stops)
        assert_within_limits(tpg, run)
        motion = robot_trajectories(tpg, run)[0]
        rows.append(len(motion.t_ns))
        times = np.linspace((at_s + 5.0), (at_s + length_s), 7) * NANOSECONDS
        assert np.max(np.ptp(motion.at(times.astype(np.int64)), axis=0)) < 1e-9
    assert rows[0] == rows[1]


def test_other_limits_keep_the_curve_and_are_kept() -> None:
    tpg = next(
        tpg
        for seed in range(100)
        if (tpg := bent_tpg(seed, dofs=(3,), tasks=1, edges=0)).chains[0].corners
        is not None
    )
    robot = tpg.cell.robots[0]
    assert robot.limits is not None
    slow = replace(
        robot.limits,
        velocity=robot.limits.velocity * np.array([0.3, 0.7, 0.5]),
        acceleration=robot.limits.acceleration * 0.5,
    )
    cell = replace(tpg.cell, robots=(replace(robot, limits=slow),))
    other = within_limits(replace(tpg, cell=cell))
    run = simulate(other, NOMINAL, seed=0)
    assert_within_limits(other, run)
    for a, b in pairwise((tpg, other)):
        for chain in (a.chains[0], b.chains[0]):
            assert chain.drive is not None
            ends = np.flatnonzero(chain.drive.rests) + 1
            for begin, stop in pairwise([0, *ends.tolist()]):
                if chain.drive.ramp[begin] > 0.0:
                    cruise = chain.drive.cruise[begin:stop]
                    path = blended_path(chain, begin, stop, cruise)
                    at = np.concatenate([[0.0], np.cumsum(cruise)])
                    q = path.states(at[1:])[0]
                    own = chain.waypoints[chain.first[begin + 1 : stop + 1] - 1]
                    assert np.allclose(q, own, atol=1e-9)


@pytest.mark.parametrize("depth", [1, 2])
def test_a_short_queue_stops_robots_within_corners(depth: int) -> None:
    tpg = bent_tpg(3, dofs=(2, 3), tasks=4, nodes_per_transit=20)
    assert any(chain.corners is not None for chain in tpg.chains)
    run = simulate(tpg, NOMINAL, seed=0, messages=Messages.of_seconds(depth))
    assert run.makespan_s > 1.05 * simulate(tpg, NOMINAL, seed=0).makespan_s
    assert_within_limits(tpg, run)

"""Robots that pass corners at speed: on the curve that was checked, and stopped within it."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.motion_times import blended_path, chain_bends, within_limits
from tests.twin.drawn_runs import VARIED
from tests.twin.driven_toys import BENT_TPGS, bent_tpg
from tests.twin.engine.driven_checks import (
    QUIET,
    assert_inside_cleared_nodes,
    assert_within_limits,
    travelled,
)
from tests.twin.simulated import simulate, stopped
from twin.durations.model import NANOSECONDS
from twin.engine.execution_model import Messages
from twin.run.trajectory import robot_trajectories
from twin.uncertainty.disturbances import Disturbances


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


def first_bent(**shape: Any) -> TemporalPlanGraph:
    """Return the first graph of a shape whose first robot passes a corner at speed."""
    graphs = (bent_tpg(seed, edges=0, **shape) for seed in range(100))
    return next(tpg for tpg in graphs if tpg.chains[0].corners is not None)


def test_a_corner_is_passed_at_speed_and_a_robot_that_is_not_cleared_stops_within_it() -> (
    None
):
    tpg = first_bent(dofs=(2, 2), tasks=2)
    chain = tpg.chains[0]
    assert chain.drive is not None
    bend = next(chain_bends(chain))
    middle = (bend.begin + bend.stop) // 2
    inside = ~chain.drive.rests[bend.begin : bend.stop - 1]
    assert np.all(inside)
    free = simulate(tpg)
    motion = robot_trajectories(tpg, free)[0]
    assert motion.v is not None
    rows = (motion.node >= bend.begin) & (motion.node < bend.stop - 1)
    stands = np.all(np.abs(motion.v[rows]) < 1e-9, axis=1)
    assert np.count_nonzero(stands) <= 1  # at most where the stretch begins
    waits = np.array([[1, len(tpg.chains[1]) - 1, 0, middle]])
    held = replace(tpg, edges=waits, cause=np.ones(1, dtype=np.uint8))
    run = simulate(held)
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
    at_s = simulate(tpg).start_ns[0][inside] / NANOSECONDS
    rows = []
    for length_s in (100.0, 3600.0):
        run = simulate(tpg, disturbances=stopped(at_s, length_s))
        assert_within_limits(tpg, run)
        motion = robot_trajectories(tpg, run)[0]
        rows.append(len(motion.t_ns))
        times = np.linspace((at_s + 5.0), (at_s + length_s), 7) * NANOSECONDS
        assert np.max(np.ptp(motion.at(times.astype(np.int64)), axis=0)) < 1e-9
    assert rows[0] == rows[1]


def test_other_limits_keep_the_curve_and_are_kept() -> None:
    tpg = first_bent(dofs=(3,), tasks=1)
    robot = tpg.cell.robots[0]
    assert robot.limits is not None
    slow = replace(
        robot.limits,
        velocity=robot.limits.velocity * np.array([0.3, 0.7, 0.5]),
        acceleration=robot.limits.acceleration * 0.5,
    )
    cell = replace(tpg.cell, robots=(replace(robot, limits=slow),))
    other = within_limits(replace(tpg, cell=cell))
    run = simulate(other)
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
    run = simulate(tpg, messages=Messages.of_seconds(depth))
    assert run.makespan_s > 1.05 * simulate(tpg).makespan_s
    assert_within_limits(tpg, run)

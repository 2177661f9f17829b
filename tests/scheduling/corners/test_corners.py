"""Rounded corners keep every guarantee: against brute force, the slow verification and an obstacle."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.cell.motion_limits import MotionLimits
from planning.cell.shape import box_shape
from planning.cell.workcell import Fixture, PlacedRobot, Workcell
from planning.kinematics.kinematics import frame_pose
from planning.motion.motion_plan import MotionPlan
from planning.transforms import translation
from scheduling.build_tpg import build_tpg
from scheduling.corners.corners import round_corners
from scheduling.graph.rollout import earliest_times
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.motion_times import assign_node_times
from scheduling.stretch_times import chain_bends
from scheduling.verification.verify import verify_plan
from tests.scheduling.algorithm_one import check_conflicts_are_ordered
from tests.scheduling.mini_world import PlanWriter, planar_cell, random_plan
from tests.scheduling.two_arms import Writer, two_arms
from twin.verification.standing_states import audit_standing_states


def _limited(cell: Workcell) -> Workcell:
    """Return a cell whose robots take long to speed up."""

    def limited(robot: PlacedRobot) -> PlacedRobot:
        n = robot.model.dof
        limits = MotionLimits(np.full(n, 1.5), np.full(n, 3.0), np.full(n, 60.0))
        return replace(robot, limits=limits)

    return replace(cell, robots=tuple(map(limited, cell.robots)))


def _graph(plan: MotionPlan) -> TemporalPlanGraph:
    return build_tpg(replace(plan, cell=_limited(plan.cell)))


def _corners(tpg: TemporalPlanGraph) -> int:
    return sum(len(c.corners.bend) for c in tpg.chains if c.corners is not None)


@pytest.mark.nightly
@given(st.integers(1, 4), st.integers(0, 10_000))
@settings(max_examples=5, deadline=None)
def test_conflicting_nodes_stay_ordered_and_ends_stay_where_they_are(
    robots: int, seed: int
) -> None:
    before = _graph(random_plan(robots, seed, rounds=3))
    tpg = round_corners(before)
    check_conflicts_are_ordered(tpg)
    rested, smooth = assign_node_times(before), assign_node_times(tpg)
    assert earliest_times(smooth).makespan <= earliest_times(rested).makespan + 1e-6
    for old, new in zip(before.chains, tpg.chains, strict=True):
        assert len(old) == len(new)
        assert np.array_equal(old.waypoints[-1], new.waypoints[-1])
        skills = [c.waypoints[np.repeat(c.skill, np.diff(c.first))] for c in (old, new)]
        assert np.array_equal(skills[0], skills[1])


def test_corners_are_rounded_at_all_and_plans_get_shorter() -> None:
    found, shorter = 0, 0
    for seed in range(6):
        before = _graph(random_plan(2, seed, rounds=10))
        tpg = round_corners(before)
        found += _corners(tpg)
        rested, smooth = assign_node_times(before), assign_node_times(tpg)
        shorter += bool(
            earliest_times(smooth).makespan < 0.99 * earliest_times(rested).makespan
        )
    assert found >= 10
    assert shorter >= 3


@pytest.mark.parametrize("seed", range(2))
def test_a_rounded_plan_is_proved_safe_and_stands_still_safely(seed: int) -> None:
    writer = Writer(_limited(two_arms(gap=0.62)))
    rng = np.random.default_rng(seed)
    for turn in range(6):
        robot = writer.cell.robots[turn % 2]
        for _ in range(3):
            goal = robot.home + rng.normal(0.0, 0.35, robot.model.dof)
            if writer.line_free(robot.name, goal):
                writer.move(robot.name, goal)
    tpg = assign_node_times(round_corners(build_tpg(writer.plan())))
    assert _corners(tpg)
    assert verify_plan(tpg).problems == ()
    assert audit_standing_states(tpg).violations == ()


def test_the_same_plan_is_rounded_the_same_way() -> None:
    before = _graph(random_plan(2, 1, rounds=8))
    one, two = round_corners(before), round_corners(before)
    for a, b in zip(one.chains, two.chains, strict=True):
        assert np.array_equal(a.waypoints, b.waypoints)
    assert np.array_equal(one.edges, two.edges)


def test_without_limits_nothing_is_rounded() -> None:
    tpg = build_tpg(random_plan(2, 1, rounds=8))
    assert round_corners(tpg) is tpg


def _with_corner(fixtures: tuple[Fixture, ...] = ()) -> PlanWriter:
    """Return a plan of one arm that takes two legs, amid fixtures."""
    cell = _limited(planar_cell(1, np.random.default_rng(0), 0))
    cell = replace(cell, fixtures=(*cell.fixtures, *fixtures))
    writer = PlanWriter(cell, np.random.default_rng(0))
    robot = cell.robots[0]
    start = np.zeros(robot.model.dof)
    start[1] = 1.6
    corner, end = start.copy(), start.copy()
    corner[0] += 0.9
    end[:2] = 0.9, 0.2
    # First the forearm turns about the elbow's circle, then it stretches beyond it.
    writer.add(robot.name, "transit", writer.line(robot.home, start))
    path = np.vstack([writer.line(start, corner), writer.line(corner, end)[1:]])
    writer.add(robot.name, "transit", path)
    return writer


def test_a_corner_is_not_cut_into_an_obstacle() -> None:
    writer = _with_corner()
    robot = writer.cell.robots[0]
    free = round_corners(build_tpg(writer.plan()))
    bend = next(chain_bends(free.chains[0]))
    chain = free.chains[0]
    rows = slice(int(chain.first[bend.begin]), int(chain.first[bend.stop]))
    inside = chain.waypoints[rows]
    rng = np.random.default_rng(0)
    met = 0
    for _ in range(400):
        q = inside[rng.integers(len(inside))]
        at = frame_pose(robot, q)[:3, 3] + np.append(rng.normal(0, 0.08, 2), 0.0)
        post = Fixture("post", box_shape("post", (0.01, 0.01, 0.2)), translation(*at))
        amid = _with_corner((post,))
        amid.configurations = {robot.name: robot.home}
        legs = np.vstack([motion.path for motion in amid.plan().motions])
        if not amid.free(robot.name, legs) or amid.free(robot.name, inside):
            continue
        met += 1
        tpg = round_corners(build_tpg(amid.plan()))
        own = tpg.chains[0]
        whole = np.vstack([own.start[None], own.waypoints])
        # The oracle looks at many configurations of each chord.
        checker = amid.checker(robot.name)
        for a, b in pairwise(whole):
            for share in np.linspace(0.0, 1.0, 5):
                assert checker.configuration_free(a + share * (b - a))
        if own.corners is not None:
            assert np.max(own.corners.window) < np.max(bend.window)
        break
    assert met == 1


def test_a_corner_that_does_not_pay_is_left_alone() -> None:
    """Straight back the way it came: a curve is no quicker."""
    cell = _limited(planar_cell(1, np.random.default_rng(0), 0))
    writer = PlanWriter(cell, np.random.default_rng(0))
    robot = cell.robots[0]
    out = robot.home.copy()
    out[0] += 0.8
    path = np.vstack([writer.line(robot.home, out), writer.line(out, robot.home)[1:]])
    writer.add(robot.name, "transit", path)
    tpg = build_tpg(writer.plan())
    rounded = assign_node_times(round_corners(tpg))
    gained = assign_node_times(tpg).chains[0].duration.sum()
    gained -= rounded.chains[0].duration.sum()
    # What is gained is that it need not go quite as far.
    assert gained < 0.2

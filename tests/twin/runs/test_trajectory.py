"""Where robots and objects were by the node times of a run, and how far from their paths."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.kinematics.kinematics import frame_pose
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.drawn_runs import TPGS, VARIED
from tests.twin.recorded_events import InterruptsAt
from tests.twin.simulated import simulate
from tests.twin.twin_toys import random_tpg, two_robot_tpg
from twin.engine.execution_model import Messages
from twin.recorders.run_tables import objects_table, trajectory_table
from twin.runs.execution_record import ExecutionRecord, Measured
from twin.runs.tracking import nearest_on_path, tracking_errors
from twin.runs.trajectory import object_placements, robot_trajectories
from twin.uncertainty.disturbances import Disturbances, Stalls


def executed(tpg: TemporalPlanGraph, seed: int, latency: float) -> ExecutionRecord:
    return simulate(
        tpg,
        VARIED,
        seed=seed,
        messages=Messages.of_seconds(1, latency, latency),
        disturbances=Disturbances(
            stalls=Stalls(count_per_robot=1, duration_s=(0.5, 3.0))
        ),
    )


def position(
    tpg: TemporalPlanGraph, run: ExecutionRecord, k: int, t: float
) -> np.ndarray:
    """Where a robot is, from the definition: look up the node, then the waypoints."""
    chain = tpg.chains[k]
    q = chain.start
    for node in range(len(chain)):
        begin = run.start_ns[k][node] + run.stood_ns[k][node]
        if run.start_ns[k][node] < 0 or t < begin:
            return q
        path = chain.waypoints[chain.first[node] : chain.first[node + 1]]
        shares = chain.fraction[chain.first[node] : chain.first[node + 1]]
        duration = run.duration_ns[k][node]
        if t < begin + duration:
            share = (t - begin) / duration
            points = np.vstack([q, path])
            return np.array(
                [np.interp(share, [0.0, *shares], column) for column in points.T]
            )
        q = path[-1]
    return q


@settings(max_examples=40, deadline=None)
@given(TPGS, st.integers(0, 100), st.sampled_from([0.0, 0.3]))
def test_rows_are_the_motion(tpg: TemporalPlanGraph, seed: int, latency: float) -> None:
    run = executed(tpg, seed, latency)
    times = np.linspace(0, run.makespan_ns, 157).astype(np.int64)
    for k, motion in enumerate(robot_trajectories(tpg, run)):
        assert (motion.t_ns[0], motion.t_ns[-1]) == (0, run.makespan_ns)
        assert np.all(np.diff(motion.t_ns) >= 0)
        assert np.all(np.diff(motion.node) >= 0)
        # Two rows at one time are the same place: nothing jumps.
        still = np.diff(motion.t_ns) == 0
        moved = np.any(np.diff(motion.q, axis=0) != 0, axis=1)
        zero = run.duration_ns[k][motion.node[1:]] == 0
        assert not np.any(still & moved & ~zero)
        for t, q in zip(times, motion.at(times), strict=True):
            if not np.any(motion.t_ns == t):
                assert q == pytest.approx(position(tpg, run, k, t), abs=1e-6)


@settings(max_examples=40, deadline=None)
@given(TPGS, st.integers(0, 100))
def test_every_waypoint_and_both_ends_of_every_wait_have_a_row(
    tpg: TemporalPlanGraph, seed: int
) -> None:
    run = executed(tpg, seed, 0.0)
    motions = robot_trajectories(tpg, run)
    for k, chain in enumerate(tpg.chains):
        stalls = int(np.sum(run.stood_ns[k] > 0))
        waits = [w for w in run.waits() if w.chain == k]
        tail = int(run.end_ns[k][-1] < run.makespan_ns)
        rows = 1 + len(chain.waypoints) + len(waits) + stalls + tail
        assert len(motions[k].t_ns) == rows
        times = set(motions[k].t_ns.tolist())
        for wait in waits:
            assert {wait.start_ns, wait.end_ns} <= times


def test_a_robot_without_work_stands_at_home() -> None:
    tpg = random_tpg(3, idle_robots=1)
    run = executed(tpg, 0, 0.0)
    motion = robot_trajectories(tpg, run)[-1]
    assert motion.robot == tpg.cell.robots[-1].name
    assert motion.t_ns.tolist() == [0, run.makespan_ns]
    assert np.array_equal(motion.q[0], tpg.cell.robots[-1].home)


@pytest.mark.parametrize("count", [1, 6, 9, 15])
def test_a_run_broken_off_ends_where_the_robots_were(count: int) -> None:
    tpg = two_robot_tpg([(0, 1, 1, 0)])
    run = simulate(tpg, VARIED, seed=0, recorders=[InterruptsAt(count)])
    for k, motion in enumerate(robot_trajectories(tpg, run)):
        assert motion.t_ns[-1] == run.makespan_ns
        assert motion.q[-1] == pytest.approx(
            position(tpg, run, k, run.makespan_ns), abs=1e-9
        )


def test_objects_start_somewhere_and_change_with_their_handlings() -> None:
    tpg = random_tpg(4, tasks=6, edges=0)
    run = executed(tpg, 0, 0.0)
    placements = object_placements(tpg, run)
    assert (placements[0].t_ns, placements[0].holder) == (0, None)
    assert np.array_equal(placements[0].pose, tpg.cell.objects[0].start)
    assert len(placements) == 1 + len(tpg.handlings)
    assert all(np.diff([p.t_ns for p in placements]) >= 0)


def test_tables_have_their_documented_columns() -> None:
    tpg = random_tpg(4, dofs=(2, 3), tasks=6, edges=0)
    run = executed(tpg, 0, 0.0)
    table = trajectory_table(robot_trajectories(tpg, run))
    assert table.column_names == ["t_s", "robot", "q_0", "q_1", "q_2", "node"]
    rows = table.to_pylist()
    assert {r["q_2"] is None for r in rows if r["robot"] == "robot_0"} == {True}
    assert {r["q_2"] is None for r in rows if r["robot"] == "robot_1"} == {False}
    objects = objects_table(object_placements(tpg, run))
    assert objects.column_names == ["t_s", "object", "parent", "xyz", "quat_wxyz"]
    first = objects.to_pylist()[0]
    assert (first["t_s"], first["object"], first["parent"]) == (0.0, "brick_0", "world")
    assert first["xyz"] == pytest.approx([0.0, 0.5, 0.0])
    assert first["quat_wxyz"] == pytest.approx([1.0, 0.0, 0.0, 0.0])
    held = next(r for r in objects.to_pylist() if r["parent"] != "world")
    assert held["parent"].endswith("/flange")


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_nearest_point_is_that_of_a_dense_search(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tpg = random_tpg(seed % 1000, tasks=6)
    chain = tpg.chains[0]
    node = np.sort(rng.integers(-1, len(chain), 12))
    q = rng.uniform(-1.0, 1.0, (12, chain.waypoints.shape[1]))
    found = nearest_on_path(chain, q, node)
    path = np.vstack([chain.start, chain.waypoints])
    for row, n in enumerate(node.tolist()):
        low, high = max(n - 1, 0), min(max(n, 0) + 2, len(chain))
        own = path[chain.first[low] : chain.first[high] + 1]
        dense = np.vstack(
            [np.linspace(a, b, 400) for a, b in zip(own, own[1:], strict=False)]
        )
        # Of each leg the point that is nearest as the crow flies, then the leg that is least off by a joint.
        legs = dense.reshape(len(own) - 1, 400, -1)
        nearest = [leg[np.linalg.norm(leg - q[row], axis=1).argmin()] for leg in legs]
        least = min(float(np.abs(p - q[row]).max()) for p in nearest)
        assert abs(float(np.abs(found[row] - q[row]).max()) - least) < 0.01


def test_who_is_on_the_path_is_off_by_nothing_and_who_is_beside_it_by_that() -> None:
    tpg = random_tpg(4, dofs=(3,), tasks=4)
    chain = tpg.chains[0]
    node = np.repeat(np.arange(len(chain)), np.diff(chain.first))
    times = np.arange(len(node))
    assert tracking_errors(
        tpg, {"robot_0": Measured(times, chain.waypoints, node)}
    ) == {"robot_0": (0.0, 0.0)}
    aside = chain.waypoints + np.array([0.0, 0.0, 5.0])
    (found,) = tracking_errors(tpg, {"robot_0": Measured(times, aside, node)}).values()
    assert found.joint > 1.0
    robot = tpg.cell.robots[0]
    far = [
        np.linalg.norm(
            frame_pose(robot, a, "tool")[:3, 3] - frame_pose(robot, b, "tool")[:3, 3]
        )
        for a, b in zip(aside, nearest_on_path(chain, aside, node), strict=True)
    ]
    assert found.tool_m == max(far)

"""Robots that keep to limits: only ever inside cleared nodes, whatever the delays, and never too fast, also where corners are rounded."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from planning.transforms import Array, Indices
from scheduling.graph.dispatcher import Dispatcher
from scheduling.graph.rollout import earliest_times
from scheduling.graph.temporal_plan_graph import NodeChain, TemporalPlanGraph
from scheduling.motion_times import assign_node_times, node_path, with_full_speed_times
from scheduling.stretch_times import blended_path, chain_bends
from tests.twin.drawn_runs import ANYTHING, VARIED
from tests.twin.driven_toys import BENT_TPGS, DRIVEN_TPGS, bent_tpg, driven_tpg
from tests.twin.simulated import NOMINAL, simulate, stopped, watched
from twin.bulk.bulk_engine import BulkEngine
from twin.durations.bounded import Fixed, Uniform
from twin.durations.nanoseconds import NANOSECONDS
from twin.engine.driven_robots import DrivenRobots
from twin.engine.engine import Simulator
from twin.engine.execution import Execution, Ports
from twin.engine.execution_model import ExecutionModel, Messages
from twin.runs.execution_record import ExecutionRecord, Policy
from twin.runs.trajectory import Trajectory, object_placements, robot_trajectories
from twin.uncertainty.disturbances import (
    Breakdowns,
    Disturbances,
    EmergencyStop,
    Stalls,
)
from twin.uncertainty.node_times import NodeTimeSampler
from twin.uncertainty.skill_durations import SkillDurations

MESSAGES = st.builds(
    Messages.of_seconds,
    st.sampled_from([None, 1, 3]),
    st.sampled_from([0.0, 0.05, 0.5]),
    st.sampled_from([0.0, 0.05]),
)
QUIET = st.builds(
    Disturbances,
    jitter=st.sampled_from([None, Uniform(low_s=0.0, high_s=0.1)]),
    stalls=st.builds(
        Stalls,
        count_per_robot=st.sampled_from([0, 2]),
        rate_per_h=st.sampled_from([0.0, 400.0]),
        duration=st.sampled_from([None, Fixed(value_s=0.3)]),
    ),
)


def travelled(motion: Trajectory, t_ns: Indices) -> Array:
    """Return how far along its path a robot is at some times: every row in between is looked at."""
    times = np.unique(np.concatenate([motion.t_ns, t_ns]))
    q = motion.at(times)
    way = np.linalg.norm(np.diff(q, axis=0), axis=1)
    passed: Array = np.interp(t_ns, times, np.concatenate([[0.0], np.cumsum(way)]))
    return passed


def path_borders(tpg: TemporalPlanGraph, k: int) -> np.ndarray:
    """Return how far along the path of a chain each node begins, and the end."""
    chain = tpg.chains[k]
    points = np.vstack([chain.start[None], chain.waypoints])
    way = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(way)])[chain.first]


def assert_within_limits(tpg: TemporalPlanGraph, run: ExecutionRecord) -> None:
    """Check speeds, accelerations and jerks of all motions, and that rows say what positions do."""
    for motion in robot_trajectories(tpg, run):
        limits = tpg.cell.robot(motion.robot).limits
        assert limits is not None
        assert motion.v is not None
        assert motion.a is not None
        span = np.diff(motion.t_ns)[:, None] / NANOSECONDS
        assert np.all(span > 0.0)
        assert np.max(np.abs(motion.v) / limits.velocity) <= 1.0 + 1e-6
        assert np.max(np.abs(motion.a) / limits.acceleration) <= 1.0 + 1e-6
        rise = np.abs(np.diff(motion.a, axis=0))
        assert np.all(rise <= limits.jerk * span * (1.0 + 1e-6) + 1e-7)
        gained = span * (motion.a[:-1] + motion.a[1:]) / 2
        assert np.allclose(np.diff(motion.v, axis=0), gained, atol=1e-6)
        moved = span * motion.v[:-1] + span**2 * (2 * motion.a[:-1] + motion.a[1:]) / 6
        assert np.allclose(np.diff(motion.q, axis=0), moved, atol=1e-6)


def assert_inside_cleared_nodes(
    tpg: TemporalPlanGraph, run: ExecutionRecord, late_ns: int = 0
) -> None:
    """Check of every edge that the first is left, and known to be, before the second is entered."""
    motions = {motion.robot: motion for motion in robot_trajectories(tpg, run)}
    for r, u, s, v in tpg.edges.tolist():
        done = int(run.end_ns[r][u])
        if done < 0:
            continue
        first = motions[tpg.chains[r].robot]
        left = travelled(first, np.array([done]))[0]
        # Gentle corners of skills are cut by less than this.
        assert left >= path_borders(tpg, r)[u + 1] - 1e-3
        then = motions[tpg.chains[s].robot]
        here = travelled(then, np.array([min(done + late_ns, run.makespan_ns)]))[0]
        assert here <= path_borders(tpg, s)[v] + 1e-3


def assert_engines_agree(
    tpg: TemporalPlanGraph, model: ExecutionModel, seed: int
) -> None:
    """Check that both engines start and end every node, or segment of nodes, in the same nanosecond."""
    simulator = Simulator(tpg, model)
    runs = [simulator.run(seed=seed, replication=k) for k in range(4)]
    for by_node in (True, False):
        engine = BulkEngine(tpg, model, by_node=by_node)
        found = engine.execute(engine.sample(seed=seed, replications=range(4)))
        heads = engine.contraction.heads()
        for k, run in enumerate(runs):
            start, end = np.concatenate(run.start_ns), np.concatenate(run.end_ns)
            assert start[heads[:-1]].tolist() == found.start_ns[:, k].tolist()
            assert end[heads[1:] - 1].tolist() == found.end_ns[:, k].tolist()


def assert_takes_as_planned(
    tpg: TemporalPlanGraph, seed: int, *, within_s: float
) -> None:
    """Check that robots which need not wait for others end every node when the plan does."""
    free = replace(
        tpg, edges=tpg.edges[:0], cause=tpg.cause[:0], dependencies=tpg.dependencies[:0]
    )
    run = simulate(free, seed=seed)
    planned = earliest_times(free)
    for end, nominal in zip(run.end_ns, planned.end, strict=True):
        assert np.allclose(end / NANOSECONDS, nominal, atol=within_s)


GRAPHS = st.one_of(DRIVEN_TPGS, DRIVEN_TPGS, BENT_TPGS)
"""Straight ways, and in every third case rounded corners."""

MANY = settings(
    max_examples=80, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)


@MANY
@given(GRAPHS, MESSAGES, QUIET, st.integers(0, 99))
def test_robots_keep_to_limits_inside_cleared_nodes(
    tpg: TemporalPlanGraph, messages: Messages, disturbances: Disturbances, seed: int
) -> None:
    run = simulate(tpg, VARIED, seed=seed, messages=messages, disturbances=disturbances)
    assert run.outcome == "completed"
    assert_within_limits(tpg, run)
    assert_inside_cleared_nodes(tpg, run, messages.report_ns + messages.release_ns)


STOPPED = st.builds(
    Disturbances,
    emergency_stops=st.lists(
        st.builds(
            EmergencyStop,
            at_s=st.floats(0.01, 12.0),
            duration_s=st.floats(0.001, 2.0),
        ),
        min_size=1,
        max_size=6,
    ).map(tuple),
    breakdowns=st.sampled_from(
        [None, Breakdowns(mtbf_s=2.0, mttr_s=0.5, clock="run")],
    ),
)


AT_A_BORDER = Disturbances(
    emergency_stops=(EmergencyStop(at_s=0.61046857139397, duration_s=1.0),)
)
"""Stops a robot so that it comes to rest at the end of a stretch, but for rounding."""


@settings(max_examples=60, deadline=None)
@example(
    driven_tpg(11434, dofs=(2, 3), tasks=9, nodes_per_transit=3, edges=0),
    AT_A_BORDER,
    NOMINAL,
    0,
)
@given(DRIVEN_TPGS, STOPPED, st.sampled_from([VARIED, NOMINAL]), st.integers(0, 99))
def test_robots_that_the_clock_stops_keep_to_limits_in_skills_too(
    tpg: TemporalPlanGraph,
    disturbances: Disturbances,
    skills: SkillDurations,
    seed: int,
) -> None:
    run, events = watched(tpg, skills, seed=seed, disturbances=disturbances)
    assert run.outcome == "completed"
    assert_within_limits(tpg, run)
    assert_inside_cleared_nodes(tpg, run)
    quiet = simulate(tpg, skills, seed=seed, disturbances=disturbances)
    for own, found in zip(run.end_ns, quiet.end_ns, strict=True):
        assert own.tolist() == found.tolist()
    told = [e for e in events if e.kind in ("attached", "detached")]
    placed = [p for p in object_placements(tpg, run) if p.t_ns > 0]
    assert sorted((e.t_ns, e.object) for e in told if e.t_ns > 0) == sorted(
        (p.t_ns, p.object) for p in placed
    )
    for motion in robot_trajectories(tpg, run):
        k = tpg.chain_index[motion.robot]
        # Whoever has come to the end of a node is where it ends.
        for node in np.flatnonzero(tpg.chains[k].skill):
            end = int(run.end_ns[k][node])
            there = motion.at(np.array([end]))[0]
            assert np.allclose(there, node_path(tpg.chains[k], int(node))[-1])
        # And rows of a skill are rows of its time.
        for node, t in zip(motion.node[:-1], motion.t_ns[:-1], strict=True):
            if node >= 0 and tpg.chains[k].skill[node]:
                assert run.start_ns[k][node] <= t <= run.end_ns[k][node]


def jumble_messages(execution: Execution, seed: int) -> None:
    """Let messages take random times, those to one robot in order."""
    rng, enqueue = np.random.default_rng(seed), execution.enqueue
    arrivals: dict[int, int] = {}

    def enqueue_late(chain: int, node: int) -> None:
        late = int(rng.integers(0, 400_000_000))
        arrivals[chain] = max(execution.now_ns + late, arrivals.get(chain, 0))
        message = execution.env.timeout(arrivals[chain] - execution.now_ns)
        message.callbacks.append(lambda _: enqueue(chain, node))

    execution.enqueue = enqueue_late  # type: ignore[method-assign]  # of this one only


@settings(max_examples=30, deadline=None)
@given(DRIVEN_TPGS, QUIET, st.integers(0, 99))
def test_the_order_of_messages_makes_no_difference(
    tpg: TemporalPlanGraph, disturbances: Disturbances, seed: int
) -> None:
    sampler = NodeTimeSampler(with_full_speed_times(tpg), VARIED, disturbances)
    times = sampler.sample(seed=seed)
    run = simulate(tpg, VARIED, seed=seed, disturbances=disturbances)
    ports = Ports(DrivenRobots)
    execution = Execution(tpg, times, Dispatcher(tpg), Messages(), ports)
    jumble_messages(execution, seed)
    assert execution.execute() == "completed"
    driven = execution.robots.node_times()
    jumbled = replace(
        run,
        start_ns=tuple(map(np.array, execution.start)),
        end_ns=tuple(map(np.array, execution.end)),
        makespan_ns=max((max(end) for end in execution.end if end), default=0),
        duration_ns=driven.motion,
        stood_ns=driven.stood,
        standstills=driven.standstills,
        commands=execution.robots.commands(),
    )
    assert_within_limits(tpg, jumbled)
    assert_inside_cleared_nodes(tpg, jumbled)


@MANY
@given(
    GRAPHS,
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


@MANY
@given(GRAPHS, st.integers(0, 99))
def test_nobody_who_is_cleared_in_time_takes_longer_than_planned(
    tpg: TemporalPlanGraph, seed: int
) -> None:
    bent = any(chain.corners is not None for chain in tpg.chains)
    assert_takes_as_planned(tpg, seed, within_s=1e-6 if bent else 1e-7)


@MANY
@given(GRAPHS, ANYTHING, MESSAGES, st.integers(0, 99))
@example(
    driven_tpg(1283, dofs=(1, 2, 3), tasks=1, nodes_per_transit=11, edges=0),
    Disturbances(
        jitter=Uniform(kind="uniform", low_s=0.0, high_s=0.1),
        stalls=Stalls(rate_per_h=200.0),
        breakdowns=Breakdowns(mtbf_s=20.0, mttr_s=5.0, clock="run"),
        emergency_stops=(EmergencyStop(robot=None, at_s=0.0, duration_s=1.0),),
    ),
    Messages(),
    11,
)
def test_whatever_happens_the_record_is_whole(
    tpg: TemporalPlanGraph, disturbances: Disturbances, messages: Messages, seed: int
) -> None:
    run, events = watched(
        tpg, VARIED, seed=seed, messages=messages, disturbances=disturbances
    )
    for start, end, took, stall in zip(
        run.start_ns, run.end_ns, run.duration_ns, run.stood_ns, strict=True
    ):
        done = end >= 0
        assert np.all(start[1:][done[1:]] >= end[:-1][done[1:]])
        assert np.all(took[done] >= 0)
        assert np.all(end[done] - start[done] >= took[done] + stall[done])
    times = [event.t_ns for event in events]
    assert all(a <= b for a, b in pairwise(times))
    assert_inside_cleared_nodes(tpg, run)


@settings(max_examples=30, deadline=None)
@given(DRIVEN_TPGS, QUIET, st.integers(0, 99))
def test_a_process_that_is_done_standing_is_seen_from_begin_to_end(
    tpg: TemporalPlanGraph, disturbances: Disturbances, seed: int
) -> None:
    tpg = assign_node_times(replace(tpg, chains=tuple(map(_standing, tpg.chains))))
    run = simulate(tpg, VARIED, seed=seed, disturbances=disturbances)
    motions = {motion.robot: motion for motion in robot_trajectories(tpg, run)}
    for k, chain in enumerate(tpg.chains):
        motion = motions[chain.robot]
        for node in np.flatnonzero(chain.skill & (run.duration_ns[k] > 0)):
            rows = motion.t_ns[motion.node == node]
            begin = run.start_ns[k][node] + run.stood_ns[k][node]
            assert run.end_ns[k][node] in rows
            assert begin in motion.t_ns


def _standing(chain: NodeChain) -> NodeChain:
    """Return a chain whose robot stands in its skills."""
    points = chain.waypoints.copy()
    for node in np.flatnonzero(chain.skill):
        low, high = chain.first[node], chain.first[node + 1]
        points[low:high] = chain.start if low == 0 else points[low - 1]
    return replace(chain, waypoints=points, drive=None)


def test_a_stop_by_the_clock_brakes_along_the_way_and_stands_inside_a_node() -> None:
    tpg = driven_tpg(3, dofs=(2,), tasks=1, nodes_per_transit=30, edges=0)
    free = simulate(tpg)
    at_s = 0.4 * free.makespan_s
    run = simulate(tpg, disturbances=stopped(at_s, 2.0))
    assert_within_limits(tpg, run)
    motion = robot_trajectories(tpg, run)[0]
    assert motion.v is not None
    stands = (motion.t_ns > (at_s + 1.0) * 1e9) & (motion.t_ns < (at_s + 2.0) * 1e9)
    assert np.allclose(motion.v[stands], 0.0)
    # What braking gains, speeding up again loses.
    assert run.makespan_s == pytest.approx(free.makespan_s + 2.0, abs=0.05)


def test_a_robot_that_is_not_cleared_in_time_brakes_before_the_border() -> None:
    tpg = driven_tpg(5, dofs=(2, 2), tasks=2, nodes_per_transit=20, edges=0)
    waits = np.array([[1, len(tpg.chains[1]) - 1, 0, 10]])
    tpg = replace(tpg, edges=waits, cause=np.ones(1, dtype=np.uint8))
    run = simulate(tpg)
    alone = simulate(replace(tpg, edges=waits[:0], cause=tpg.cause[:0]))
    assert run.end_ns[1][-1] > alone.end_ns[0][9]
    assert run.end_ns[0][-1] > alone.end_ns[0][-1]
    motion = robot_trajectories(tpg, run)[0]
    before = travelled(motion, run.end_ns[1][-1:])
    assert before[0] == pytest.approx(path_borders(tpg, 0)[10], abs=1e-6)
    assert_within_limits(tpg, run)


def test_a_queue_of_one_node_stops_at_every_border() -> None:
    tpg = driven_tpg(7, dofs=(2,), tasks=1, nodes_per_transit=10, edges=0)
    whole = simulate(tpg)
    single = simulate(tpg, messages=Messages.of_seconds(1))
    assert single.makespan_s > 1.5 * whole.makespan_s
    assert single.makespan_s == pytest.approx(
        sum(_alone(tpg, node) for node in range(len(tpg.chains[0]))), rel=0.2
    )


def _alone(tpg: TemporalPlanGraph, node: int) -> float:
    """Return the least time of a node from rest to rest, as commanded [s]."""
    drive = tpg.chains[0].drive
    assert drive is not None
    cruise, ramp = float(drive.cruise[node]), float(drive.ramp[node])
    return cruise + ramp if cruise >= ramp else 2.0 * (cruise * ramp) ** 0.5


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
    other = assign_node_times(replace(tpg, cell=cell))
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

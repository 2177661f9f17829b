"""Segments of robots within limits are the motion, cut where it passes from node to node."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planning.errors import OutputError
from tests.twin.driven_toys import driven_tpg
from tests.twin.exports.exported_runs import DISTURBED, exported, toy_run
from twin.durations.model import NANOSECONDS
from twin.run.events import ExecutionRecord
from twin.run.trajectory import Trajectory, robot_trajectories
from twin.trial.run_result import RunResult
from twin.uncertainty.disturbances import Disturbances, EmergencyStop

CALM = Disturbances()


@pytest.fixture(
    scope="module",
    params=[(3, CALM), (8, CALM), (21, DISTURBED)],
    ids=["3", "8", "disturbed"],
)
def case(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[RunResult, ExecutionRecord]:
    seed, disturbances = request.param
    tpg = driven_tpg(seed, tasks=10, edges=20)
    folder = tmp_path_factory.mktemp("smooth")
    return toy_run(folder, seed, disturbances=disturbances, tpg=tpg)


def motions_of(run: RunResult, record: ExecutionRecord) -> dict[str, Trajectory]:
    return {m.robot: m for m in robot_trajectories(run.tpg, record)}


def segments_of(run: RunResult, rate_hz: float | None = None) -> list[dict[str, Any]]:
    text = exported(run, "joint-trajectory", rate_hz=rate_hz)["joint_trajectories.json"]
    found: list[dict[str, Any]] = json.loads(text)["segments"]
    return found


def points_of(segment: dict[str, Any]) -> tuple[np.ndarray, ...]:
    """Times [ns], positions, velocities and accelerations."""
    points = segment["joint_trajectory"]["points"]
    stamps = [p["time_from_start"] for p in points]
    keys = ("positions", "velocities", "accelerations")
    return (
        np.array([t["sec"] * NANOSECONDS + t["nanosec"] for t in stamps]),
        *(np.array([p[key] for p in points]) for key in keys),
    )


@pytest.mark.parametrize("rate_hz", [125.0, 1000.0])
def test_points_are_the_motion_at_the_rate(
    rate_hz: float, case: tuple[RunResult, ExecutionRecord]
) -> None:
    run, record = case
    motions = motions_of(run, record)
    for segment in segments_of(run, rate_hz):
        t, q, _, _ = points_of(segment)
        begin, end = (round(s * NANOSECONDS) for s in segment["motion_s"])
        assert (t[0], t[-1]) == (0, end - begin)
        period, apart = NANOSECONDS / rate_hz, np.diff(t)
        if end - begin >= period:
            assert np.min(apart) >= period
        # Where a robot stands there are the first and the last.
        moves = np.any(np.diff(q, axis=0) != 0.0, axis=1)
        assert np.max(apart[moves], initial=0) < 2 * period
        assert np.max(np.abs(motions[segment["robot"]].at(begin + t) - q)) < 1e-9


def test_a_robot_that_stands_for_long_has_no_more_points(tmp_path: Path) -> None:
    tpg = driven_tpg(3, tasks=10, edges=20)
    counts = []
    for length_s in (60.0, 6000.0):
        stop = EmergencyStop(at_s=2.0, duration_s=length_s)
        folder = tmp_path / str(length_s)
        folder.mkdir()
        run, record = toy_run(
            folder, 3, disturbances=Disturbances(emergency_stops=(stop,)), tpg=tpg
        )
        counts.append(sum(len(points_of(s)[0]) for s in segments_of(run)))
        assert record.makespan_s > length_s
    assert abs(counts[0] - counts[1]) <= len(tpg.chains)


def test_speeds_and_accelerations_are_derivatives(
    case: tuple[RunResult, ExecutionRecord],
) -> None:
    run, record = case
    motions = motions_of(run, record)
    step, checked = 1000, 0
    for segment in segments_of(run):
        motion = motions[segment["robot"]]
        t, _, v, a = points_of(segment)
        t = t + round(segment["motion_s"][0] * NANOSECONDS)
        # Beside a row or at an end of the run the two sides differ.
        row = np.searchsorted(motion.t_ns, t)
        near = np.minimum(row, len(motion.t_ns) - 1)
        far = (motion.t_ns[near] - t > 2 * step) & (
            t - motion.t_ns[np.maximum(row - 1, 0)] > 2 * step
        )
        span = 2 * step / NANOSECONDS
        speed = (motion.at(t + step) - motion.at(t - step)) / span
        rise = motion.states_at(t + step)[1] - motion.states_at(t - step)[1]
        assert np.max(np.abs(speed - v)[far], initial=0.0) < 1e-6
        assert np.max(np.abs(rise / span - a)[far], initial=0.0) < 1e-4
        checked += int(np.count_nonzero(far))
    assert checked > 100


def test_segments_join_where_nodes_do(case: tuple[RunResult, ExecutionRecord]) -> None:
    run, _ = case
    segments = segments_of(run)
    at_speed = 0
    for chain in run.tpg.chains:
        own = [s for s in segments if s["robot"] == chain.robot]
        stands = np.vstack([chain.start[None], chain.waypoints])
        assert own[-1]["nodes"][1] == len(chain) - 1
        for before, after in zip(own, own[1:], strict=False):
            _, q, v, a = points_of(before)
            _, q_next, v_next, a_next = points_of(after)
            border = stands[chain.first[after["nodes"][0]]]
            assert np.allclose(q[-1], border, rtol=0.0, atol=1e-6)
            assert np.allclose(q[-1], q_next[0], rtol=0.0, atol=1e-9)
            if before["motion_s"][1] == after["motion_s"][0]:
                assert np.array_equal(v[-1], v_next[0])
                assert np.array_equal(a[-1], a_next[0])
                at_speed += bool(np.any(v[-1] != 0.0))
            else:
                assert before["motion_s"][1] < after["motion_s"][0]
                assert np.allclose([v[-1], v_next[0]], 0.0, atol=1e-6)
    assert at_speed > 0


def test_handlings_are_within_the_motion(
    case: tuple[RunResult, ExecutionRecord],
) -> None:
    run, _ = case
    for segment in segments_of(run):
        end = points_of(segment)[0][-1]
        for item in segment["handlings"]:
            t = item["time_from_start"]
            assert 0 <= t["sec"] * NANOSECONDS + t["nanosec"] <= end


@pytest.mark.parametrize("rate_hz", [124.0, 1001.0, float("nan")])
def test_a_rate_that_controllers_do_not_take_is_refused(
    rate_hz: float, case: tuple[RunResult, ExecutionRecord]
) -> None:
    with pytest.raises(OutputError, match="is not from 125 to 1000"):
        exported(case[0], "joint-trajectory", rate_hz=rate_hz)

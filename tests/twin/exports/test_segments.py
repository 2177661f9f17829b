"""Segments hold every waypoint once, and keeping to their order is keeping to the graph."""

import csv
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planning.errors import OutputError
from scheduling.graph.rollout import earliest_times
from tests.twin.driven_toys import driven_tpg
from tests.twin.exports.exported_runs import (
    DISTURBED,
    Toy,
    exported,
    segments_of,
    stamp_ns,
    toy_run,
)
from twin.durations.nanoseconds import NANOSECONDS, to_nanoseconds
from twin.runs.execution_record import ExecutionRecord
from twin.runs.trajectory import Trajectory, robot_trajectories
from twin.trial.run_result import RunResult
from twin.uncertainty.disturbances import Disturbances, EmergencyStop

POINT = {"positions", "velocities", "accelerations", "effort", "time_from_start"}

PERIOD_NS = 4_000_000
"""Of controllers, unless somebody asks for another."""


@pytest.fixture(params=[8, 21])
def case(request: pytest.FixtureRequest, tmp_path: Path) -> Toy:
    return toy_run(tmp_path, request.param)


def test_segments_have_the_shape_of_the_message(case: Toy) -> None:
    run, _ = case
    segments = segments_of(run)
    assert len({s["id"] for s in segments}) == len(segments) > 5
    for segment in segments:
        message = segment["joint_trajectory"]
        assert set(message) == {"header", "joint_names", "points"}
        joints = run.tpg.cell.robot(segment["robot"]).model.joint_names
        assert tuple(message["joint_names"]) == joints
        times = [stamp_ns(p["time_from_start"]) for p in message["points"]]
        assert times[0] == 0
        assert np.min(np.diff(times), initial=PERIOD_NS) >= PERIOD_NS
        for point in message["points"]:
            assert set(point) == POINT
            assert len(point["positions"]) == len(joints)
            assert (
                point["velocities"] == point["accelerations"] == point["effort"] == []
            )


def test_the_points_are_the_path(case: Toy) -> None:
    run, _ = case
    segments = segments_of(run)
    for chain in run.tpg.chains:
        at = chain.start.tolist()
        path: list[list[float]] = []
        node = 0
        for segment in (s for s in segments if s["robot"] == chain.robot):
            points = [p["positions"] for p in segment["joint_trajectory"]["points"]]
            assert points[0] == at
            path += points[1:]
            at = points[-1]
            assert segment["nodes"][0] == node
            node = segment["nodes"][1] + 1
            tasks = chain.task[segment["nodes"][0] : node]
            assert set(tasks.tolist()) == {segment["task"]["index"]}
        assert node == len(chain)
        assert np.array_equal(np.array(path), chain.waypoints)


def test_points_are_when_they_are_planned_but_for_what_is_shorter_than_a_period(
    case: Toy,
) -> None:
    """Never earlier, and later by no more than a period for each point that came too soon."""
    run, _ = case
    for segment in segments_of(run):
        first, last = segment["nodes"]
        chain = next(c for c in run.tpg.chains if c.robot == segment["robot"])
        offset = np.concatenate(
            [
                d * chain.fraction[chain.first[k] : chain.first[k + 1]] + before
                for k, d, before in zip(
                    range(first, last + 1),
                    chain.duration[first : last + 1],
                    np.cumsum(chain.duration[first : last + 1])
                    - chain.duration[first : last + 1],
                    strict=True,
                )
            ]
        )
        points = segment["joint_trajectory"]["points"]
        times = np.array([stamp_ns(p["time_from_start"]) for p in points])[1:]
        late = times - offset * 1e9
        soon = np.cumsum(np.diff(offset * 1e9, prepend=0.0) < PERIOD_NS)
        assert np.all(late >= -2.0)
        assert np.all(late <= soon * PERIOD_NS + 2.0)


def test_whoever_keeps_to_the_order_of_segments_keeps_to_the_graph(case: Toy) -> None:
    """Every segment as early as its ``after`` lets it: the same as the graph's rollout."""
    run, _ = case
    segments = {s["id"]: s for s in segments_of(run)}
    nominal = {
        key: np.rint(np.multiply(s["nominal_s"], 1e9)) for key, s in segments.items()
    }
    length = {key: int(end - begin) for key, (begin, end) in nominal.items()}
    starts: dict[str, int] = {}

    def start(key: str) -> int:
        if key not in starts:
            ends = [
                start(a["segment"]) + length[a["segment"]]
                for a in segments[key]["after"]
            ]
            starts[key] = max(ends, default=0)
        return starts[key]

    durations = [to_nanoseconds(chain.duration) for chain in run.tpg.chains]
    rollout = earliest_times(run.tpg, durations)
    robots = [chain.robot for chain in run.tpg.chains]
    for key, segment in segments.items():
        k = robots.index(segment["robot"])
        first, last = segment["nodes"]
        assert start(key) == rollout.start[k][first]
        assert start(key) + length[key] == rollout.end[k][last]
    causes = {a["cause"] for s in segments.values() for a in s["after"]}
    assert causes == {"same robot", "motion conflict"}


def test_segments_tell_when_they_were_executed(case: Toy) -> None:
    recorded, run = case
    robots = [chain.robot for chain in recorded.tpg.chains]
    for segment in segments_of(recorded):
        k = robots.index(segment["robot"])
        first, last = segment["nodes"]
        begun, done = (
            -1 if t is None else round(t * 1e9) for t in segment["executed_s"]
        )
        assert (begun, done) == (run.start_ns[k][first], run.end_ns[k][last])


def test_objects_change_hands_within_segments(case: Toy) -> None:
    run, _ = case
    told = [h for s in segments_of(run) for h in s["handlings"]]
    assert sorted(h["object"] for h in told) == sorted(
        h.object for h in run.tpg.handlings
    )
    for segment in segments_of(run):
        end = stamp_ns(segment["joint_trajectory"]["points"][-1]["time_from_start"])
        for item in segment["handlings"]:
            assert 0 <= stamp_ns(item["time_from_start"]) <= end


CALM = Disturbances()


@pytest.fixture(
    scope="module",
    params=[(8, CALM), (21, DISTURBED)],
    ids=["calm", "disturbed"],
)
def smooth(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Toy:
    seed, disturbances = request.param
    tpg = driven_tpg(seed, tasks=10, edges=20)
    folder = tmp_path_factory.mktemp("smooth")
    return toy_run(folder, seed, disturbances=disturbances, tpg=tpg)


def motions_of(run: RunResult, record: ExecutionRecord) -> dict[str, Trajectory]:
    return {m.robot: m for m in robot_trajectories(run.tpg, record)}


def points_of(segment: dict[str, Any]) -> tuple[np.ndarray, ...]:
    """Times [ns], positions, velocities and accelerations."""
    points = segment["joint_trajectory"]["points"]
    keys = ("positions", "velocities", "accelerations")
    return (
        np.array([stamp_ns(p["time_from_start"]) for p in points]),
        *(np.array([p[key] for p in points]) for key in keys),
    )


@pytest.mark.parametrize("rate_hz", [125.0, 1000.0])
def test_points_are_the_motion_at_the_rate(rate_hz: float, smooth: Toy) -> None:
    run, record = smooth
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


def test_speeds_and_accelerations_are_derivatives(smooth: Toy) -> None:
    run, record = smooth
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


def test_segments_join_where_nodes_do(smooth: Toy) -> None:
    run, _ = smooth
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


def test_handlings_are_within_the_motion(smooth: Toy) -> None:
    run, _ = smooth
    for segment in segments_of(run):
        end = points_of(segment)[0][-1]
        for item in segment["handlings"]:
            assert 0 <= stamp_ns(item["time_from_start"]) <= end


Rows = list[dict[str, str]]


@pytest.fixture(params=["limits", "full speed"])
def run(request: pytest.FixtureRequest, tmp_path: Path) -> RunResult:
    smooth = request.param == "limits"
    tpg = driven_tpg(8, tasks=10, edges=20) if smooth else None
    return toy_run(tmp_path, 8, tpg=tpg)[0]


def tables_of(run: RunResult, rate_hz: float | None = None) -> dict[str, Rows]:
    files = exported(run, "joint-csv", rate_hz=rate_hz)
    return {
        name.removeprefix("joints_").removesuffix(".csv"): list(
            csv.DictReader(StringIO(data.decode(), newline=""))
        )
        for name, data in files.items()
    }


def numbers(rows: Rows, letter: str) -> list[list[float]]:
    names = [name for name in rows[0] if name.startswith(f"{letter} ")]
    return [[float(row[name]) for name in names if row[name]] for row in rows]


@pytest.mark.parametrize("rate_hz", [None, 125.0])
def test_rows_are_the_points_of_segments(rate_hz: float | None, run: RunResult) -> None:
    tables = tables_of(run, rate_hz)
    assert set(tables) == {chain.robot for chain in run.tpg.chains}
    done = 0
    for segment in segments_of(run, rate_hz):
        rows = [r for r in tables[segment["robot"]] if r["segment"] == segment["id"]]
        points = segment["joint_trajectory"]["points"]
        seconds = [stamp_ns(p["time_from_start"]) * 1e-9 for p in points]
        told = [float(r["time_from_start [s]"]) for r in rows]
        assert told == pytest.approx(seconds, abs=1e-12)
        for letter, key in zip(
            "qva", ("positions", "velocities", "accelerations"), strict=True
        ):
            assert numbers(rows, letter) == [p[key] for p in points]
        done += len(rows)
    assert done == sum(map(len, tables.values()))


def test_columns_name_joints_and_units(run: RunResult) -> None:
    smooth = bool(run.smooth_motions)
    for robot, rows in tables_of(run).items():
        model = run.tpg.cell.robot(robot).model
        names = list(rows[0])
        assert names[:2] == ["segment", "time_from_start [s]"]
        assert names[-2:] == ["after", "handlings"]
        units = {"q": "", "v": "/s", "a": "/s^2"}
        wanted = [
            f"{letter} {joint} [{'m' if slides else 'rad'}{per}]"
            for letter, per in units.items()
            if smooth or letter == "q"
            for joint, slides in zip(
                model.joint_names, model.chain.prismatic, strict=True
            )
        ]
        assert names[2:-2] == wanted


def test_the_first_row_of_a_segment_says_what_it_waits_for(run: RunResult) -> None:
    tables = tables_of(run)
    causes = set()
    for segment in segments_of(run):
        rows = [r for r in tables[segment["robot"]] if r["segment"] == segment["id"]]
        said = [
            part.removesuffix(")").split(" (")
            for part in rows[0]["after"].split("; ")
            if part
        ]
        assert said == [[a["segment"], a["cause"]] for a in segment["after"]]
        causes |= {cause for _, cause in said}
        assert len(rows[0]["handlings"].split("; ")) == max(
            len(segment["handlings"]), 1
        )
        for item in segment["handlings"]:
            t = stamp_ns(item["time_from_start"]) * 1e-9
            whom = f"to {item['holder']}" if item["holder"] else "at rest"
            assert f"{item['object']} {whom} at {t:g} s" in rows[0]["handlings"]
        assert all(not row["after"] and not row["handlings"] for row in rows[1:])
    assert causes == {"same robot", "motion conflict"}


def test_speeds_are_known_where_robots_keep_to_limits(run: RunResult) -> None:
    smooth = bool(run.smooth_motions)
    for rows in tables_of(run).values():
        speeds = numbers(rows, "v")
        assert smooth == bool(speeds and speeds[0])
        assert not smooth or np.max(np.abs(np.array(speeds))) > 0.1


@pytest.mark.parametrize("name", ["joint-trajectory", "joint-csv"])
@pytest.mark.parametrize("rate_hz", [50.0, 124.0, 1001.0, float("nan")])
def test_a_rate_that_controllers_do_not_take_is_refused(
    run: RunResult, name: str, rate_hz: float
) -> None:
    with pytest.raises(OutputError, match=f"{rate_hz:g} is not from 125 to 1000"):
        exported(run, name, rate_hz=rate_hz)

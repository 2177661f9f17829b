"""Segments hold every waypoint once, and keeping to their order is keeping to the graph."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scheduling.graph.dispatcher import earliest_times
from tests.twin.exports.exported_runs import exported, toy_run
from twin.durations.model import to_nanoseconds
from twin.run.events import ExecutionRecord
from twin.trial.run_result import RunResult

POINT = {"positions", "velocities", "accelerations", "effort", "time_from_start"}

PERIOD_NS = 4_000_000
"""Of controllers, unless somebody asks for another."""


@pytest.fixture(params=[3, 8, 21])
def case(
    request: pytest.FixtureRequest, tmp_path: Path
) -> tuple[RunResult, ExecutionRecord]:
    return toy_run(tmp_path, request.param)


def segments_of(run: RunResult) -> list[dict[str, Any]]:
    document = json.loads(exported(run, "joint-trajectory")["joint_trajectories.json"])
    assert document["format"] == "assembly-twin joint trajectories"
    found: list[dict[str, Any]] = document["segments"]
    return found


def nanoseconds(stamp: dict[str, int]) -> int:
    assert set(stamp) == {"sec", "nanosec"}
    assert 0 <= stamp["nanosec"] < 10**9
    return stamp["sec"] * 10**9 + stamp["nanosec"]


def of_robot(segments: list[dict[str, Any]], robot: str) -> Iterator[dict[str, Any]]:
    return (s for s in segments if s["robot"] == robot)


def test_segments_have_the_shape_of_the_message(
    case: tuple[RunResult, ExecutionRecord],
) -> None:
    run, _ = case
    segments = segments_of(run)
    assert len({s["id"] for s in segments}) == len(segments) > 5
    for segment in segments:
        message = segment["joint_trajectory"]
        assert set(message) == {"header", "joint_names", "points"}
        joints = run.tpg.cell.robot(segment["robot"]).model.joint_names
        assert tuple(message["joint_names"]) == joints
        times = [nanoseconds(p["time_from_start"]) for p in message["points"]]
        assert times[0] == 0
        assert np.min(np.diff(times), initial=PERIOD_NS) >= PERIOD_NS
        for point in message["points"]:
            assert set(point) == POINT
            assert len(point["positions"]) == len(joints)
            assert (
                point["velocities"] == point["accelerations"] == point["effort"] == []
            )


def test_the_points_are_the_path(case: tuple[RunResult, ExecutionRecord]) -> None:
    run, _ = case
    segments = segments_of(run)
    for chain in run.tpg.chains:
        at = chain.start.tolist()
        path: list[list[float]] = []
        node = 0
        for segment in of_robot(segments, chain.robot):
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
    case: tuple[RunResult, ExecutionRecord],
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
        times = np.array([nanoseconds(p["time_from_start"]) for p in points])[1:]
        late = times - offset * 1e9
        soon = np.cumsum(np.diff(offset * 1e9, prepend=0.0) < PERIOD_NS)
        assert np.all(late >= -2.0)
        assert np.all(late <= soon * PERIOD_NS + 2.0)


def test_whoever_keeps_to_the_order_of_segments_keeps_to_the_graph(
    case: tuple[RunResult, ExecutionRecord],
) -> None:
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


def test_segments_tell_when_they_were_executed(
    case: tuple[RunResult, ExecutionRecord],
) -> None:
    recorded, run = case
    robots = [chain.robot for chain in recorded.tpg.chains]
    for segment in segments_of(recorded):
        k = robots.index(segment["robot"])
        first, last = segment["nodes"]
        begun, done = (
            -1 if t is None else round(t * 1e9) for t in segment["executed_s"]
        )
        assert (begun, done) == (run.start_ns[k][first], run.end_ns[k][last])


def test_objects_change_hands_within_segments(
    case: tuple[RunResult, ExecutionRecord],
) -> None:
    run, _ = case
    told = [h for s in segments_of(run) for h in s["handlings"]]
    assert sorted(h["object"] for h in told) == sorted(
        h.object for h in run.tpg.handlings
    )
    for segment in segments_of(run):
        end = nanoseconds(segment["joint_trajectory"]["points"][-1]["time_from_start"])
        for item in segment["handlings"]:
            assert 0 <= nanoseconds(item["time_from_start"]) <= end

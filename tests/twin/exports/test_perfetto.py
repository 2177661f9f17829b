"""The trace is what the format of trace events asks for, and tells the run exactly."""

from __future__ import annotations

import json
from collections import defaultdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.twin.exports.exported_runs import exported, toy_run
from twin.run.activities import STANDING
from twin.run.events import ExecutionRecord
from twin.trial.run_result import RunResult

REQUIRED = {
    "M": {"name", "pid", "tid", "args"},
    "X": {"name", "cat", "ts", "dur", "pid", "tid", "args"},
    "s": {"name", "cat", "id", "ts", "pid", "tid"},
    "f": {"name", "cat", "id", "ts", "pid", "tid", "bp"},
    "i": {"name", "cat", "s", "ts", "pid", "tid", "args"},
}
TYPES = {
    "name": str,
    "cat": str,
    "ts": (int, float),
    "dur": (int, float),
    "pid": int,
    "tid": int,
    "id": int,
    "args": dict,
    "bp": str,
    "s": str,
    "ph": str,
}

Trace = dict[str, list[dict[str, Any]]]


def read_trace(content: bytes) -> Trace:
    """Return the events of a trace by phase, each with exactly the keys that it must have."""
    document = json.loads(content, parse_constant=pytest.fail)
    assert document["displayTimeUnit"] in ("ms", "ns")
    out: Trace = defaultdict(list)
    for event in document["traceEvents"]:
        assert set(event) == REQUIRED[event["ph"]] | {"ph"}
        for key, value in event.items():
            assert isinstance(value, TYPES[key]), (key, value)
            assert not isinstance(value, bool)
        assert event.get("ts", 0) >= 0
        out[event["ph"]].append(event)
    return out


@pytest.fixture
def case(tmp_path: Path) -> tuple[RunResult, ExecutionRecord]:
    return toy_run(tmp_path)


@pytest.mark.parametrize("nodes", [False, True])
def test_every_robot_has_a_lane_without_overlaps(
    case: tuple[RunResult, ExecutionRecord], nodes: bool
) -> None:
    recorded, run = case
    trace = read_trace(exported(recorded, "perfetto", nodes=nodes)["trace.json"])
    names = {
        e["tid"]: e["args"]["name"] for e in trace["M"] if e["name"] == "thread_name"
    }
    assert sorted(names.values()) == ["robot_0", "robot_1"]
    for k, chain in enumerate(recorded.tpg.chains):
        tid = next(t for t, name in names.items() if name == chain.robot)
        lane = sorted((e for e in trace["X"] if e["tid"] == tid), key=lambda e: e["ts"])
        for before, after in pairwise(lane):
            assert round(1000 * (before["ts"] + before["dur"])) == round(
                1000 * after["ts"]
            )
        assert round(1000 * (lane[-1]["ts"] + lane[-1]["dur"])) == run.end_ns[k][-1]
        waits = sum(e["dur"] for e in lane if e["cat"] == "waiting")
        stopped = [e for e in lane if e["cat"] == "stopped"]
        longest = sum(high - low for low, high in run.stops_ns[k])
        assert round(1000 * sum(e["dur"] for e in stopped)) <= longest
        moving = sum(e["dur"] for e in lane if e["cat"] not in STANDING)
        assert round(1000 * moving) == run.duration_ns[k].sum()
        assert waits > 0 or not any(w.chain == k for w in run.waits())
    assert len(trace["X"]) > (40 if nodes else 10)


def test_arrows_join_the_nodes_of_every_edge(
    case: tuple[RunResult, ExecutionRecord],
) -> None:
    recorded, run = case
    trace = read_trace(exported(recorded, "perfetto")["trace.json"])
    starts = {e["id"]: e for e in trace["s"]}
    ends = {e["id"]: e for e in trace["f"]}
    edges = recorded.tpg.edges.tolist()
    assert len(edges) > 5
    assert set(starts) == set(ends) == set(range(len(edges)))
    assert len(trace["s"]) == len(trace["f"]) == len(edges)
    for number, (a, n, b, m) in enumerate(edges):
        first, last = starts[number], ends[number]
        assert (first["tid"], last["tid"]) == (a + 1, b + 1)
        assert first["ts"] <= last["ts"]
        assert last["bp"] == "e"
        assert round(1000 * last["ts"]) == run.start_ns[b][m]
        assert run.end_ns[a][n] - round(1000 * first["ts"]) in (0, 1)
        for event in (first, last):
            around = [
                e
                for e in trace["X"]
                if e["tid"] == event["tid"]
                and e["ts"] <= event["ts"] <= e["ts"] + e["dur"]
            ]
            assert around


def test_objects_that_change_hands_are_marked(
    case: tuple[RunResult, ExecutionRecord],
) -> None:
    recorded, _ = case
    trace = read_trace(exported(recorded, "perfetto")["trace.json"])
    told = [e for e in recorded.history if e.kind in ("attached", "detached")]
    assert len(told) == 2
    marks = [e for e in trace["i"] if e["cat"] in ("attached", "detached")]
    assert [round(1000 * e["ts"]) for e in marks] == [e.t_ns for e in told]
    assert [e["name"] for e in marks] == [f"{e.kind} brick_0" for e in told]


def test_a_run_that_was_killed_has_a_trace_of_what_happened(tmp_path: Path) -> None:
    recorded, run = toy_run(tmp_path)
    log = tmp_path / "events.jsonl"
    lines = log.read_text().splitlines(keepends=True)
    log.write_text("".join(lines[: len(lines) // 2]))
    (tmp_path / "summary.json").unlink()
    half = RunResult(tmp_path)
    half.__dict__["tpg"] = recorded.tpg
    trace = read_trace(exported(half, "perfetto")["trace.json"])
    last_ns = half.history[-1].t_ns
    assert max(round(1000 * (e["ts"] + e["dur"])) for e in trace["X"]) == last_ns
    assert last_ns < run.makespan_ns
    done = sum(np.count_nonzero(end >= 0) for _, end in half.node_times_ns)
    assert done == sum(e.kind == "completed" for e in half.history)
    assert len(trace["s"]) == len(trace["f"]) < len(recorded.tpg.edges)

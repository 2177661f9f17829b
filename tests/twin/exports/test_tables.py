"""CSV, Parquet and traces say exactly what the log and the tables of the run say."""

import csv
import json
from collections import defaultdict
from decimal import Decimal
from io import BytesIO, StringIO
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.csv
import pyarrow.parquet as pq
import pytest

from tests.twin.exports.exported_runs import Toy, exported, toy_run
from twin.activities.activities import STANDING
from twin.runs.events import Event, event_line
from twin.trial.run_result import RunResult

KEYS = ["t_s", "robot", "kind", "task", "node", "object", "detail"]


@pytest.fixture
def run(tmp_path: Path) -> RunResult:
    return toy_run(tmp_path)[0]


def rows_of(content: bytes) -> list[dict[str, str]]:
    return list(csv.DictReader(StringIO(content.decode("utf-8")), strict=True))


def test_csv_holds_every_event_exactly(run: RunResult) -> None:
    rows = rows_of(exported(run, "csv")["events.csv"])
    lines = (run.files / "events.jsonl").read_text().splitlines()
    assert len(rows) == len(lines) > 50
    assert list(rows[0]) == KEYS
    for row, line in zip(rows, lines, strict=True):
        event = json.loads(line, parse_float=Decimal)
        assert Decimal(repr(float(row["t_s"]))) == event["t_s"]
        assert [row[k] for k in KEYS[1:]] == [str(event[k]) for k in KEYS[1:]]


def test_csv_holds_the_tables_exactly(run: RunResult) -> None:
    files = exported(run, "csv")
    moves = pq.read_table(run.files / "trajectory.parquet").to_pylist()
    rows = rows_of(files["trajectory.csv"])
    assert list(rows[0]) == list(moves[0])
    for row, move in zip(rows, moves, strict=True):
        for key, value in move.items():
            given = row[key]
            assert value == (
                None if given == "" else given if key == "robot" else type(value)(given)
            )
    assert any(row["q_2"] == "" for row in rows)  # a robot with a joint less
    placed = pq.read_table(run.files / "objects.parquet").to_pylist()
    rows = rows_of(files["objects.csv"])
    assert list(rows[0]) == ["t_s", "object", "parent", *"xyz", "qw", "qx", "qy", "qz"]
    for row, place in zip(rows, placed, strict=True):
        assert [float(row[k]) for k in "xyz"] == place["xyz"]
        assert [float(row[f"q{k}"]) for k in "wxyz"] == place["quat_wxyz"]
        assert (row["object"], row["parent"]) == (place["object"], place["parent"])


def test_csv_is_read_by_arrow_with_the_same_types(run: RunResult) -> None:
    files = exported(run, "csv")
    table = pyarrow.csv.read_csv(BytesIO(files["trajectory.csv"]))
    moves = pq.read_table(run.files / "trajectory.parquet")
    assert table.column_names == moves.column_names
    for name in table.column_names:
        assert table.column(name).to_pylist() == moves.column(name).to_pylist()


def test_parquet_comes_back_as_it_was(run: RunResult) -> None:
    files = exported(run, "parquet")
    for name in ("trajectory", "objects"):
        source = pq.read_table(run.files / f"{name}.parquet")
        found = pq.read_table(BytesIO(files[f"{name}.parquet"]))
        assert found.equals(source)
        assert found.schema.metadata[b"scenario"] == b'toy: "run"'
        assert found.schema.metadata[b"policy"] == b"asynchronous"
    events = pq.read_table(BytesIO(files["events.parquet"])).to_pylist()
    lines = [
        event_line(Event(round(e.pop("t_s") * 10**9), **e)) for e in map(dict, events)
    ]
    assert "".join(lines) == (run.files / "events.jsonl").read_text()


def test_texts_with_commas_quotes_and_line_ends_survive(run: RunResult) -> None:
    detail = 'a, "b"\nc'
    log = run.files / "events.jsonl"
    log.write_text(event_line(Event(1, "robot_0", "waiting", 0, 0, "", detail)))
    assert rows_of(exported(run, "csv")["events.csv"])[0]["detail"] == detail


def test_a_torn_last_line_is_left_out(run: RunResult) -> None:
    log = run.files / "events.jsonl"
    whole = log.read_text()
    log.write_text(whole[:-20])
    count = len(rows_of(exported(run, "csv")["events.csv"]))
    assert count == whole.count("\n") - 1


REQUIRED = {
    "M": {"name", "pid", "tid", "args"},
    "X": {"name", "cat", "ts", "dur", "pid", "tid", "args"},
    "s": {"name", "cat", "id", "ts", "pid", "tid"},
    "f": {"name", "cat", "id", "ts", "pid", "tid", "bp"},
    "i": {"name", "cat", "s", "ts", "pid", "tid", "args"},
}
TYPES: dict[str, type | tuple[type, ...]] = {
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
def case(tmp_path: Path) -> Toy:
    return toy_run(tmp_path)


@pytest.mark.parametrize("nodes", [False, True])
def test_every_robot_has_a_lane_without_overlaps(case: Toy, nodes: bool) -> None:
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


def test_arrows_join_the_nodes_of_every_edge(case: Toy) -> None:
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


def test_objects_that_change_hands_are_marked(case: Toy) -> None:
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

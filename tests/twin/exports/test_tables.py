"""CSV and Parquet say exactly what the log and the tables of the run say."""

from __future__ import annotations

import csv
import json
from decimal import Decimal
from io import BytesIO, StringIO
from pathlib import Path

import pyarrow.csv
import pyarrow.parquet as pq
import pytest

from tests.twin.exports.exported_runs import exported, toy_run
from twin.run.events import Event, event_line
from twin.trial.run_result import RunResult

KEYS = ["t_s", "robot", "kind", "task", "node", "object", "detail"]


@pytest.fixture
def run(tmp_path: Path) -> RunResult:
    return toy_run(tmp_path)[0]


def rows_of(content: bytes) -> list[dict[str, str]]:
    return list(csv.DictReader(StringIO(content.decode("utf-8")), strict=True))


def test_csv_holds_every_event_exactly(run: RunResult) -> None:
    rows = rows_of(exported(run, "csv")["events.csv"])
    lines = (run.folder / "events.jsonl").read_text().splitlines()
    assert len(rows) == len(lines) > 50
    assert list(rows[0]) == KEYS
    for row, line in zip(rows, lines, strict=True):
        event = json.loads(line, parse_float=Decimal)
        assert Decimal(repr(float(row["t_s"]))) == event["t_s"]
        assert [row[k] for k in KEYS[1:]] == [str(event[k]) for k in KEYS[1:]]


def test_csv_holds_the_tables_exactly(run: RunResult) -> None:
    files = exported(run, "csv")
    moves = pq.read_table(run.folder / "trajectory.parquet").to_pylist()
    rows = rows_of(files["trajectory.csv"])
    assert list(rows[0]) == list(moves[0])
    for row, move in zip(rows, moves, strict=True):
        for key, value in move.items():
            given = row[key]
            assert value == (
                None if given == "" else given if key == "robot" else type(value)(given)
            )
    assert any(row["q_2"] == "" for row in rows)  # a robot with a joint less
    placed = pq.read_table(run.folder / "objects.parquet").to_pylist()
    rows = rows_of(files["objects.csv"])
    assert list(rows[0]) == ["t_s", "object", "parent", *"xyz", "qw", "qx", "qy", "qz"]
    for row, place in zip(rows, placed, strict=True):
        assert [float(row[k]) for k in "xyz"] == place["xyz"]
        assert [float(row[f"q{k}"]) for k in "wxyz"] == place["quat_wxyz"]
        assert (row["object"], row["parent"]) == (place["object"], place["parent"])


def test_csv_is_read_by_arrow_with_the_same_types(run: RunResult) -> None:
    files = exported(run, "csv")
    table = pyarrow.csv.read_csv(BytesIO(files["trajectory.csv"]))
    moves = pq.read_table(run.folder / "trajectory.parquet")
    assert table.column_names == moves.column_names
    for name in table.column_names:
        assert table.column(name).to_pylist() == moves.column(name).to_pylist()


def test_parquet_comes_back_as_it_was(run: RunResult) -> None:
    files = exported(run, "parquet")
    for name in ("trajectory", "objects"):
        source = pq.read_table(run.folder / f"{name}.parquet")
        found = pq.read_table(BytesIO(files[f"{name}.parquet"]))
        assert found.equals(source)
        assert found.schema.metadata[b"scenario"] == b'toy: "run"'
        assert found.schema.metadata[b"policy"] == b"asynchronous"
    events = pq.read_table(BytesIO(files["events.parquet"])).to_pylist()
    lines = [
        event_line(Event(round(e.pop("t_s") * 10**9), **e)) for e in map(dict, events)
    ]
    assert "".join(lines) == (run.folder / "events.jsonl").read_text()


def test_texts_with_commas_quotes_and_line_ends_survive(run: RunResult) -> None:
    detail = 'a, "b"\nc'
    log = run.folder / "events.jsonl"
    log.write_text(event_line(Event(1, "robot_0", "waiting", 0, 0, "", detail)))
    assert rows_of(exported(run, "csv")["events.csv"])[0]["detail"] == detail


def test_a_torn_last_line_is_left_out(run: RunResult) -> None:
    log = run.folder / "events.jsonl"
    whole = log.read_text()
    log.write_text(whole[:-20])
    count = len(rows_of(exported(run, "csv")["events.csv"]))
    assert count == whole.count("\n") - 1

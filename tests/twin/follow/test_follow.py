"""Follow a run in progress: a file that grows, a pipe, torn lines, what is seen of it."""

import io
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest
from rerun.chunk import RrdReader
from rich.console import Console

from planning.errors import OutputError
from scheduling.graph.plan_files import load_plan
from tests.twin.drawn_runs import VARIED
from tests.twin.program import invoke
from tests.twin.recorders.transform_chains import broken_chains
from tests.twin.simulated import NOMINAL, watched
from tests.twin.turning_arms import SCENARIO, planned_arms, run_arms
from tests.twin.twin_toys import random_tpg, two_robot_tpg
from tests.twin.written import written
from twin.engine.execution_model import ExecutionModel
from twin.follow.display import TerminalDisplay, news_to_json, news_to_sentence
from twin.follow.follow import Silence, follow
from twin.follow.forecast import Forecaster
from twin.follow.log_lines import lines_of_growing_file, lines_of_pipe
from twin.follow.state import FollowedRun
from twin.runs.events import EventLogError, event_line

ROOT = Path(__file__).parents[3]
TPG = random_tpg(16, tasks=14, edges=12)
LINES = [event_line(event) for event in watched(TPG, VARIED)[1]]


def followed(
    lines: Iterator[str | None], every_s: float = 5.0
) -> tuple[FollowedRun, list[Any]]:
    out: list[str] = []
    run = FollowedRun(TPG)
    follow(
        lines,
        run,
        Forecaster(TPG, ExecutionModel(VARIED), samples=20),
        [lambda news: out.append(news_to_json(news))],
        every_s=every_s,
    )
    return run, [json.loads(line) for line in out if line]


# Where lines come from


def test_a_file_is_followed_while_it_grows(tmp_path: Path) -> None:
    """It appears late, and is written in pieces that end in the middle of lines."""
    path = tmp_path / "events.jsonl"
    content = "".join(LINES).encode()

    def write() -> None:
        time.sleep(0.05)
        with path.open("wb", buffering=0) as file:
            for k in range(0, len(content), 997):
                file.write(content[k : k + 997])
                time.sleep(0.002)

    writer = threading.Thread(target=write)
    writer.start()
    waits = 0

    def lines() -> Iterator[str | None]:
        nonlocal waits
        for line in lines_of_growing_file(path, poll_s=0.003):
            waits += line is None
            yield line

    run, seen = followed(lines())
    writer.join()
    assert waits > 3
    assert run.outcome == "completed"
    assert run.events == len(LINES)
    assert not run.violations
    assert seen[-1]["kind"] == "end"


def test_a_torn_last_line_is_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    path.write_text("".join(LINES[:5]) + LINES[5][:20])
    assert list(lines_of_growing_file(path, wait=False)) == [s[:-1] for s in LINES[:5]]
    stream = io.BytesIO(path.read_bytes())
    assert [s for s in lines_of_pipe(stream) if s is not None] == [
        s[:-1] for s in LINES[:5]
    ]


def test_a_file_that_shrinks_or_is_not_there_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    with pytest.raises(OutputError, match="no such file"):
        list(lines_of_growing_file(path, wait=False))
    path.write_text("".join(LINES[:5]))
    lines = lines_of_growing_file(path, poll_s=0.001)
    assert [next(lines) for _ in range(6)][-1] is None
    path.write_text(LINES[0])
    with pytest.raises(OutputError, match="has become shorter"):
        next(lines)


def test_a_longer_file_in_its_place_is_another_run(tmp_path: Path) -> None:
    path, longer = tmp_path / "events.jsonl", tmp_path / "next.jsonl"
    path.write_text("".join(LINES[:5]))
    longer.write_text("".join(LINES))
    lines = lines_of_growing_file(path, poll_s=0.001)
    assert [next(lines) for _ in range(6)][-1] is None
    longer.replace(path)
    with pytest.raises(OutputError, match="another run began"):
        next(lines)


# What is made of them


def test_there_is_a_forecast_for_every_step_of_time() -> None:
    run, seen = followed(iter([line[:-1] for line in LINES]))
    forecasts = [entry for entry in seen if entry["kind"] == "forecast"]
    end = run.now_ns / 1e9
    times = [entry["t_s"] for entry in forecasts]
    assert times[0] == 0.0
    assert all(t % 5.0 == pytest.approx(0.0) or t in times for t in times)
    assert max(b - a for a, b in zip(times, [*times[1:], end], strict=True)) < 10.0
    assert forecasts[-1]["p50_s"] == pytest.approx(end, rel=0.1)
    for entry in forecasts:
        assert entry["p50_s"] <= entry["p90_s"]
        assert entry["remaining_p50_s"] == pytest.approx(entry["p50_s"] - entry["t_s"])
    assert seen[-1] == {
        "kind": "end",
        "t_s": end,
        "outcome": "completed",
        "events": len(LINES),
        "violations": 0,
        "nodes_done": sum(len(chain) for chain in TPG.chains),
    }


def test_time_goes_on_while_nothing_is_heard() -> None:
    """The clock says 3 s more each time it is asked; the run began and then fell silent."""
    tpg = two_robot_tpg([])
    out: list[str] = []
    now = iter(range(0, 1000, 3))
    lines = iter(
        ['{"t_s": 0, "robot": "robot_0", "kind": "started", "node": 0}', None, None]
    )
    run = FollowedRun(tpg)
    follow(
        lines,
        run,
        Forecaster(tpg, ExecutionModel(NOMINAL), samples=2),
        [lambda news: out.append(news_to_json(news))],
        every_s=1.0,
        clock=lambda: float(next(now)),
    )
    forecasts = [
        e for e in map(json.loads, filter(None, out)) if e["kind"] == "forecast"
    ]
    assert [entry["t_s"] for entry in forecasts] == [0.0, 3.0, 6.0]
    # A node of 1 s that is not complete after 6 s can be so at once; 2 s are to come.
    assert [entry["p50_s"] for entry in forecasts] == [3.0, 6.0, 9.0]


def test_lines_that_are_no_events_are_told_of_and_passed_over() -> None:
    lines = [line[:-1] for line in LINES]
    lines.insert(3, "what?")
    lines.insert(5, "")
    run, seen = followed(iter(lines))
    assert run.outcome == "completed"
    (entry,) = [e for e in seen if e["kind"] == "unreadable"]
    assert entry["line"] == 4
    assert "not JSON" in entry["text"]


def test_pictures_say_what_every_robot_does() -> None:
    tpg = two_robot_tpg([(0, 1, 1, 0)])
    out = io.StringIO()
    console = Console(file=out, width=120, force_terminal=True, color_system=None)
    run = FollowedRun(tpg)
    display = TerminalDisplay(run, "toy", console)
    plain: list[str] = []
    lines = [
        '{"t_s": 0, "robot": "robot_0", "kind": "started", "node": 0, "task": 0}',
        '{"t_s": 0.5, "robot": "robot_0", "kind": "stalled", "node": 0, "task": 0}',
        '{"t_s": 0.6, "robot": "robot_1", "kind": "started", "node": 0, "task": 1}',
        "nonsense",
    ]
    follow(
        iter(lines),
        run,
        Forecaster(tpg, ExecutionModel(NOMINAL), samples=2),
        [display, lambda news: plain.append(news_to_sentence(news))],
    )
    text = out.getvalue()
    assert "stalled in transit 0" in text
    assert "forbidden: 0.600 s: robot_1 started node 0" in text
    assert "line 4 is no event: not JSON" in text
    assert "ends at 5.0 s (P50), 5.0 s (P90)" in text
    assert plain[-1].endswith("0 of 6 nodes, 1 forbidden events")
    fresh = FollowedRun(tpg)
    display = TerminalDisplay(fresh, "toy", console)
    display(Silence(9.0))
    display(fresh)
    assert "waits for node 1 of robot_0 (transit 0)" in out.getvalue()
    assert "no event for 9 s" in out.getvalue()
    assert EventLogError("x", line="x").args


# The command


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of two GP4, each of which turns aside."""
    stalls = "  stalls: {count_per_robot: 1, duration_s: [2, 3]}\n"
    return run_arms(planned_arms(tmp_path_factory.mktemp("plan"), stalls))


def test_the_command_follows_a_log_to_its_end(run_folder: Path) -> None:
    log = run_folder / "events.jsonl"
    result = invoke("follow", run_folder, log, "--json", "--every", 1, code=0)
    seen = [json.loads(line) for line in result.stdout.splitlines()]
    makespan = json.loads((run_folder / "summary.json").read_text())["makespan_s"]
    assert (seen[-1]["outcome"], seen[-1]["t_s"]) == ("completed", makespan)
    forecasts = [entry for entry in seen if entry["kind"] == "forecast"]
    assert len(forecasts) >= 5
    first = forecasts[0]
    assert first["p50_s"] == pytest.approx(makespan, rel=0.3)
    assert forecasts[-1]["p50_s"] == pytest.approx(makespan, rel=0.15)
    plain = invoke("follow", run_folder, log)
    assert "(P90)" in plain.stdout
    assert "completed" in plain.stdout


def test_the_command_reads_a_pipe_and_flags_what_is_forbidden(
    run_folder: Path, tmp_path: Path
) -> None:
    lines = (run_folder / "events.jsonl").read_text().splitlines(keepends=True)
    started = [k for k, line in enumerate(lines) if '"started"' in line]
    del lines[started[2]]
    done = subprocess.run(
        [sys.executable, "-m", "twin.cli", "follow", str(run_folder), "-", "--json"],
        input="".join(lines) + '{"t_s": 9',
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert done.returncode == 1, done.stderr
    seen = [json.loads(line) for line in done.stdout.splitlines()]
    (found,) = [entry for entry in seen if entry["kind"] == "violation"]
    assert "has not started" in found["text"]
    assert seen[-1]["outcome"] == "completed"


def test_the_command_ends_with_what_there_is(run_folder: Path, tmp_path: Path) -> None:
    log = tmp_path / "events.jsonl"
    content = (run_folder / "events.jsonl").read_text()
    log.write_text(content[: len(content) // 2])
    result = invoke("follow", run_folder, log, "--once", "--json", code=0)
    last = json.loads(result.stdout.splitlines()[-1])
    assert last["outcome"] is None
    assert 0 < last["nodes_done"] < 24
    invoke("follow", run_folder, tmp_path / "none.jsonl", "--once", code=2)


def test_a_scenario_for_other_robots_is_refused(
    run_folder: Path, tmp_path: Path
) -> None:
    other = written(tmp_path, SCENARIO, ("name: right", "name: east"))
    log = run_folder / "events.jsonl"
    result = invoke("follow", run_folder, log, "--scenario", other, code=2)
    assert "is for robots left, right" in result.stderr


def test_the_recording_holds_motion_forecasts_and_events(
    run_folder: Path, tmp_path: Path
) -> None:
    path = tmp_path / "follow.rrd"
    log = run_folder / "events.jsonl"
    invoke("follow", run_folder, log, "--recording", path, "--every", 1, code=0)
    assert len(list(RrdReader(path).blueprints())) == 1
    assert broken_chains(path) == []
    makespan = json.loads((run_folder / "summary.json").read_text())["makespan_s"]
    rows: dict[str, list[int]] = {}
    for chunk in RrdReader(path).store().stream().filter(has_timeline="sim_time"):
        times = chunk.to_record_batch().column("sim_time").cast(pa.int64()).to_pylist()
        rows.setdefault(chunk.entity_path, []).extend(times)
    assert len(rows["/forecast/P50"]) == len(rows["/forecast/P90"]) >= 5
    assert len(rows["/events"]) == len(log.read_text().splitlines())
    joint = load_plan(run_folder).cell.robots[0].model.joint_names[0]
    moved = rows[f"/robot-left/joints/{joint}"]
    assert moved == sorted(moved)
    assert 0.5 * makespan < max(moved) / 1e9 <= makespan
    assert "/lanes/left" in rows


def test_a_log_that_calls_an_unfinished_run_completed_is_not_believed() -> None:
    line = '{"t_s": 47, "robot": "", "kind": "finished", "detail": "completed"}'
    run, seen = followed(iter([line]))
    assert run.outcome == "incomplete"
    assert len(run.violations) == 1
    assert "nodes are not complete" in run.violations[0].text
    assert seen[-1]["outcome"] == "incomplete"

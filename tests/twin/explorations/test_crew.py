"""Processes that die or hang cost the design that they were at, and nothing else."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.twin.explorations.bench import setting_of, told
from tests.twin.explorations.sliders import LEFT, slider_file
from tests.twin.program import invoke
from twin.explorations.crew import Crew, DesignTask, evaluate_in_parallel
from twin.explorations.journal import JOURNAL, Journal


class Dies(dict[str, Any]):
    """Changes that kill the process that looks at them."""

    def __bool__(self) -> bool:
        os._exit(7)


class Hangs(dict[str, Any]):
    """Changes at which a process looks for ever."""

    def __bool__(self) -> bool:
        time.sleep(1000)
        return True


@pytest.mark.nightly
def test_a_design_that_kills_or_holds_its_process_is_refused(tmp_path: Path) -> None:
    setting = setting_of(slider_file(tmp_path))
    tasks = [
        DesignTask(0, Dies()),
        DesignTask(1, {}),
        DesignTask(2, Hangs()),
        DesignTask(3, {LEFT: 0.2}),
        DesignTask(4, {"cell.robots.left.model": "no-such-model"}),
    ]
    with Crew(setting, 1, 20.0) as crew:
        found = {task.number: done for task, done in evaluate_in_parallel(tasks, crew)}
    assert found[0].reason == "its process died (exit code 7)"
    assert found[2].reason == "not done within 20 s"
    assert {found[0].rung, found[2].rung, found[4].rung} == {"check"}
    assert "no-such-model" in found[4].reason
    assert found[1].outcome == found[3].outcome == "done"
    assert found[1].goals[0] > found[3].goals[0] - 1e-9


@pytest.mark.nightly
def test_a_program_that_is_killed_twenty_times_has_lost_nothing(tmp_path: Path) -> None:
    """Killed at drawn moments: as it begins, as it writes, as finalists are replicated."""
    rng = np.random.default_rng(20)
    moments = [(int(rng.integers(0, 4)), float(rng.uniform(0, 1))) for _ in range(20)]
    kill_and_go_on(tmp_path, 40, moments)


def kill_and_go_on(
    folder: Path, designs: int, moments: Sequence[tuple[int, float]]
) -> None:
    """Compare an exploration that is killed again and again with one that is not.

    Args:
        folder: for both.
        designs: of each.
        moments: after so many more lines of the journal, and so much later [s], it is killed.
    """
    file, whole, parts = slider_file(folder), folder / "whole", folder / "parts"
    count = ("--designs", str(designs), "--workers", "1")
    program = (sys.executable, "-m", "twin.cli", "explore")
    subprocess.run([*program, str(file), *count, "--out", str(whole), "-q"], check=True)
    first: tuple[str, ...] = (str(file), "--out", str(parts), "-q")
    seen: list[bytes] = []
    for more, later_s in moments:
        process = subprocess.Popen([*program, *first, *count])
        wait_for(parts, len(seen) + more, process)
        time.sleep(later_s)
        process.kill()
        process.wait()
        if (parts / JOURNAL).exists():
            now = (parts / JOURNAL).read_bytes().splitlines()
            assert now[: len(seen)] == seen, "what was written stays"
            seen = now
        if (parts / "manifest.json").exists():
            first = ("--resume", str(parts), "-q")
    subprocess.run([*program, *first, *count], check=True)
    assert told(parts) == told(whole)
    keys = [(line["purpose"], line["design"]) for line in told(parts)]
    assert len(set(keys)) == len(keys)
    summaries = [json.loads((p / "summary.json").read_text()) for p in (parts, whole)]
    for summary in summaries:
        del summary["rungs"]  # seconds
    assert summaries[0] == summaries[1]


def wait_for(folder: Path, designs: int, process: subprocess.Popen[bytes]) -> None:
    """Wait until the journal has so many lines, with none until there is a folder, or the process ends."""
    end = time.monotonic() + 300.0
    while time.monotonic() < end and process.poll() is None:
        path = folder / JOURNAL if designs else folder / "manifest.json"
        if path.exists() and path.read_bytes().count(b"\n") >= designs:
            return
        time.sleep(0.002)
    assert process.returncode == 0, "it does not get anywhere"


def test_the_command_explores_and_goes_on(tmp_path: Path) -> None:
    file, out = slider_file(tmp_path), tmp_path / "out"
    done = invoke("explore", file, "--designs", 4, "--workers", 1, "--out", out, code=0)
    assert "minimise makespan_s, 4 designs" in done.output
    assert "how far designs got" in done.output
    again = invoke("explore", file, "--out", out, code=2)
    assert "--resume" in again.output
    invoke("explore", "--resume", out, "--designs", 6, "--workers", 1, code=0)
    assert [row.design for row in Journal(out).searched] == list(range(6))

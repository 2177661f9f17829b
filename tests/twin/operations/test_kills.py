"""An operation that is killed again and again goes on: nothing is done twice, and nothing is lost."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.twin.operations.operated import STACK, summary_of
from tests.twin.program import invoke
from tests.twin.trial.test_resume import KILLED

ROOT = Path(__file__).parents[3]
CELLS = {
    "lego": (STACK, "--seed", "4"),
    "machines": (
        "assembly/machine_tending.yaml",
        *("--seed", "1", "--set", "assembly.products.count=4"),
    ),
    "construction": ("construction/tower.yaml", "--seed", "2", "--robots", "3"),
}
"""A scenario, or where it is, and options."""

OFTEN = tuple(
    word
    for skill in ("pick", "place-down")
    for key, value in (("probability", 0.15), ("retries", 0), ("loses", 0.5))
    for word in ("--set", f"execution.failures.{skill}.{key}={value}")
)

KILLS = 7
"""Of each cell, at events that are drawn."""


def started(*arguments: str, kill_at: int = 0) -> int:
    """Run the program in a process of its own, killed at an event; return how it ended."""
    return subprocess.run(
        [sys.executable, "-c", KILLED, str(kill_at), *arguments],
        check=False,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
    ).returncode


def told(folder: Path) -> dict[str, Any]:
    """Return what a run has left."""
    files = ("events.jsonl", "trajectory.parquet", "objects.parquet")
    bytes_of = {k: (folder / k).read_bytes() for k in files}
    return {"summary": summary_of(folder), **bytes_of}


@pytest.mark.nightly
@pytest.mark.parametrize("cell", CELLS)
def test_an_operation_that_is_killed_goes_on(cell: str, tmp_path: Path) -> None:
    source, *options = CELLS[cell]
    file = ROOT / "scenarios" / source
    if cell == "lego":
        file = tmp_path / "stack.yaml"
        file.write_text(source, "utf-8")
    first = (
        "operate",
        str(file),
        *options,
        *OFTEN,
        "--no-recording",
        "--no-audit",
        "-q",
    )
    whole = tmp_path / "whole"
    assert started(*first, "--out", str(whole)) in (0, 1)
    wanted = told(whole)
    events = wanted["events.jsonl"].count(b"\n")
    draw, killed, runs = random.Random(cell), 0, 0
    while killed < KILLS:
        runs += 1
        out = tmp_path / f"parts{runs}"
        command, seen = (*first, "--out", str(out)), b""
        while True:
            at = draw.randrange(2, events) if killed < KILLS else 0
            code = started(*command, kill_at=at)
            log = (out / "events.jsonl").read_bytes()
            assert log.startswith(seen[: seen.rfind(b"\n") + 1]), "what was told stays"
            if code != -signal.SIGKILL:
                break
            killed, seen = killed + 1, log
            assert wanted["events.jsonl"].startswith(log[: log.rfind(b"\n") + 1])
            command = ("resume", str(out), "-q")
        assert told(out) == wanted
        invoke("verify", out, code=0)

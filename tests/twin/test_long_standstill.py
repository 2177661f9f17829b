"""What stands for eleven days costs what a minute of standstill does."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.twin.program import ROOT

MOST_KB = 1 << 20
"""Peak of memory [kB]. Address space is no measure of it: numba and LLVM reserve 4 GB that they never touch."""


def run(folder: Path, seconds: float) -> Any:
    words = [sys.executable, "-m", "tests.twin.long_standstill", folder, seconds]
    done = subprocess.run(
        list(map(str, words)), cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.nightly
def test_memory_and_samples_do_not_grow_with_a_standstill(tmp_path: Path) -> None:
    """Emergency stops, breakdowns, and repairs of a machine; run, audit, recording, follow, every export."""
    short, long = (run(tmp_path / name, s) for name, s in (("a", 60.0), ("b", 1e6)))
    for kind, few in short["counts"].items():
        many = long["counts"][kind]
        assert many["outcome"] == "completed"
        assert many["makespan_s"] > 1e5 > few["makespan_s"]
        for what in ("violations", "events", "exit"):
            assert many[what] == few[what], (kind, what)
        # A repair that is over in time lets nobody wait, and a wait has two rows.
        for what in ("configurations", "rows"):
            assert abs(many[what] - few[what]) <= 10, (kind, what)
        for what in few.keys() - {"outcome", "makespan_s", "peak_kb", "followed"}:
            # Numbers have more digits, and once a second is said for a minute after a motion.
            assert many[what] <= 1.15 * few[what] + 2000, (kind, what)
        assert many["peak_kb"] < MOST_KB
    assert long["cpu_s"] < 1.5 * short["cpu_s"] + 10.0

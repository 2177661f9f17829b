"""A test that hangs fails with the stacks of all threads, and those after it go on."""

import os
import subprocess
import sys
from pathlib import Path

from tests.twin.program import ROOT

HANGING = """
import queue, threading
import pytest
from hypothesis import given, strategies as st

@pytest.mark.timeout(1)
def test_a_report_never_comes():
    threading.Thread(target=threading.Event().wait, daemon=True).start()
    queue.SimpleQueue().get()

@pytest.mark.timeout(1)
@given(st.integers())
def test_an_example_never_ends(number):
    threading.Event().wait()

def test_another():
    pass
"""


def test_a_test_that_hangs_fails_with_its_stacks(tmp_path: Path) -> None:
    (tmp_path / "test_hanging.py").write_text(HANGING)
    options = ["-c", ROOT / "pyproject.toml", "--rootdir", tmp_path]
    options += ["-p", "tests.conftest", "-p", "no:xdist"]
    own = {k: v for k, v in os.environ.items() if not k.startswith("PYTEST_XDIST")}
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *map(str, options), str(tmp_path)],
        cwd=ROOT,
        env=own,
        capture_output=True,
        text=True,
        check=False,
        timeout=200,
    )
    assert done.returncode == 1, done.stdout + done.stderr
    assert "2 failed, 1 passed" in done.stdout
    assert done.stdout.count("HangingTestError") >= 2
    told = done.stdout + done.stderr
    assert "in test_a_report_never_comes" in told
    assert "in test_an_example_never_ends" in told

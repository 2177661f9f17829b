"""A run that cannot write what it promises has failed, and can be resumed when there is room."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.twin.trial.test_resume import ROOT, command, contents, invoke, plan, whole

__all__ = ["plan", "whole"]

FULL = """
import resource, sys
limit = int(sys.argv.pop(1))
from twin.cli import app
import twin.trial.trial, twin.recorders.observers
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
app()
"""


def full(limit: int, arguments: list[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-B", "-c", FULL, str(limit), *arguments],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize(
    "limit",
    [
        0,
        700,
        20_000,
        *(pytest.param(k, marks=pytest.mark.nightly) for k in (3000, 9000)),
    ],
)
def test_a_full_disk_is_a_failed_run(
    plan: Path, whole: Path, tmp_path: Path, limit: int
) -> None:
    largest = max(len(content) for content in contents(whole).values())
    assert limit < largest
    out = tmp_path / "run"
    done = full(limit, command(plan, out))
    assert done.returncode in (1, 2), done.stderr
    assert "Traceback" not in done.stderr
    assert "File too large" in done.stderr
    assert not (out / "summary.json").exists()
    if (out / "manifest.json").exists() and (out / "plan.npz").exists():
        result = invoke("resume", out)
        assert result.exit_code == 0, result.output
        assert contents(out) == contents(whole)


def test_a_recording_that_does_not_fit_is_a_failed_run(
    plan: Path, whole: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    with_recording = [part for part in command(plan, out) if part != "--no-recording"]
    largest = max(len(content) for content in contents(whole).values())
    done = full(largest + 1, with_recording)
    assert done.returncode == 1, done.stderr
    assert "run.rrd" in done.stderr
    assert not (out / "run.rrd").exists()
    assert not (out / "summary.json").exists()


def test_earlier_results_outlive_a_full_disk(
    plan: Path, whole: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    assert invoke(*command(plan, out)).exit_code == 0
    before = contents(out)
    done = full(3000, command(plan, out))
    assert done.returncode == 1
    assert contents(out) == before


def test_a_study_on_a_full_disk_has_failed(whole: Path, tmp_path: Path) -> None:
    study = ["study", "--plan", str(whole), "-n", "20", "--workers", "0", "--quiet"]
    done = full(2000, [*study, "--out", str(tmp_path / "study")])
    assert done.returncode == 1, done.stderr
    assert "File too large" in done.stderr
    assert "Traceback" not in done.stderr

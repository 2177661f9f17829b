"""A disk that is full ends a command with exit code 1, and says where there was no room."""

import json
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from tests.twin.explorations.sliders import slider_file
from tests.twin.program import ROOT, invoke

EXPORT = """
import resource, sys
limit = int(sys.argv.pop(1))
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
from twin.cli import main
main()
"""


_NIGHTLY = partial(pytest.param, marks=pytest.mark.nightly)


@pytest.mark.parametrize(
    ("limit", "arguments"),
    [
        (100, ("export", "RUN", "--format", "joint-trajectory", "--out", "OUT")),
        _NIGHTLY(100, ("export", "RUN", "--format", "mcap", "--out", "OUT")),
        _NIGHTLY(100, ("plan", "FILE", "--out", "OUT", "-q")),
        _NIGHTLY(
            20_000,
            ("run", "FILE", "--no-recording", "--no-audit", "--out", "OUT", "-q"),
        ),
    ],
)
def test_a_full_disk_ends_a_command_with_1_and_a_sentence(
    limit: int,
    arguments: tuple[str, ...],
    slider_run: tuple[Path, Path],
    tmp_path: Path,
) -> None:
    file, run = slider_run
    places = {"RUN": str(run), "FILE": str(file), "OUT": str(tmp_path / "out")}
    given = [places.get(word, word) for word in arguments]
    # Kernels that are compiled for the first time are not what has no room.
    warm = [word.replace(places["OUT"], str(tmp_path / "warm")) for word in given]
    assert invoke(*warm).exit_code == 0
    done = subprocess.run(
        [sys.executable, "-c", EXPORT, str(limit), *given],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1, done.stderr
    assert "File too large" in done.stderr
    assert str(tmp_path / "out") in done.stderr
    assert "this should not happen" not in done.stderr


@pytest.fixture(scope="module")
def slider_run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The scenario of two sliders and the folder of a run of it."""
    folder = tmp_path_factory.mktemp("sliders")
    file, run = slider_file(folder, ""), folder / "run"
    invoke("run", file, "--out", run, "--no-audit", "--no-recording", "-q", code=0)
    assert json.loads((run / "summary.json").read_text())["outcome"] == "completed"
    return file, run

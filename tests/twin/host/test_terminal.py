"""Small things that keep the terminal clean."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import trimesh
from numba import njit

from planning.meshes.mesh_form import mesh_form
from twin.host.progress import StageDisplay, compilation_shown

ROOT = Path(__file__).parents[3]


def test_compiled_code_is_silenced_and_python_speaks_again() -> None:
    code = (
        "import os, sys\n"
        "from planning.silence import silenced\n"
        "print('before')\n"
        "with silenced():\n"
        "    os.write(1, b'noise'); os.write(2, b'noise')\n"
        "print('after'); print('error', file=sys.stderr)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    assert (done.stdout, done.stderr) == ("before\nafter\n", "error\n")


def test_kernels_are_announced_when_they_are_compiled(
    capfd: pytest.CaptureFixture[str],
) -> None:
    with (
        StageDisplay() as display,
        compilation_shown(display, silent=False) as compiled,
    ):
        assert capfd.readouterr() == ("", "")
        double = njit(lambda x: 2 * x)
        assert (double(1), compiled()) == (2, 1)
        assert (double(2), compiled()) == (4, 1)
        assert (double(1.5), compiled()) == (3.0, 2)
    assert capfd.readouterr() == ("", "compiling kernels, once ...\n")


def test_meshes_that_take_long_are_announced_when_they_are_cut(
    capfd: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    for name, subdivisions in (("small", 2), ("large", 4)):
        ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=0.05)
        ball.export(tmp_path / f"{name}.stl")
    said = "cutting large.stl into convex pieces, once ...\n"
    with StageDisplay() as display, compilation_shown(display, silent=False):
        mesh_form(tmp_path / "small.stl")
        assert capfd.readouterr() == ("", "")
        mesh_form(tmp_path / "large.stl")
        assert capfd.readouterr() == ("", said)
        mesh_form(tmp_path / "large.stl")
    mesh_form(tmp_path / "large.stl", 2.0)
    assert capfd.readouterr() == ("", "")


def test_progress_prints_nothing_when_standard_error_is_no_terminal(
    capfd: pytest.CaptureFixture[str],
) -> None:
    with StageDisplay() as display:
        display("motions", 0, 10)
        display("motions", 10, 10)
    assert capfd.readouterr() == ("", "")

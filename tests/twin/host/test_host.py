"""What commands print beside their results: errors that nobody foresaw, progress, and names in pictures."""

import tempfile
from pathlib import Path

import pytest
import trimesh
import typer
from numba import njit

from planning.meshes.mesh_loading import load_mesh
from tests.twin.program import python
from twin.drawing.pictures import wrap_name
from twin.host.guard import ExitCode, guarded
from twin.host.progress import StageDisplay, show_compilation


@guarded
def broken() -> None:
    raise LookupError("no such\nthing")


def test_an_unforeseen_error_is_one_line_and_a_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with pytest.raises(typer.Exit) as ended:
        broken()
    assert ended.value.exit_code == ExitCode.UNFORESEEN
    assert ended.value.exit_code == 70
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "Traceback" not in said
    (report,) = tmp_path.iterdir()
    assert str(report) in said
    text = report.read_text()
    assert "LookupError: no such" in text
    assert "in broken" in text
    assert "assembly-twin: " in text


def test_without_room_for_a_report_the_line_remains(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    with pytest.raises(typer.Exit) as ended:
        broken()
    assert ended.value.exit_code == ExitCode.UNFORESEEN
    assert "no report could be written" in capsys.readouterr().err


def test_compiled_code_is_silenced_and_python_speaks_again() -> None:
    code = (
        "import os, sys\n"
        "from planning.silence import silence_output\n"
        "print('before')\n"
        "with silence_output():\n"
        "    os.write(1, b'noise'); os.write(2, b'noise')\n"
        "print('after'); print('error', file=sys.stderr)\n"
    )
    done = python(code)
    assert (done.stdout, done.stderr) == ("before\nafter\n", "error\n")


def test_kernels_are_announced_when_they_are_compiled(
    capfd: pytest.CaptureFixture[str],
) -> None:
    with (
        StageDisplay() as display,
        show_compilation(display, silent=False) as compiled,
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
    with StageDisplay() as display, show_compilation(display, silent=False):
        load_mesh(tmp_path / "small.stl")
        assert capfd.readouterr() == ("", "")
        load_mesh(tmp_path / "large.stl")
        assert capfd.readouterr() == ("", said)
        load_mesh(tmp_path / "large.stl")
    load_mesh(tmp_path / "large.stl", 2.0)
    assert capfd.readouterr() == ("", "")


def test_progress_prints_nothing_when_standard_error_is_no_terminal(
    capfd: pytest.CaptureFixture[str],
) -> None:
    with StageDisplay() as display:
        display("motions", 0, 10)
        display("motions", 10, 10)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("name", "width", "lines", "shown"),
    [
        ("housing", 60.0, 1, "housing"),
        ("housing", 20.0, 1, ""),
        ("left_2x4_c", 40.0, 3, "left_2x4_c"),
        ("left_2x4_c", 24.0, 3, "left_\n2x4_c"),
        ("beam13", 20.0, 3, "beam\n13"),
        ("connector", 20.0, 3, "conne\nctor"),
        ("connector", 20.0, 1, ""),
        ("connector", 3.0, 9, ""),
        ("lower left bolt", 20.0, 3, "lower\nleft\nbolt"),
    ],
)
def test_a_name_is_broken_where_its_words_end(
    name: str, width: float, lines: int, shown: str
) -> None:
    assert wrap_name(name, width, 6.0, lines=lines) == shown
    found = wrap_name(name, width, 6.0, lines=lines)
    assert all(len(line) * 0.6 * 6.0 <= width for line in found.split("\n"))

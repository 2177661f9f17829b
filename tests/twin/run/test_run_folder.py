from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from planning.errors import OutputError
from twin.cli import app
from twin.host.atomic import replacing, write_json
from twin.run.folder import prepare_run_folder


def test_a_folder_is_made_below_logs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    first, second = prepare_run_folder(None, "cliff"), prepare_run_folder(None, "cliff")
    assert first != second
    for folder in (first, second):
        assert folder.is_dir()
        assert re.fullmatch(r"cliff-\d{8}T\d{6}Z(-\d+)?", folder.name)
        assert folder.parent == Path("logs")


def test_results_of_an_earlier_run_go_and_plans_stay(tmp_path: Path) -> None:
    for name in ("summary.json", "plan.npz", "notes.txt"):
        (tmp_path / name).write_text("old")
    assert prepare_run_folder(tmp_path, "cliff") == tmp_path
    assert sorted(p.name for p in tmp_path.iterdir()) == ["notes.txt", "plan.npz"]


def test_a_place_that_cannot_be_written_is_an_error_at_once(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(OutputError, match="file"):
        prepare_run_folder(blocked / "run", "cliff")
    with pytest.raises(OutputError, match="file"):
        prepare_run_folder(blocked, "cliff")


def test_a_file_is_there_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "value.json"
    write_json(path, {"a": 1})
    with pytest.raises(ValueError, match="JSON"):
        write_json(path, {"a": float("nan")})
    with pytest.raises(ZeroDivisionError), replacing(path) as temporary:
        temporary.write_bytes(b"half") / 0
    assert json.loads(path.read_text()) == {"a": 1}
    assert [p.name for p in tmp_path.iterdir()] == ["value.json"]


def replayed(folder: Path) -> str:
    """Return what ``twin replay`` says of a run that cannot be replayed."""
    result = CliRunner().invoke(app, ["replay", str(folder)])
    assert result.exit_code in (1, 2)
    return result.stderr


def test_a_run_without_a_recording_cannot_be_replayed(tmp_path: Path) -> None:
    assert "it has no run.rrd" in replayed(tmp_path)
    assert "no such file" in replayed(tmp_path / "nowhere")


def test_without_a_display_replay_says_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "run.rrd").write_bytes(b"")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    said = replayed(tmp_path)
    assert "rerun run.rrd" in said
    assert "--stills" in said

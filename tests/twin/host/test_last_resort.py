"""What nobody foresaw ends in a line, a report and a code of its own."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest
import typer

from twin.host.guard import UNFORESEEN, guarded


@guarded
def broken() -> None:
    raise LookupError("no such\nthing")


def test_an_unforeseen_error_is_one_line_and_a_report(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with pytest.raises(typer.Exit) as ended:
        broken()
    assert ended.value.exit_code == UNFORESEEN == 70
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
    assert ended.value.exit_code == UNFORESEEN
    assert "no report could be written" in capsys.readouterr().err

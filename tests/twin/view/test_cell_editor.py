"""Changes of a scenario file in the editor: undone, saved, and never lost."""

import queue
import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from planning.errors import OutputError
from planning.transforms import from_rpy
from twin.checks.finding import Finding
from twin.document.validation import InvalidScenarioError
from twin.reading.scenario_file import load_scenario
from twin.scenario.shipped import shipped_scenarios
from twin.view.cell_editor import CellEditor, Movable
from twin.view.findings import FindingsThread


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return Path(shutil.copy(shipped_scenarios()["tray"], tmp_path / "tray.yaml"))


def movable(editor: CellEditor, name: str) -> Movable:
    return {own.name: own for own in editor.movables()}[name]


def test_a_move_changes_one_line_and_is_what_the_file_says(file: Path) -> None:
    before = file.read_text()
    editor = CellEditor(file)
    tray = movable(editor, "tray")
    assert tray.body == "fixtures/tray"
    pose = from_rpy(tray.pose[:3, 3] + [0.013, -0.02, 0], [0, 0, np.deg2rad(12.5)])
    editor.move(tray.at, pose)
    assert editor.unsaved
    assert file.read_text() == before
    editor.save()
    changed = [
        a
        for a, b in zip(before.splitlines(), file.read_text().splitlines(), strict=True)
        if a != b
    ]
    assert len(changed) == 1
    fixtures = {own.name: own for own in load_scenario(file).cell.fixtures}
    np.testing.assert_allclose(fixtures["tray"].pose.transform(), pose, atol=1e-6)
    np.testing.assert_allclose(movable(editor, "tray").pose, pose, atol=1e-6)


def test_every_change_is_undone_and_redone(file: Path) -> None:
    editor = CellEditor(file)
    texts = [editor.text]
    for _ in range(3):
        left = movable(editor, "robot left")
        pose = left.pose.copy()
        pose[0, 3] -= 0.01
        editor.move(left.at, pose)
        texts.append(editor.text)
    home = [0.1, -0.7, 0.1, -2.3, 0.1, 1.6, 0.8]
    editor.set_home("left", home)
    texts.append(editor.text)
    for text in reversed(texts[:-1]):
        assert editor.undo()
        assert editor.text == text
    assert not editor.undo()
    for text in texts[1:]:
        assert editor.redo()
        assert editor.text == text
    robot = editor.scenario.sections.cell.robots[0]
    assert not editor.problems
    assert robot.home_deg is not None
    np.testing.assert_allclose(robot.home_deg, np.rad2deg(home), atol=1e-6)


def test_what_others_wrote_is_not_overwritten_unasked(file: Path) -> None:
    editor = CellEditor(file)
    pose = {"xyz_m": [0, 1.5, 0.05]}
    box = {"name": "box", "size_m": [0.1, 0.1, 0.1], "pose": pose}
    editor.add((("cell", "fixtures"), box))
    mine = editor.text
    file.write_text(file.read_text() + "# theirs\n")
    with pytest.raises(OutputError, match="has changed since it was opened"):
        editor.save()
    assert editor.text == mine
    assert file.read_text().endswith("# theirs\n")
    editor.read_again()
    assert editor.text.endswith("# theirs\n")
    editor.undo()
    assert editor.text == mine
    editor.save()
    assert file.read_text() == mine


def test_an_invalid_change_keeps_the_last_valid_cell_and_names_the_line(
    file: Path,
) -> None:
    told: list[int] = []
    editor = CellEditor(file, lambda: told.append(1))
    good = editor.scenario
    editor.replace(editor.text.replace("kind: assembly", "kind: assmbly", 1))
    assert editor.scenario is good
    assert any(
        "assmbly" in words and words.startswith("line ") for words in editor.problems
    )
    editor.undo()
    assert not editor.problems
    assert len(told) == 2
    file.write_text("cell: [")
    with pytest.raises(InvalidScenarioError):
        CellEditor(file)


def test_a_pose_is_checked_while_it_moves(file: Path) -> None:
    published: queue.Queue[tuple[Sequence[Finding], bool]] = queue.Queue()
    editor = CellEditor(file)
    text, tray = editor.text, movable(editor, "tray")
    pose = tray.pose.copy()
    pose[0, 3] += 3.0
    checks = FindingsThread(lambda *found: published.put(found))
    moved = editor.moved(tray.at, pose)
    checks.check(lambda: editor.parsed(moved), moving=True)
    found, complete = published.get(timeout=60)
    checks.stop()
    assert complete
    assert any(own.error for own in found)
    assert editor.text == text
    assert not editor.undo()

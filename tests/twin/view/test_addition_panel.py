"""What is added to scenario files: valid, nothing else changed, and refused as a whole where it cannot be."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import viser
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.errors import TwinError
from tests.twin.explorations.sliders import slider_file
from tests.twin.view.test_edited_text import SHORT, content
from twin.checks.check import findings_without_reach
from twin.checks.finding import CheckContext
from twin.reading.scenario_file import load_scenario
from twin.scenario.shipped import shipped_scenarios
from twin.view.addition_panel import AdditionPanel
from twin.view.cell_editor import CellEditor
from twin.view.server import HOST

TETRAHEDRON = """\
v 0 0 0
v 30 0 0
v 0 30 0
v 0 0 30
f 1 3 2
f 1 2 4
f 1 4 3
f 2 3 4
"""


@pytest.fixture(scope="module")
def gui() -> Iterator[viser.GuiApi]:
    server = viser.ViserServer(HOST, 8390, verbose=False)
    yield server.gui
    server.stop()


def panel_of(editor: CellEditor, gui: viser.GuiApi) -> AdditionPanel:
    def guarded(act: Callable[[], object]) -> None:
        act()

    return AdditionPanel(gui, editor, guarded, lambda: np.array([0.1, 0, 2]))


def set_field(panel: AdditionPanel, field: str, value: object) -> None:
    getattr(panel, f"_{field}").value = value


@settings(max_examples=4)
@given(
    st.sampled_from(SHORT),
    st.sampled_from(["Robot", "Fixture", "Part", "Feeder", "Tray"]),
    st.sampled_from(["box", "cylinder"]),
)
def test_additions_to_any_scenario(
    gui: viser.GuiApi, file: Path, kind: str, shape: str
) -> None:
    editor = CellEditor(file)
    before, panel = content(editor.text), panel_of(editor, gui)
    set_field(panel, "shape", shape)
    set_field(panel, "model", "panda")
    if kind in ("Part", "Feeder", "Tray") and before["assembly"]["kind"] != "assembly":
        return  # there is no such button
    try:
        editor.add(*panel.entries(kind))
    except TwinError:
        # Its products and the order of its steps do not go with this.
        assert content(editor.text) == before
        assert not editor.undo()
        return
    assert not editor.problems
    after = content(editor.text)
    for (top, key), entry in panel.entries(kind):
        added = after[top][key]
        if isinstance(added, dict):
            added.pop(entry["name"])
        else:
            assert added.pop() == plain(entry)
        if not added and key not in before[top]:
            del after[top][key]
    assert after == before
    assert editor.undo()
    assert content(editor.text) == before


def plain(value: Any) -> Any:
    """Return a value as it is read from a file."""
    if isinstance(value, dict):
        return {key: plain(own) for key, own in value.items()}
    return [plain(own) for own in value] if isinstance(value, list | tuple) else value


def test_a_robot_and_a_mesh_of_the_folder(tmp_path: Path, gui: viser.GuiApi) -> None:
    file = slider_file(tmp_path, "")
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "corner.obj").write_text(TETRAHEDRON)
    editor = CellEditor(file)
    panel = panel_of(editor, gui)
    set_field(panel, "model", "slider.urdf")
    set_field(panel, "shape", "meshes/corner.obj")
    with pytest.raises(TwinError, match="scale"):  # it is 30 m wide
        editor.add(*panel.entries("Fixture"))
    assert not editor.unsaved
    set_field(panel, "unit", "mm")
    editor.add(*panel.entries("Fixture"))
    set_field(panel, "name", "third")
    editor.add(*panel.entries("Robot"))
    with pytest.raises(TwinError, match="third"):  # the name is not free
        editor.add(*panel.entries("Robot"))
    editor.save()
    saved = load_scenario(file)
    assert saved == editor.scenario.sections
    assert saved.cell.robots[-1].model == "slider.urdf"
    np.testing.assert_allclose(saved.cell.robots[-1].base.xyz_m, [0.1, 0, 2])


def test_the_check_of_the_file_is_that_of_the_page(
    tmp_path: Path, gui: viser.GuiApi
) -> None:
    file = tmp_path / "tray.yaml"
    file.write_bytes(shipped_scenarios()["tray"].read_bytes())
    editor = CellEditor(file)
    panel = panel_of(editor, gui)
    for kind in ("Part", "Tray"):
        set_field(panel, "name", f"further_{kind}")
        editor.add(*panel.entries(kind))
    editor.save()
    shown = editor.scenario
    found = [
        findings_without_reach(CheckContext(sections, tmp_path))
        for sections in (load_scenario(file), shown.sections)
    ]
    assert found[0] == found[1] != []

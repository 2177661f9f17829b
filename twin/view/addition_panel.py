"""Folder of the page that adds robots, fixtures, parts and sources to the scenario file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import chain, islice
from pathlib import Path
from typing import Any

import viser

from planning.robots.registry import ROBOTS
from planning.transforms import Array
from twin.document.yaml_text import KeyPath
from twin.view.cell_editor import CellEditor

_BOX, _CYLINDER = "box", "cylinder"
_MESHES, _ROBOTS = (".stl", ".obj"), (".urdf", ".xacro", ".xml")
_MM = "mm"
_MOST_FILES = 2000
"""Files of the scenario's folder and of those in it among which meshes and robots are looked for."""

_TRAY = (3, 2)
"""Places of a new tray along x and y."""


class AdditionPanel:
    """Adds entries to a scenario file.

    Args:
        gui: where the fields come.
        editor: the file.
        guarded: calls a function, and shows its error.
        top: returns where new things stand, shape (3,) [m].
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        editor: CellEditor,
        guarded: Callable[[Callable[[], object]], None],
        top: Callable[[], Array],
    ) -> None:
        self._top = top
        folder = editor.path.parent
        self._name = gui.add_text("Name", "new")
        self._shape = gui.add_dropdown(
            "Shape",
            (_BOX, _CYLINDER, *_files(folder, _MESHES)),
            hint="Also the STL and OBJ files in the scenario's folder",
        )
        self._size = gui.add_vector3(
            "Size [m]", (0.05, 0.05, 0.05), hint="A cylinder is x wide and z high"
        )
        self._unit = gui.add_dropdown("Unit of a mesh", ("m", _MM))
        self._model = gui.add_dropdown(
            "Robot model",
            (*ROBOTS, *_files(folder, _ROBOTS)),
            hint="Those of twin robots, and descriptions in the scenario's folder",
        )
        parts = "sources" in type(editor.scenario.sections.assembly).model_fields
        kinds = ("Robot", "Fixture", *(("Part", "Feeder", "Tray") if parts else ()))
        hint = "On top of what is selected; a feeder or a tray comes with its part"
        keys = gui.add_button_group("Add", kinds, hint=hint)
        keys.on_click(lambda _: guarded(lambda: editor.add(*self.entries(keys.value))))

    def entries(self, kind: str) -> Iterator[tuple[KeyPath, Any]]:
        """Yield what a button adds: keys and entries; a part with its step and, from a source, with that."""
        name, (wide, deep, high) = self._name.value, self._size.value
        x, y, z = self._top().tolist()
        if kind == "Robot":
            base = {"xyz_m": [x, y, z]}
            entry = {"name": name, "model": self._model.value, "base": base}
            yield ("cell", "robots"), entry
            return
        shaped: dict[str, Any] = {"name": name}
        if self._shape.value == _BOX:
            shaped["size_m"] = [wide, deep, high]
        elif self._shape.value == _CYLINDER:
            round_one = {"radius_m": 0.5 * wide, "length_m": high}
            shaped["shape"] = {"cylinder": round_one}
        else:
            # Without a scale, meshes that are too large for metres are refused.
            scale = {"scale": 0.001} if self._unit.value == _MM else {}
            shaped["shape"] = {"mesh": self._shape.value, **scale}
        pose = {"xyz_m": [x, y, z + 0.5 * high]}
        if kind == "Fixture":
            yield ("cell", "fixtures"), {**shaped, "pose": pose}
            return
        source: dict[str, Any] = {"kind": kind.lower(), "pose": pose}
        if kind == "Tray":
            grid = {"counts": _TRAY, "pitch_m": [2.0 * wide, 2.0 * deep]}
            source["grid"] = grid
        if kind == "Part":
            shaped["start"] = pose
        else:
            shaped["source"] = source["name"] = f"{name}_{kind.lower()}"
            yield ("assembly", "sources"), source
        goal = {"xyz_m": [x, y + 2.0 * _TRAY[1] * deep, z + 0.5 * high]}
        yield ("assembly", "parts"), {**shaped, "goal": goal}
        yield ("assembly", "steps"), name


def _files(folder: Path, suffixes: tuple[str, ...]) -> list[str]:
    """Return the files with a suffix in a folder and in those in it, relative to it."""
    found = islice(chain(folder.glob("*"), folder.glob("*/*")), _MOST_FILES)
    return sorted(
        own.relative_to(folder).as_posix()
        for own in found
        if own.suffix.lower() in suffixes
    )

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
        pose = {"xyz_m": [x, y, z + 0.5 * high]}
        source = f"{name}_{kind.lower()}"
        if kind == "Robot":
            base = {"xyz_m": [x, y, z]}
            robot = {"name": name, "model": self._model.value, "base": base}
            yield ("cell", "robots"), robot
        elif kind == "Fixture":
            yield ("cell", "fixtures"), {"name": name, **self._shaped(), "pose": pose}
        else:
            goal = {"xyz_m": [x, y + 2.0 * _TRAY[1] * deep, z + 0.5 * high]}
            origin = {"start": pose} if kind == "Part" else {"source": source}
            part = {"name": name, **self._shaped(), **origin, "goal": goal}
            yield ("assembly", "parts"), part
            yield ("assembly", "steps"), name
        if kind in ("Feeder", "Tray"):
            pitch = [2.0 * wide, 2.0 * deep]
            grid = {"grid": {"counts": _TRAY, "pitch_m": pitch}}
            entry = {"name": source, "kind": kind.lower(), "pose": pose}
            yield ("assembly", "sources"), entry | (grid if kind == "Tray" else {})

    def _shaped(self) -> dict[str, Any]:
        """Return the keys of the chosen shape."""
        wide, deep, high = self._size.value
        if self._shape.value == _BOX:
            return {"size_m": [wide, deep, high]}
        if self._shape.value == _CYLINDER:
            return {"shape": {"cylinder": {"radius_m": 0.5 * wide, "length_m": high}}}
        # Without a scale, meshes that are too large for metres are refused.
        scale = {"scale": 0.001} if self._unit.value == _MM else {}
        return {"shape": {"mesh": self._shape.value, **scale}}


def _files(folder: Path, suffixes: tuple[str, ...]) -> list[str]:
    """Return the files with a suffix in a folder and in those in it, relative to it."""
    found = islice(chain(folder.glob("*"), folder.glob("*/*")), _MOST_FILES)
    return sorted(
        own.relative_to(folder).as_posix()
        for own in found
        if own.suffix.lower() in suffixes
    )

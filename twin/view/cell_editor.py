"""Editing of a scenario file: changes of its text with undo and redo, and saving without losing changes of others."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from planning.errors import OutputError, RequestError, TwinError
from planning.files import read_file, replace_atomically
from planning.transforms import Array, Transform, quat_wxyz
from twin.document.section import iterate_nested
from twin.document.validation import InvalidScenarioError
from twin.document.yaml_text import KeyPath
from twin.planning.build_workcell import build_workcell
from twin.reading.scenario_file import parse_scenario
from twin.scenario.sections.shapes import PoseSection
from twin.trial.loaded_scenario import LoadedScenario
from twin.view.edited_text import with_entry, with_value

_INNER = frozenset(
    {"frames", "mount", "tcp", "shape", "shapes", "path", "at", "base_error"}
)
"""Keys below which poses are not in the world."""

_BODIES = {
    ("fixtures", "pose"): "fixtures",
    ("parts", "start"): "objects",
    ("parts", "goal"): "goals",
}
"""Kinds of the bodies that stand at a pose, by the list and the key of the pose."""

_MOST_UNDONE = 200
"""Number of changes that can be undone."""


@dataclass(frozen=True)
class Movable:
    """A pose in the world that a scenario file gives.

    Attributes:
        at: key of the pose.
        name: name for people, such as ``fixture table``.
        body: kind and name of the bodies that stand there, such as ``fixtures/table``; empty for none.
        pose: the pose.
    """

    at: KeyPath
    name: str
    body: str
    pose: Transform


class CellEditor:
    """A scenario file under change: one change at a time, which callers see to.

    Args:
        path: the file.
        changed: called after every change of the text.

    Attributes:
        text: the text with all changes.
        scenario: the scenario of the text; the last valid one while the text is not valid.
        problems: problems of the text; empty while it is valid.

    Raises:
        InvalidScenarioError: the file is not valid.
    """

    def __init__(self, path: Path, changed: Callable[[], None] = lambda: None) -> None:
        self.path, self._changed = path, changed
        self.text = self._on_disk = _read(path)
        self._undo: list[str] = []
        self._redo: list[str] = []
        self.problems: tuple[str, ...] = ()
        self.scenario = self.parsed(self.text)

    @property
    def unsaved(self) -> bool:
        """Whether there are changes that are not in the file."""
        return self.text != self._on_disk

    def movables(self) -> Iterator[Movable]:
        """Yield all poses in the world that the scenario gives."""
        sections = self.scenario.sections
        for k, robot in enumerate(sections.cell.robots):
            if not robot.parked:
                base: KeyPath = ("cell", "robots", k, "base")
                pose = robot.base.transform()
                yield Movable(base, f"robot {robot.name}", f"robots/{robot.name}", pose)
        nested = dict(iterate_nested(sections))
        for at, value in nested.items():
            written = at in self.scenario.document.values
            inner = _INNER & set(map(str, at)) or at[-1:] == ("base",)
            if not isinstance(value, PoseSection) or not written or inner:
                continue
            given = getattr(nested[at[:-1]], "name", None)
            owner = given or " ".join(map(str, at[2:-1]))
            body = _BODIES.get((str(at[1]), str(at[-1])), "")
            name = owner if at[-1] == "pose" else f"{owner} {at[-1]}"
            place = f"{body}/{owner}" if body else ""
            yield Movable(at, name, place, value.transform())

    def move(self, at: KeyPath, pose: Transform) -> None:
        """Set the pose at a key."""
        self.replace(self.moved(at, pose))

    def moved(self, at: KeyPath, pose: Transform) -> str:
        """Return the text with another pose at a key.

        Orientations are written as angles, and left out where they are not needed.

        Raises:
            RequestError: there is no pose at the key.
        """
        text = self.text
        given = next((own.pose for own in self.movables() if own.at == at), None)
        if given is None:
            raise RequestError("what is moved is no longer in the file")
        xyz = [float(x) for x in pose[:3, 3]]
        if at not in self.scenario.document.values:
            text = with_value(text, at, {"xyz_m": xyz})
        else:
            text = with_value(text, (*at, "xyz_m"), xyz)
        if not np.allclose(given[:3, :3], pose[:3, :3], atol=1e-7):
            if (*at, "quat_wxyz") in self.scenario.document.values:
                text = with_value(text, (*at, "quat_wxyz"), quat_wxyz(pose).tolist())
            else:
                text = with_value(text, (*at, "rpy_deg"), angles_deg(pose).tolist())
        return text

    def set_home(self, robot: str, q: list[float]) -> None:
        """Set HOME of a robot [rad or m]."""
        robots = self.scenario.sections.cell.robots
        k = next(k for k, own in enumerate(robots) if own.name == robot)
        at = ("cell", "robots", k)
        key = "home_rad_or_m"
        if robots[k].home_rad_or_m is None and not robots[k].parked:
            key, q = "home_deg", np.rad2deg(q).tolist()
        self.replace(with_value(self.text, (*at, key), q))

    def add(self, *entries: tuple[KeyPath, Any]) -> None:
        """Append entries to the lists at keys, or add them to mappings by their names, as one change.

        Raises:
            TwinError: there would be no cell with them; nothing is changed.
        """
        text = self.text
        for at, entry in entries:
            text = with_entry(text, at, entry)
        scenario = self.parsed(text)
        build_workcell(scenario.sections, scenario.folder)
        self.replace(text)

    def replace(self, text: str) -> None:
        """Replace the text; the change can be undone."""
        if text == self.text:
            return
        self._undo = [*self._undo, self.text][-_MOST_UNDONE:]
        self._redo = []
        self._set(text)

    def undo(self) -> bool:
        """Undo the last change; return whether there was one."""
        return self._step(self._undo, self._redo)

    def redo(self) -> bool:
        """Make the change again that was undone last; return whether there was one."""
        return self._step(self._redo, self._undo)

    def save(self, *, force: bool = False) -> None:
        """Write the text into the file.

        Args:
            force: also where the file on disk has changed since it was read.

        Raises:
            OutputError: the file has changed, or cannot be written; the text is kept.
        """
        now = _read(self.path) if self.path.exists() else None
        if now != self._on_disk and not force:
            raise OutputError(
                f"{self.path}: the file has changed since it was opened: read it again, which can be"
                " undone, or overwrite it"
            )
        with replace_atomically(self.path) as temporary:
            temporary.write_text(self.text, encoding="utf-8")
        self._on_disk = self.text

    def read_again(self) -> None:
        """Replace the text with that of the file; the change can be undone."""
        now = _read(self.path)
        self.replace(now)
        self._on_disk = now

    def _step(self, source: list[str], target: list[str]) -> bool:
        if not source:
            return False
        target.append(self.text)
        self._set(source.pop())
        return True

    def _set(self, text: str) -> None:
        self.text = text
        try:
            self.scenario = self.parsed(text)
            self.problems = ()
        except InvalidScenarioError as error:
            self.problems = tuple(
                f"line {item.mark.line}: {item.message}" for item in error.problems
            )
        except TwinError as error:
            self.problems = (str(error),)
        self._changed()

    def parsed(self, text: str) -> LoadedScenario:
        """Return the scenario that a text is.

        Raises:
            TwinError: it is none.
        """
        sections, document = parse_scenario(self.path, text)
        return LoadedScenario(sections, self.path.parent, document)


def angles_deg(pose: Transform) -> Array:
    """Return roll, pitch and yaw of a pose [deg]."""
    return Rotation.from_matrix(pose[:3, :3]).as_euler("xyz", degrees=True)


def _read(path: Path) -> str:
    try:
        return read_file(path).decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise RequestError(f"{path}: cannot be read: {error}") from error

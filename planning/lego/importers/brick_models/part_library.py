"""Parts library of LDraw: parts, sub-parts and primitives in the folders ``parts`` and ``p``, and in a model's file.

File names do not depend on upper and lower case. Nothing outside the library's folder is read.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from planning.errors import ScenarioError
from planning.lego.importers.brick_models.ldraw_files import (
    Colour,
    brick_type_of_file,
    read_colour,
    read_numbers,
    read_reference,
)
from planning.lego.importers.brick_models.model import read_lines
from planning.lego.importers.brick_models.part_shape import (
    PartGeometry,
    PartShape,
    brick_shape,
    part_shape,
)

_FOLDERS = ("parts", "p", "unofficial/parts", "unofficial/p")
"""Folders of a library in the order in which a file is sought in them."""

_LARGEST = 16 << 20
"""Most bytes of a file."""

_MOST_LINES = 3_000_000
"""Lines of all files that are read."""

_MOST_FACES = 500_000
"""Triangles of a part."""

_DEEPEST = 25
"""Files within files."""

_KNOB = re.compile(
    r"stud(a|el|p\d+|line|-logo\d*|2a?|2-logo\d*|6a?|9|10|13|15|17a?|26)?"
)
"""Primitives that are knobs; other studs are of the underside, or of other systems."""

_NOTHING = PartGeometry(np.zeros((0, 3, 3)), np.zeros((0, 2, 3)))


class PartLibrary:
    """Shapes of parts by the name of their file.

    Args:
        folder: with ``parts`` and ``p``; None where the user has no library.
        model: the model's file, for messages.
        own: lines of the parts that the model's file brings along, by name, each with its number.

    Raises:
        ScenarioError: the folder is no library.
    """

    def __init__(
        self,
        folder: Path | None,
        model: Path,
        own: Mapping[str, Sequence[tuple[int, str]]],
    ) -> None:
        self._folder, self._model, self._own = folder, model, own
        self._known: dict[str, PartGeometry] = {}
        self._shapes: dict[str, PartShape | str] = {}
        self._entries: dict[Path, dict[str, str]] = {}
        self._open: list[str] = []
        self._lines = 0
        if folder is not None and self._entry(folder, "parts") is None:
            words = "no parts library of LDraw: it has no folder 'parts'"
            raise ScenarioError(f"{folder}: {words}")

    def shape(self, name: str) -> PartShape | str:
        """Return the shape of a part, or the reason for which it has none.

        Those of known bricks are not read.
        """
        if (kind := brick_type_of_file(name)) is not None:
            return brick_shape(kind)
        if name not in self._shapes:
            self._open.clear()
            try:
                shape = part_shape(self._geometry(name))
                self._shapes[name] = shape or "nothing is drawn in it"
            except ScenarioError as error:
                self._shapes[name] = str(error)
        return self._shapes[name]

    def colours(self) -> dict[int, Colour]:
        """Return the colours that the library defines in its ``LDConfig.ldr``, by code."""
        path = self._path("ldconfig.ldr")
        lines = [] if path is None else read_lines(path, _LARGEST)
        return {k: own for line in lines for k, own in read_colour(line).items()}

    def _geometry(self, name: str) -> PartGeometry:
        """Return the surface of a file with all that it refers to.

        Raises:
            ScenarioError: it is not there, contains itself, is too large, or has lines that are
                no LDraw; names file and line.
        """
        if name not in self._known:
            if name in self._open:
                raise ScenarioError("it contains itself")
            if len(self._open) >= _DEEPEST:
                raise ScenarioError(f"files within files, more than {_DEEPEST} deep")
            path, lines = self._content(name)
            self._lines += len(lines)
            if self._lines > _MOST_LINES:
                raise ScenarioError(f"its parts have more than {_MOST_LINES} lines")
            self._open.append(name)
            self._known[name] = self._read(path, lines)
            self._open.pop()
        return self._known[name]

    def _read(self, path: Path, lines: Sequence[tuple[int, str]]) -> PartGeometry:
        faces, knobs, count = [_NOTHING.faces], [_NOTHING.knobs], 0
        for number, line in lines:
            try:
                own = self._read_line(line, number)
            except ScenarioError as error:
                raise ScenarioError(f"{path}:{number}: {error}") from None
            if own is not None:
                faces.append(own.faces)
                knobs.append(own.knobs)
                count += len(own.faces) + len(own.knobs)
            if count > _MOST_FACES:
                what = f"more than {_MOST_FACES} faces and knobs"
                raise ScenarioError(f"{path}:{number}: {what}")
        return PartGeometry(np.concatenate(faces), np.concatenate(knobs))

    def _read_line(self, line: str, number: int) -> PartGeometry | None:
        """Return what a line draws, None for nothing."""
        words = line.split(None, 14)
        kind = words[0] if words else "0"
        if kind == "1":
            reference = read_reference(words, number)
            try:
                part = self._part(reference.name)
            except ScenarioError as error:
                what = f"{reference.name[:60]!r}: {error}"
                raise ScenarioError(what) from None
            turn, shift = reference.pose[:3, :3], reference.pose[:3, 3]
            knobs = part.knobs @ turn.T + [shift, np.zeros(3)]
            return PartGeometry(part.faces @ turn.T + shift, knobs)
        if kind in ("3", "4"):
            values = read_numbers(words[2 : 2 + 3 * int(kind)])
            if len(values) < 3 * int(kind):
                raise ScenarioError(f"a face of {kind} corners lacks some")
            fan = [[0, 1, 2], [0, 2, 3]][: int(kind) - 2]
            return PartGeometry(np.reshape(values, (-1, 3))[fan], _NOTHING.knobs)
        if kind not in ("0", "2", "5"):
            raise ScenarioError(f"{line.strip()[:30]!r} is no line of LDraw")
        return None

    def _part(self, name: str) -> PartGeometry:
        """Return the surface of a file, or the knob that it is."""
        stem = name.rpartition("/")[2].removesuffix(".dat")
        if _KNOB.fullmatch(stem):
            return PartGeometry(_NOTHING.faces, np.array([[[0, 0, 0], [0, -1.0, 0]]]))
        return self._geometry(name)

    def _content(self, name: str) -> tuple[Path, Sequence[tuple[int, str]]]:
        """Return the lines of a part with their numbers, and the file that they are in."""
        if name in self._own:
            return self._model, self._own[name]
        path = self._find(name)
        if path is None:
            where = "here, without a parts library"
            if self._folder is not None:
                where = f"in the parts library {self._folder}"
            raise ScenarioError(f"it is not known {where}")
        return path, list(enumerate(read_lines(path, _LARGEST), start=1))

    def _find(self, name: str) -> Path | None:
        """Return the file of a name in the library, None where it has none.

        Raises:
            ScenarioError: the name, or a link, leads out of the library.
        """
        steps = name.split("/")
        if any(step in ("", ".", "..") or ":" in step for step in steps):
            raise ScenarioError("its path leads out of the parts library")
        paths = (self._path(*folder.split("/"), *steps) for folder in _FOLDERS)
        return next((path for path in paths if path is not None), None)

    def _path(self, *steps: str) -> Path | None:
        """Return a path in the library by names in small letters, None where it has none."""
        path = self._folder
        for step in steps:
            path = path and self._entry(path, step)
        if path is not None and self._folder is not None:
            require_inside(path, self._folder)
        return path

    def _entry(self, folder: Path, name: str) -> Path | None:
        """Return the entry of a folder by a name in small letters, None where it has none."""
        if folder not in self._entries:
            try:
                names = sorted(os.listdir(folder))
            except OSError:
                names = []
            self._entries[folder] = {n.casefold(): n for n in names}
        found = self._entries[folder].get(name)
        return None if found is None else folder / found


def require_inside(path: Path, folder: Path) -> None:
    """Raise a ScenarioError if a link leads from a path out of the folder that contains it, or to itself."""
    try:
        inside = path.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError):  # a link to itself
        inside = False
    if not inside:
        raise ScenarioError(f"{path} is a link out of {folder}")

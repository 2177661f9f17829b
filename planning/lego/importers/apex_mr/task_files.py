"""Reading of the JSON and text files of APEX-MR; every error names the file and the key."""

from __future__ import annotations

from codecs import BOM_UTF8
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from planning.errors import ScenarioError
from planning.files import read_file
from planning.json_files import parse_json
from planning.lego.bricks.assembly import Cell

TOOLS: Mapping[str, str] = {
    "tool": "tool",
    "assemble": "tool_assemble",
    "disassemble": "tool_disassemble",
    "handover_assemble": "tool_handover_assemble",
    "alt": "tool_alt",
    "alt_assemble": "tool_alt_assemble",
}
"""Name of each tool frame in the names of the published files."""

NONE = -1
"""Placeholder for a value that a step does not have."""


@dataclass(frozen=True)
class Record:
    """A JSON object with its location in the files.

    Attributes:
        path: the file.
        key: key of the object in the file, empty for the whole file.
        content: the object.
    """

    path: Path
    key: str
    content: Mapping[str, Any]

    def where(self, key: str) -> str:
        """Return file and key for a message."""
        return f"{self.path}: {'.'.join(k for k in (self.key, key) if k)}"

    def child(self, key: str) -> Record:
        """Return the object at ``key``."""
        value = self._get(key)
        if not isinstance(value, dict):
            raise ScenarioError(f"{self.where(key)}: must be an object")
        return Record(self.path, ".".join(k for k in (self.key, key) if k), value)

    def number(self, key: str, *, default: float | None = None) -> float:
        """Return a finite number, or the default where the key is missing and there is one."""
        if default is not None and self.content.get(key) is None:
            return default
        value = self._get(key)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ScenarioError(f"{self.where(key)}: {value!r} is not a number")
        if not np.isfinite(value):
            raise ScenarioError(f"{self.where(key)}: {value!r} is not finite")
        return float(value)

    def integer(self, key: str, *, default: int | None = None) -> int:
        """Return a whole number, or the default where the key is missing and there is one."""
        value = self.number(key, default=default)
        if value != int(value):
            raise ScenarioError(f"{self.where(key)}: {value!r} is not a whole number")
        return int(value)

    def choice(
        self, key: str, valid: tuple[int, ...], *, default: int | None = None
    ) -> int:
        """Return one of some whole numbers, or the default where the key is missing."""
        value = self.integer(key, default=default)
        if value not in valid:
            raise ScenarioError(
                f"{self.where(key)}: {value} is not valid",
                choices=tuple(str(v) for v in valid),
            )
        return value

    def cell(self, prefix: str) -> Cell:
        """Return a cell, whose keys begin with a prefix."""
        x, y, z = (self.integer(f"{prefix}{k}") for k in "xyz")
        return Cell(x, y, z, self.choice(f"{prefix}ori", (0, 1)) == 1)

    def _get(self, key: str) -> Any:
        if key not in self.content:
            raise ScenarioError(
                f"{self.where(key)}: is missing", choices=tuple(self.content)[:20]
            )
        return self.content[key]


class Notes:
    """Content of published files that is not imported: unknown keys, counted, and the rest."""

    def __init__(self) -> None:
        self._unused: Counter[tuple[Path, str]] = Counter()
        self._others: list[str] = []

    def add(self, text: str) -> None:
        """Note something in words."""
        self._others.append(text)

    def unused(self, record: Record, known: frozenset[str]) -> None:
        """Note the unknown keys of a record."""
        self._unused.update((record.path, k) for k in record.content if k not in known)

    def unused_key(self, record: Record, key: str) -> None:
        """Note one key."""
        self._unused[record.path, key] += 1

    def lines(self) -> tuple[str, ...]:
        """Return the notes in words, in the order in which they were made."""
        unused = (
            f"{path}: {key!r} is not used" + (f", {n} times" if n > 1 else "")
            for (path, key), n in self._unused.items()
        )
        return (*unused, *self._others)


def read_json(path: Path) -> Record:
    """Return the object that a JSON file holds.

    Raises:
        ScenarioError: there is no such file, it does not hold an object, or an object has a
            key twice.
    """
    try:
        # Some editors put a byte order mark in front.
        content = parse_json(read_file(path).removeprefix(BOM_UTF8))
    except OSError as error:
        raise ScenarioError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise ScenarioError(f"{path}: is not valid JSON: {error}") from None
    if not isinstance(content, dict):
        raise ScenarioError(f"{path}: must hold an object")
    return Record(path, "", content)

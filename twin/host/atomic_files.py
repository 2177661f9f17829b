"""Atomic writing of text files, JSON files and pictures: a file is replaced completely or not at all."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planning.files import replace_atomically

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def write_text(path: Path, text: str) -> None:
    """Write a UTF-8 text file; raise OutputError if that fails."""
    with replace_atomically(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(path: Path, value: Any) -> None:
    """Write a value as indented JSON with a final newline; NaN and infinity are refused."""
    text = json.dumps(value, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
    write_text(path, text)


def save_png(picture: Figure, path: Path) -> None:
    """Write a figure as PNG, replacing an old file; OutputError on failure."""
    with replace_atomically(path) as temporary:
        picture.savefig(temporary, format="png")


def finite_or_none(value: float) -> float | None:
    """Return a number valid in JSON: None for NaN and infinity."""
    return value if math.isfinite(value) else None

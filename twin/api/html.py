"""What results look like in a notebook: a small table with a title, and pictures."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable
from pathlib import Path

from matplotlib.figure import Figure

from twin.study.report.markup import pairs, text


def card(title: str, rows: Iterable[tuple[str, str]]) -> str:
    """Return a titled table of what is said about some things."""
    return f"<p><strong>{text(title)}</strong></p>{pairs(rows)}"


def drawn(figure: Figure) -> str:
    """Return a picture as an element of its own, which needs no file."""
    out = io.BytesIO()
    figure.savefig(out, format="png")
    return _image(out.getvalue())


def shown(picture: Path) -> str:
    """Return a picture that a run wrote as an element; nothing where it is not there."""
    return _image(picture.read_bytes()) if picture.is_file() else ""


def _image(png: bytes) -> str:
    data = base64.b64encode(png).decode()
    return f'<img style="max-width:100%" src="data:image/png;base64,{data}">'

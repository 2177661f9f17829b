"""HTML cards for notebooks, with titled tables of names and values, and pictures."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def pairs(rows: Iterable[tuple[str, str]]) -> str:
    """Return a table of names and values, one row each."""
    body = "".join(
        f"<tr><th>{html.escape(name)}</th><td>{html.escape(words)}</td></tr>"
        for name, words in rows
    )
    return f'<table class="pairs"><tbody>{body}</tbody></table>'


def card(title: str, rows: Iterable[tuple[str, str]]) -> str:
    """Return a titled table of names and values."""
    return f"<p><strong>{html.escape(title)}</strong></p>{pairs(rows)}"


def inline_picture(figure: Figure) -> str:
    """Return a picture as an inline element, without a file."""
    out = io.BytesIO()
    figure.savefig(out, format="png")
    return _image(out.getvalue())


def run_picture(picture: Path) -> str:
    """Return a picture of a run as an element; empty if it is missing."""
    return _image(picture.read_bytes()) if picture.is_file() else ""


def _image(png: bytes) -> str:
    data = base64.b64encode(png).decode()
    return f'<img style="max-width:100%" src="data:image/png;base64,{data}">'

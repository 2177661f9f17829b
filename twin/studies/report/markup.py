"""HTML elements of pages: headings, lists, tables, pictures and whole pages."""

from __future__ import annotations

import html
import io
import math
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.text import Text

from twin.host.atomic_files import save_png

_LONG = 17
"""Longer words may be broken across lines on narrow pages [letters]."""

_LEAST_TEXT_PX = 10.0
"""Least size of text in a picture: on narrow pages the picture is wider and scrolls."""

_NUMBER = r"[-+]?\d[\d.]*(?: (?:%|s|mm|m)(?!\w))?"
_UNBROKEN = re.compile(rf"(?:at (?:least|most) )?{_NUMBER}(?: (?:to|±) {_NUMBER})?")
"""Numbers with their units, and intervals, which stay on one line."""


def escape_text(words: object) -> str:
    """Return words as HTML; numbers with their units and intervals are not broken across lines."""
    unbroken = _UNBROKEN.sub(lambda own: own[0].replace(" ", "\u00a0"), str(words))
    return html.escape(unbroken)


def breakable(words: object) -> str:
    """Return words as HTML; long ones may be broken behind dots and underscores."""
    return re.sub(
        rf"\S{{{_LONG},}}",
        lambda long: re.sub(r"([._])", r"\1<wbr>", long[0]),
        escape_text(words),
    )


def heading(words: str, level: int = 2) -> str:
    """Return a heading."""
    return f"<h{level}>{escape_text(words)}</h{level}>"


def paragraph(words: str, kind: str = "") -> str:
    """Return a paragraph of a class."""
    return (
        f'<p class="{kind}">{escape_text(words)}</p>'
        if kind
        else f"<p>{escape_text(words)}</p>"
    )


def bullets(title: str, texts: Sequence[str]) -> str:
    """Return a list with its heading, nothing where there are no entries."""
    items = "".join(f"<li>{escape_text(words)}</li>" for words in texts)
    return f"{heading(title)}<ul>{items}</ul>" if items else ""


def table(
    caption: str, head: Sequence[str], rows: Iterable[Iterable[str]], kind: str = ""
) -> str:
    """Return a table of cells that are HTML already; nothing where there are no rows."""
    body = "".join(
        "<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows
    )
    names = "".join(f"<th>{breakable(name)}</th>" for name in head)
    return (
        f'<table class="{kind}"><caption>{escape_text(caption)}</caption>'
        f"<thead><tr>{names}</tr></thead><tbody>{body}</tbody></table>"
        if body
        else ""
    )


def text_table(
    caption: str, content: tuple[Sequence[str], Iterable[Iterable[str]]], kind: str = ""
) -> str:
    """Return a table of words, its head and its rows given; nothing where there are no rows."""
    head, rows = content
    return table(caption, head, [map(escape_text, row) for row in rows], kind)


def picture(figure: Figure, name: str) -> str:
    """Return a picture as an SVG element, the same bytes for the same picture.

    Args:
        figure: the picture.
        name: of the picture on its page, which its identifiers begin with.
    """
    out = io.StringIO()
    with rc_context({"svg.hashsalt": name}):
        figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
    svg = out.getvalue()
    sizes = [
        float(text.get_fontsize())
        for text in figure.findobj(Text)
        if isinstance(text, Text) and text.get_text().strip() and text.get_visible()
    ]
    points = 72.0 * figure.get_figwidth()
    width = _LEAST_TEXT_PX * points / min(sizes, default=_LEAST_TEXT_PX)
    style = f'style="min-width:{math.ceil(width)}px" '
    begin = svg.index("<svg") + len("<svg ")
    return f"<figure><svg {style}{svg[begin:]}</figure>"


def save_and_embed_picture(folder: Path, figure: Figure, name: str) -> str:
    """Write a picture into a folder as PNG, and return it for a page; see picture.

    Raises:
        OutputError: it cannot be written.
    """
    save_png(figure, folder / f"{name}.png")
    # All is in its place, and to find it takes as long as to draw.
    figure.set_layout_engine("none")
    return picture(figure, name)


def page(title: str, css: str, pieces: Iterable[str]) -> str:
    """Return a page that needs no network.

    Args:
        title: of it.
        css: its style sheet.
        pieces: of HTML; those that are empty are left out.
    """
    parts = [
        "<!doctype html>",
        '<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width">',
        f"<title>{escape_text(title)}</title><style>{css}</style></head><body>",
        heading(title, 1),
        *pieces,
        "</body></html>",
    ]
    return "\n".join(part for part in parts if part) + "\n"

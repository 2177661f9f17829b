"""Checks of the text of STEP files (ISO 10303-21) before the CAD kernel reads them: errors name the line."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import networkx as nx

from planning.errors import RequestError

_FIRST = b"ISO-10303-21;"
_LAST = b"END-ISO-10303-21;"

_TOKENS = re.compile(
    rb"(?P<text>'(?:[^']|'')*')|(?P<comment>/\*.*?\*/)"
    rb"|#(?P<number>\d{1,18})(?P<defined>\s*=)?|(?P<data>\bDATA\s*(?:\([^;]*\))?\s*;)"
    rb"|(?P<end>\bENDSEC\s*;)",
    re.DOTALL,
)
"""Strings and comments first, so that what is in them is no entity."""

_POINT = re.compile(
    rb"\bCARTESIAN_POINT\s*\(\s*'(?:[^']|'')*'\s*,\s*\(([^()]*)\)", re.DOTALL
)

_FARTHEST = 1e9
"""Greatest coordinate of a point, in the unit of the file: a kilometre in micrometres."""

_SCHEMA = re.compile(rb"\bFILE_SCHEMA\s*\(\s*\(\s*'([^']*)'", re.DOTALL)

_SCHEMAS = (
    b"CONFIG_CONTROL_DESIGN",
    b"AUTOMOTIVE_DESIGN",
    b"AP203",
    b"AP214",
    b"AP242",
)
"""What the name of a schema begins with whose products have shapes."""


def check_step_text(path: Path, content: bytes) -> None:
    """Raise an error if a file is no STEP file, is cut off, or has entities that are missing or given twice.

    Raises:
        RequestError: with file and line.
    """
    for place, words in _problems(content):
        raise RequestError(f"{path}:{_line(content, place)}:1: {words}")


def _line(content: bytes, place: int) -> int:
    return content.count(b"\n", 0, place) + 1


def _problems(content: bytes) -> Iterator[tuple[int, str]]:
    """Yield what is wrong, with its place in the content."""
    if not content.strip():
        yield 0, "the file is empty: a STEP file begins with ISO-10303-21;"
    if not content.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(_FIRST):
        yield 0, "this is no STEP file: it does not begin with ISO-10303-21;"
    if b"HEADER" not in content[:100_000]:
        yield 0, "the STEP file has no HEADER"
    schema = _SCHEMA.search(content)
    if schema is None:
        yield content.find(b"HEADER"), "the header has no FILE_SCHEMA"
    elif not schema[1].strip().upper().startswith(_SCHEMAS):
        words = f"schema {_shown(schema[1])} is not known: export it as AP203, AP214"
        yield schema.start(1), f"{words} or AP242"
    if not content.rstrip().endswith(_LAST):
        words = "the file is cut off: it does not end with END-ISO-10303-21;"
        yield len(content.rstrip()), words
    defined: dict[int, int] = {}
    used: dict[int, int] = {}
    for place, number, owner in _entities(content):
        if owner is not None:
            used.setdefault(number, place)
        elif number in defined:
            first = f"first in line {_line(content, defined[number])}"
            yield place, f"entity #{number} is given twice, {first}"
        else:
            defined[number] = place
    if not defined:
        yield (
            max(content.find(b"DATA"), 0),
            "the file has no entities in its DATA section",
        )
    for number, place in used.items():
        if number not in defined:
            yield place, f"entity #{number} is not in the file"
    for point in _POINT.finditer(content):
        for text in point[1].split(b","):
            if not _is_plausible(text):
                words = f"coordinate {_shown(text)} is no number up to {_FARTHEST:g}"
                yield point.start(), words


def _shown(text: bytes) -> str:
    return repr(text.strip().decode("ascii", "replace")[:60])


def _is_plausible(text: bytes) -> bool:
    try:
        return abs(float(text)) <= _FARTHEST
    except ValueError:
        return False


def _entities(content: bytes) -> Iterator[tuple[int, int, int | None]]:
    """Yield place and number of each entity that is given or referred to, and by which; None where it is given."""
    in_data, owner = False, 0
    for token in _TOKENS.finditer(content):
        if token.lastgroup in ("data", "end"):
            in_data = token.lastgroup == "data"
        elif in_data and token["number"] is not None:
            number = int(token["number"])
            if token["defined"] is not None:
                owner = number
                yield token.start(), number, None
            else:
                yield token.start(), number, owner


def place_of_circle(path: Path, content: bytes) -> str:
    """Return a file, with line and entity where one refers to itself, directly or by others."""
    places: dict[int, int] = {}
    graph: nx.DiGraph[int] = nx.DiGraph()
    for place, number, owner in _entities(content):
        if owner is None:
            places.setdefault(number, place)
        else:
            graph.add_edge(owner, number)
    for part in nx.strongly_connected_components(graph):
        if len(part) > 1 or graph.has_edge(*2 * tuple(part)):
            first = min(part, key=lambda number: places.get(number, 0))
            others = f", by {len(part) - 1} others" if len(part) > 1 else ""
            line = _line(content, places.get(first, 0))
            return f"{path}:{line}:1: entity #{first} refers to itself{others}"
    return str(path)

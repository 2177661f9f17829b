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

    Args:
        path: of the file, for messages.
        content: of the file.

    Raises:
        RequestError: with file and line.
    """
    for problem in _problems(content):
        place, words = problem
        line = content.count(b"\n", 0, place) + 1
        raise RequestError(f"{path}:{line}:1: {words}")


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
        name = schema[1].decode("ascii", "replace")[:60]
        yield (
            schema.start(1),
            f"schema {name!r} is not known: export it as AP203, AP214 or AP242",
        )
    last = content.rstrip()
    if not last.endswith(_LAST):
        yield len(last), "the file is cut off: it does not end with END-ISO-10303-21;"
    yield from _entity_problems(content)
    for point in _POINT.finditer(content):
        for text in point[1].split(b","):
            if not _is_plausible(text):
                words = text.strip().decode("ascii", "replace")[:40]
                yield (
                    point.start(),
                    f"coordinate {words!r} is no number up to {_FARTHEST:g}",
                )


def _is_plausible(text: bytes) -> bool:
    try:
        return abs(float(text)) <= _FARTHEST
    except ValueError:
        return False


def circle_of_entities(content: bytes) -> str | None:
    """Return in words the first entity that refers to itself, directly or by others; None if there is none."""
    places: dict[int, int] = {}
    edges: list[tuple[int, int]] = []
    own = None
    for token in _TOKENS.finditer(content):
        if token["number"] is None:
            continue
        number = int(token["number"])
        if token["defined"] is not None:
            own = number
            places.setdefault(number, token.start())
        elif own is not None:
            edges.append((own, number))
    graph: nx.DiGraph[int] = nx.DiGraph(edges)
    circle = next(
        (
            part
            for part in nx.strongly_connected_components(graph)
            if len(part) > 1 or graph.has_edge(*2 * tuple(part))
        ),
        None,
    )
    if circle is None:
        return None
    first = min(circle, key=lambda number: places.get(number, 0))
    line = content.count(b"\n", 0, places.get(first, 0)) + 1
    return f"{line}:1: entity #{first} refers to itself" + (
        f", by {len(circle) - 1} others" if len(circle) > 1 else ""
    )


def _entity_problems(content: bytes) -> Iterator[tuple[int, str]]:
    defined: dict[int, int] = {}
    used: dict[int, int] = {}
    in_data = False
    for token in _TOKENS.finditer(content):
        kind = token.lastgroup
        if kind == "data":
            in_data = True
        elif kind == "end":
            in_data = False
        elif in_data and token["number"] is not None:
            number = int(token["number"])
            if token["defined"] is None:
                used.setdefault(number, token.start())
            elif number in defined:
                line = content.count(b"\n", 0, defined[number]) + 1
                yield (
                    token.start(),
                    f"entity #{number} is given twice, first in line {line}",
                )
            else:
                defined[number] = token.start()
    if not defined:
        yield (
            max(content.find(b"DATA"), 0),
            "the file has no entities in its DATA section",
        )
    for number, place in used.items():
        if number not in defined:
            yield place, f"entity #{number} is not in the file"

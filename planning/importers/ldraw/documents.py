"""Lines of an LDraw file: models with their references to parts and to each other.

A ``.ldr`` file is one model. A ``.mpd`` file holds several, each after ``0 FILE name``; the first
is the whole, which refers to the others. Colours and steps are counted, lines and faces (types 2
to 5), which only draw, too.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from planning.importers.brick_models.model import FileFaults
from planning.importers.ldraw.colours import Colour, definition
from planning.transforms import Array

_COLOUR = re.compile(r"[+-]?\d{1,10}|(0x|#)[0-9a-fA-F]{6,8}", re.ASCII)
_REFERENCE = 15
_LARGEST = 1e7

FORM = (
    "a line starts with 0 to 5; a part is a line such as"
    " '1 4 20 -24 0 1 0 0 0 1 0 0 0 1 3001.dat': 1, colour, x y z, nine of its rotation, file"
)


@dataclass(frozen=True)
class Reference:
    """A part or a model in a model.

    Attributes:
        line: of the file, from 1.
        pose: in the model, shape (4, 4), lengths in LDraw units.
        name: of the file it refers to, in small letters.
        colour: as written.
    """

    line: int
    pose: Array
    name: str
    colour: str


@dataclass
class Document:
    """The models of a file by name, in small letters; the first is the whole.

    Attributes:
        models: references of each.
        drawn: how many lines of types 2 to 5 there are.
        steps: how many steps end.
        colours: that the file defines, by code.
    """

    models: dict[str, list[Reference]] = field(default_factory=dict)
    drawn: Counter[str] = field(default_factory=Counter)
    steps: int = 0
    colours: dict[int, Colour] = field(default_factory=dict)


def read_document(path: Path, lines: Sequence[str]) -> Document:
    """Return the models of a file.

    Args:
        path: of the file, for messages.
        lines: of the file.

    Raises:
        ScenarioError: lines that are no LDraw, or two models of one name; each by its number.
    """
    faults, document = FileFaults(path), Document()
    here: list[Reference] | None = document.models.setdefault("", [])
    for number, line in enumerate(lines, start=1):
        words = line.split(None, _REFERENCE - 1)
        if not words:
            continue
        if words[0] == "1":
            found = _reference(words, number)
            if isinstance(found, str):
                faults.add(number, found)
            elif here is not None:
                here.append(found)
        elif words[0] in ("2", "3", "4", "5"):
            document.drawn[words[0]] += 1
        elif words[0] != "0":
            faults.add(number, f"{line.strip()[:30]!r} is no line of LDraw")
        elif len(words) > 1 and words[1].upper() in ("FILE", "NOFILE"):
            name = file_name(line.split(None, 2)[2] if len(words) > 2 else "")
            here = None
            if words[1].upper() == "FILE":
                if name in document.models:
                    faults.add(number, f"a model before it is called {name!r}, too")
                here = document.models.setdefault(name, [])
        elif len(words) > 1 and words[1].upper() == "STEP":
            document.steps += 1
        elif (found_colour := definition(line)) is not None:
            code, colour = found_colour
            document.colours[code] = colour
    faults.check(form=FORM)
    if not document.models[""] and len(document.models) > 1:
        del document.models[""]
    return document


def file_name(text: str) -> str:
    """Return the name of a file as references compare it."""
    return text.strip().strip('"').replace("\\", "/").casefold()


def _reference(words: Sequence[str], number: int) -> Reference | str:
    """Return the reference of a line, or what is wrong with it."""
    if len(words) < _REFERENCE:
        return f"a part has {_REFERENCE} values, this line {len(words)}"
    if not _COLOUR.fullmatch(words[1]):
        return f"{words[1][:20]!r} is no colour"
    values = []
    for text in words[2:14]:
        try:
            value = float(text)
        except ValueError:
            return f"{text[:20]!r} is no number"
        if not abs(value) <= _LARGEST:
            return f"{text[:20]} is no length or direction"
        values.append(value)
    pose = np.eye(4)
    pose[:3, 3] = values[:3]
    pose[:3, :3] = np.reshape(values[3:], (3, 3))
    return Reference(number, pose, file_name(words[14]), words[1].casefold())

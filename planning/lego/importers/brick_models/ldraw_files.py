"""Lines of an LDraw file: models with references to parts and to other models, and colours.

A ``.ldr`` file contains one model. A ``.mpd`` file contains several, each after a line ``0 FILE name``. The first one
is the main model; it refers to the others. Building steps are only counted, and so are lines of types 2 to 5, which
draw edges and faces.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

import numpy as np

from planning.errors import ScenarioError
from planning.lego.bricks.assembly import BrickType
from planning.lego.bricks.brick_types import brick_of_size
from planning.lego.importers.brick_models.model import check_faults
from planning.transforms import Array

Colour = tuple[int, int, int]
"""Red, green and blue, 0 to 255."""

INHERITED = ("16", "24")
"""Codes of the colour of the surrounding model."""

_VALUES = """
0:05131D 1:0055BF 2:257A3E 3:00838F 4:C91A09 5:C870A0 6:583927 7:9BA19D 8:6D6E5C 9:B4D2E3 10:4B9F4A 11:55A5AF
12:F2705E 13:FC97AC 14:F2CD37 15:FFFFFF 17:C2DAB8 18:FBE696 19:E4CD9E 20:C9CAE2 22:81007B 23:2032B0 25:FE8A18
26:923978 27:BBE90B 28:958A73 29:E4ADC8 30:AC78BA 31:E1D5ED 68:F3CF9B 69:CD6298 70:582A12 71:A0A5A9 72:6C6E68
73:5C9DD1 74:73DCA1 77:FECCCF 78:F6D7B3 84:CC702A 85:3F3691 86:7C503A 89:4C61DB 151:E6E3E0 191:F8BB3D 212:86C1E1
216:B31004 226:FFF03A 232:56BED6 272:0D325B 288:184632 308:352100 313:54A9C8 320:720E0F 321:1498D7 322:3EC2DD
323:BDDCD8 326:DFEEA5 330:9B9A5A 335:D67572 351:F785B1 366:FA9C1C 373:845E84 378:A0BCAC 379:597184 450:B67B50
462:FFA70B 484:A95500 503:E6E3DA 33:0020A0 36:C91A09 40:635F52 47:FCFCFC 57:F08F1C
"""
"""Opaque colours, and the commonest of those that one sees through, as LeoCAD shows them: code and red, green, blue."""

_COLOURS = {
    int(code): int(value, 16)
    for code, value in (item.split(":") for item in _VALUES.split())
}

_WRITTEN = re.compile(r"(?:0x[0-9a-f]{1,2}|#)?([0-9a-f]{6})")
_DEFINED = re.compile(
    r"0\s+!COLOUR\s+\S+\s+CODE\s+(\d{1,9})\s+VALUE\s+#([0-9A-Fa-f]{6})\b"
)
_COLOUR = re.compile(r"[+-]?\d{1,10}|(0x|#)[0-9a-fA-F]{6,8}", re.ASCII)
_REFERENCE = 15
_LONGEST = 10_000
_LARGEST = 1e7

FORM = (
    "a line starts with 0 to 5; a part is a line such as"
    " '1 4 20 -24 0 1 0 0 0 1 0 0 0 1 3001.dat': 1, colour, x y z, nine of its rotation, file"
)

_NUMBERS = """
1x1x3:3005 1x2x3:3004 1x3x3:3622 1x4x3:3010 1x6x3:3009 1x8x3:3008 2x2x3:3003 2x3x3:3002 2x4x3:3001
2x6x3:2456,44237 2x8x3:3007 1x1x1:3024 1x2x1:3023,3023a,3023b 1x3x1:3623 1x4x1:3710 1x6x1:3666 1x8x1:3460
2x2x1:3022 2x3x1:3021 2x4x1:3020 2x6x1:3795 2x8x1:3034
"""
"""Parts by studs and height in thirds of a brick."""

_LARGER = """
1x10x3:6111 1x12x3:6112 1x16x3:2465 2x10x3:3006 4x6x3:2356 4x10x3:6212 4x12x3:4202 8x8x3:4201 8x16x3:4204
1x1x9:14716 1x2x9:22886 1x4x9:49311 1x2x6:3245,3245a,3245b,3245c 2x2x9:30145 1x1x15:2453,2453a,2453b 1x3x15:3755
1x2x15:2454,2454a,2454b 1x6x15:3754 2x4x9:30144 2x6x9:6213 1x5x1:78329 1x10x1:4477 1x12x1:60479 2x10x1:3832
2x12x1:2445 2x14x1:91988 2x16x1:4282 3x3x1:11212 4x4x1:3031 4x6x1:3032 4x8x1:3035 4x10x1:3030 4x12x1:3029
6x6x1:3958 6x8x1:3036 6x10x1:3033 6x12x1:3028 6x14x1:3456 6x16x1:3027 6x24x1:3026 8x8x1:41539 8x16x1:92438
16x16x1:91405
"""
"""Further parts; scenarios write their types themselves."""


PARTS: Mapping[str, BrickType] = MappingProxyType(
    {
        number: brick_of_size((int(x), int(y)), int(height))
        for item in (_NUMBERS + _LARGER).split()
        for x, y, height, numbers in [re.split("[x:]", item)]
        for number in numbers.split(",")
    }
)
"""Brick types by the number of their part."""

_BASEPLATES = frozenset(
    ("3497", "3334", "3645", "3811", "3857", "3865", "3867", "4186", "4187")
)
"""Thin plates that models stand on, from 8 x 16 to 48 x 48 studs."""

_OF_SIZE = {
    (tuple(sorted(brick.studs)), brick.height): number
    for number, brick in reversed(list(PARTS.items()))
}

# Printed ones have a p and more behind the number, such as 3005p01.
_PRINTED = re.compile(r"(\d+[ab]?)p\w*")


def colour_of(text: str, defined: Mapping[int, Colour]) -> Colour | None:
    """Return the colour of a part, as written in small letters, None where it is not known.

    It is a code, with those that the file defines, or ``0x2rrggbb``.
    """
    if text.startswith(("0x", "#")):
        written = _WRITTEN.fullmatch(text)
        return None if written is None else _split(int(written[1], 16))
    code = int(text)
    if code in defined:
        return defined[code]
    return _split(_COLOURS[code]) if code in _COLOURS else None


def _split(value: int) -> Colour:
    return value >> 16, value >> 8 & 255, value & 255


@dataclass(frozen=True)
class Reference:
    """A reference to a part or to a submodel.

    Attributes:
        line: of the file, from 1.
        pose: in the model, shape (4, 4), lengths in LDraw units.
        name: of the file it refers to, in small letters.
        colour: as written; in the whole model that of the model around it where it takes that.
        via: in the whole model, lines of the references that lead to it, the outermost first.
    """

    line: int
    pose: Array
    name: str
    colour: str
    via: tuple[int, ...] = ()

    @property
    def source(self) -> str:
        """Its location, such as ``"line 12 by way of line 3"``."""
        return f"line {self.line}{self._reference_chain}"

    @property
    def words(self) -> str:
        """Its file and reference chain, such as ``"3001.dat by way of line 3"``."""
        return f"{self.name}{self._reference_chain}"

    @property
    def _reference_chain(self) -> str:
        return "".join(f" by way of line {k}" for k in reversed(self.via))


@dataclass
class Document:
    """The models of a file by lower-case name; the first is the main model.

    Attributes:
        models: references of each.
        drawn: how many lines of types 2 to 5 there are.
        steps: how many steps end.
        colours: that the file defines, by code.
        parts: numbered lines of the parts that the file brings along.
    """

    models: dict[str, list[Reference]] = field(default_factory=dict)
    drawn: int = 0
    steps: int = 0
    colours: dict[int, Colour] = field(default_factory=dict)
    parts: dict[str, list[tuple[int, str]]] = field(default_factory=dict)


def read_document(path: Path, lines: Sequence[str]) -> Document:
    """Return the models of a file, given its lines.

    Raises:
        ScenarioError: lines that are no LDraw, or two models of one name; each by its number.
    """
    faults, document = list[tuple[int, str]](), Document()
    here: list[Reference] | None = document.models.setdefault("", [])
    name, first, drawn, is_part = "", 1, 0, False

    def finish(last: int) -> None:
        """Keep a model that is a part of the library as such."""
        if here is not None and name.endswith(".dat") and (drawn or is_part):
            document.parts[name] = list(enumerate(lines[first - 1 : last], first))
            if name != next(iter(document.models)):
                del document.models[name]
        else:
            document.drawn += drawn

    for number, line in enumerate(lines, start=1):
        words = line.split(None, _REFERENCE - 1)
        if not words:
            continue
        if len(line) > _LONGEST:
            faults.append((number, f"a line of {len(line)} characters"))
        elif words[0] == "1":
            try:
                found = read_reference(words, number)
            except ScenarioError as error:
                faults.append((number, str(error)))
                continue
            if here is not None:
                here.append(found)
        elif words[0] in ("2", "3", "4", "5"):
            drawn += 1
        elif words[0] != "0":
            faults.append((number, f"{line.strip()[:30]!r} is no line of LDraw"))
        elif len(words) > 1 and words[1].upper() in ("FILE", "NOFILE"):
            finish(number - 1)
            name = _file_name(line.split(None, 2)[2] if len(words) > 2 else "")
            here, first, drawn, is_part = None, number, 0, False
            # Packed files bring some parts twice.
            if words[1].upper() == "FILE" and name not in document.parts:
                if name in document.models:
                    what = f"a model before it is called {name!r}, too"
                    faults.append((number, what))
                here = document.models.setdefault(name, [])
        elif len(words) > 1 and words[1].upper() == "STEP":
            document.steps += 1
        elif len(words) > 2 and words[1].upper() == "!LDRAW_ORG":
            is_part = "MODEL" not in words[2].upper()
        else:
            document.colours |= read_colour(line)
    finish(len(lines))
    check_faults(path, faults, FORM)
    if not document.models[""] and len(document.models) > 1:
        del document.models[""]
    return document


def read_colour(line: str) -> dict[int, Colour]:
    """Return the colour that a line defines, by its code; nothing where it defines none."""
    found = _DEFINED.match(line.strip())
    return {} if found is None else {int(found[1]): _split(int(found[2], 16))}


def _file_name(text: str) -> str:
    """Return the name of a file, normalised as references are."""
    name = text.strip().strip('"').replace("\\", "/").casefold()
    return name.removeprefix("parts/").removeprefix("p/")


def read_reference(words: Sequence[str], number: int) -> Reference:
    """Return the reference of a line; ScenarioError where it has a fault."""
    if len(words) < _REFERENCE:
        raise ScenarioError(f"a part has {_REFERENCE} values, this line {len(words)}")
    if not _COLOUR.fullmatch(words[1]):
        raise ScenarioError(f"{words[1][:20]!r} is no colour")
    values = read_numbers(words[2:14])
    pose = np.eye(4)
    pose[:3, 3] = values[:3]
    pose[:3, :3] = np.reshape(values[3:], (3, 3))
    return Reference(number, pose, _file_name(words[14]), words[1].casefold())


def read_numbers(words: Sequence[str]) -> list[float]:
    """Return the lengths or directions of a line; ScenarioError where one has a fault."""
    values = []
    for text in words:
        try:
            values.append(float(text))
        except ValueError:
            raise ScenarioError(f"{text[:20]!r} is no number") from None
        if not abs(values[-1]) <= _LARGEST:
            raise ScenarioError(f"{text[:20]} is no length or direction")
    return values


def brick_type_of_file(name: str) -> BrickType | None:
    """Return the brick type of a part by its file name, None where it is no brick.

    Printed bricks are bricks.
    """
    number = name.removesuffix(".dat")
    printed = _PRINTED.fullmatch(number)
    return PARTS.get(printed[1] if printed else number)


def is_baseplate(name: str) -> bool:
    """Tell by its file name whether a part is a base plate."""
    return name.removesuffix(".dat") in _BASEPLATES


def part_number(size: tuple[int, int], height: int) -> str | None:
    """Return the part number of a size in studs and levels, None where there is none."""
    return _OF_SIZE.get(((min(size), max(size)), height))


def format_part_table() -> tuple[str, ...]:
    """Return the parts in words, such as ``"3001 (2x4)"``."""
    first = (re.split("[:,]", item)[1] for item in _NUMBERS.split())
    return tuple(f"{number} ({PARTS[number].name})" for number in first)

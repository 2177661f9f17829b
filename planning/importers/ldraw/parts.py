"""Parts of the LDraw library that are bricks or plates, and their sizes.

The origin of each is in the middle of its top face, its longer side along x.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from types import MappingProxyType

from planning.lego.bricks.assembly import BRICKS, BrickType

STUD, LEVEL = 20, 8
"""Distance of studs, and height of a plate; a brick is three times as high [LDraw units]."""

_NUMBERS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "1x1": ("3005",),
        "1x2": ("3004",),
        "1x3": ("3622",),
        "1x4": ("3010",),
        "1x6": ("3009",),
        "1x8": ("3008",),
        "2x2": ("3003",),
        "2x3": ("3002",),
        "2x4": ("3001",),
        "2x6": ("2456", "44237"),
        "2x8": ("3007",),
        "1x1-plate": ("3024",),
        "1x2-plate": ("3023", "3023a", "3023b"),
        "1x3-plate": ("3623",),
        "1x4-plate": ("3710",),
        "1x6-plate": ("3666",),
        "1x8-plate": ("3460",),
        "2x2-plate": ("3022",),
        "2x3-plate": ("3021",),
        "2x4-plate": ("3020",),
        "2x6-plate": ("3795",),
        "2x8-plate": ("3034",),
    }
)

PARTS: Mapping[str, BrickType] = MappingProxyType(
    {number: BRICKS[kind] for kind, all_ in _NUMBERS.items() for number in all_}
)
"""Brick types by the number of their part."""

_BASEPLATES = frozenset(
    ("3497", "3334", "3645", "3811", "3857", "3865", "3867", "4186", "4187")
)
"""Thin plates that models stand on, from 8 x 16 to 48 x 48 studs."""

_OF_SIZE = {
    (tuple(sorted(BRICKS[kind].studs)), BRICKS[kind].height): numbers[0]
    for kind, numbers in _NUMBERS.items()
}

# Printed ones have a p and more behind the number, such as 3005p01.
_PRINTED = re.compile(r"(\d+[ab]?)p\w*")


def part_of(name: str) -> BrickType | None:
    """Return the brick type of a part by the name of its file, None where it is none.

    Printed bricks are bricks.
    """
    number = name.removesuffix(".dat")
    printed = _PRINTED.fullmatch(number)
    return PARTS.get(printed[1] if printed else number)


def is_baseplate(name: str) -> bool:
    """Tell by the name of its file whether a part is a base plate, on which bricks stand."""
    return name.removesuffix(".dat") in _BASEPLATES


def number_of(size: tuple[int, int], height: int) -> str | None:
    """Return the number of the part of a size in studs and levels, None where there is none."""
    return _OF_SIZE.get(((min(size), max(size)), height))


def table() -> tuple[str, ...]:
    """Return the parts in words, such as ``"3001 (2x4)"``."""
    return tuple(f"{numbers[0]} ({kind})" for kind, numbers in _NUMBERS.items())

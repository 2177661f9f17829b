"""Colours of LDraw: codes of its configuration file, and colours written as they are."""

from __future__ import annotations

import re
from collections.abc import Mapping
from types import MappingProxyType

Colour = tuple[int, int, int]
"""Red, green and blue, 0 to 255."""

INHERITED = ("16", "24")
"""Codes that stand for the colour of the model around."""

_VALUES: Mapping[int, int] = MappingProxyType(
    {
        **{0: 0x05131D, 1: 0x0055BF, 2: 0x257A3E, 3: 0x00838F, 4: 0xC91A09, 5: 0xC870A0},
        **{6: 0x583927, 7: 0x9BA19D, 8: 0x6D6E5C, 9: 0xB4D2E3, 10: 0x4B9F4A, 11: 0x55A5AF},
        **{12: 0xF2705E, 13: 0xFC97AC, 14: 0xF2CD37, 15: 0xFFFFFF, 17: 0xC2DAB8},
        **{18: 0xFBE696, 19: 0xE4CD9E, 20: 0xC9CAE2, 22: 0x81007B, 23: 0x2032B0},
        **{25: 0xFE8A18, 26: 0x923978, 27: 0xBBE90B, 28: 0x958A73, 29: 0xE4ADC8},
        **{30: 0xAC78BA, 31: 0xE1D5ED, 68: 0xF3CF9B, 69: 0xCD6298, 70: 0x582A12},
        **{71: 0xA0A5A9, 72: 0x6C6E68, 73: 0x5C9DD1, 74: 0x73DCA1, 77: 0xFECCCF},
        **{78: 0xF6D7B3, 84: 0xCC702A, 85: 0x3F3691, 86: 0x7C503A, 89: 0x4C61DB},
        **{151: 0xE6E3E0, 191: 0xF8BB3D, 212: 0x86C1E1, 216: 0xB31004, 226: 0xFFF03A},
        **{232: 0x56BED6, 272: 0x0D325B, 288: 0x184632, 308: 0x352100, 313: 0x54A9C8},
        **{320: 0x720E0F, 321: 0x1498D7, 322: 0x3EC2DD, 323: 0xBDDCD8, 326: 0xDFEEA5},
        **{330: 0x9B9A5A, 335: 0xD67572, 351: 0xF785B1, 366: 0xFA9C1C, 373: 0x845E84},
        **{378: 0xA0BCAC, 379: 0x597184, 450: 0xB67B50, 462: 0xFFA70B, 484: 0xA95500},
        **{503: 0xE6E3DA, 33: 0x0020A0, 36: 0xC91A09, 40: 0x635F52, 47: 0xFCFCFC},
        **{57: 0xF08F1C},
    }
)  # fmt: skip
"""Opaque colours, and the commonest of those that one sees through, as LeoCAD shows them."""

_WRITTEN = re.compile(r"(?:0x[0-9a-f]{1,2}|#)?([0-9a-f]{6})")
_DEFINED = re.compile(
    r"0\s+!COLOUR\s+\S+\s+CODE\s+(\d{1,9})\s+VALUE\s+#([0-9A-Fa-f]{6})\b"
)


def colour_of(text: str, defined: Mapping[int, Colour]) -> Colour | None:
    """Return the colour of a part, None where it is not known.

    Args:
        text: as written, in small letters: a code, or ``0x2rrggbb``.
        defined: colours that the file defines, by code.
    """
    if text.startswith(("0x", "#")):
        written = _WRITTEN.fullmatch(text)
        return None if written is None else _split(int(written[1], 16))
    code = int(text)
    if code in defined:
        return defined[code]
    return _split(_VALUES[code]) if code in _VALUES else None


def definition(line: str) -> tuple[int, Colour] | None:
    """Return the colour that a line defines with its code, None where it defines none."""
    found = _DEFINED.match(line.strip())
    return None if found is None else (int(found[1]), _split(int(found[2], 16)))


def _split(value: int) -> Colour:
    return value >> 16, value >> 8 & 255, value & 255

"""Built-in brick types."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from planning.errors import ScenarioError
from planning.lego.bricks.assembly import BrickType

_MASSES: dict[tuple[int, int], float] = {
    (1, 1): 0.00044,
    (1, 2): 0.0008,
    (1, 4): 0.0016,
    (1, 6): 0.0023,
    (1, 8): 0.00308,
    (2, 2): 0.0012,
    (2, 4): 0.0022,
    (2, 6): 0.00328,
}

BRICKS: Mapping[str, BrickType] = MappingProxyType(
    {
        f"{short}x{long}": BrickType(f"{short}x{long}", (short, long), mass)
        for (short, long), mass in _MASSES.items()
    }
)
"""Types every scenario may use, by name such as ``"2x4"``."""


def brick_type(name: str, bricks: Mapping[str, BrickType] = BRICKS) -> BrickType:
    """Return the brick type called ``name``.

    Args:
        name: such as ``"2x4"``.
        bricks: library to look in.

    Raises:
        ScenarioError: there is no such type; lists those there are.
    """
    try:
        return bricks[name]
    except KeyError:
        raise ScenarioError(
            f"unknown brick type {name!r}", choices=tuple(sorted(bricks))
        ) from None

"""Brick types that every scenario may use."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from types import MappingProxyType

from planning.lego.bricks.assembly import BRICK_LEVELS, BrickType

# Masses [kg] by studs. Those of 1x3, 2x3 and 2x8 are linear inter- or extrapolations of the others.
_MASSES: dict[tuple[int, int], float] = {
    (1, 1): 0.00044,
    (1, 2): 0.0008,
    (1, 3): 0.0012,
    (1, 4): 0.0016,
    (1, 6): 0.0023,
    (1, 8): 0.00308,
    (2, 2): 0.0012,
    (2, 3): 0.0017,
    (2, 4): 0.0022,
    (2, 6): 0.00328,
    (2, 8): 0.00436,
}

# Catalogues of parts weigh plates of 1 x 4 studs at 0.71 g and of 2 x 3 at 0.93 g; the others of
# their width are in proportion to their studs.
_PLATE_STUD_MASSES = {1: 0.00071 / 4, 2: 0.00093 / 6}

_BRICKS = (BrickType(f"{x}x{y}", (x, y), mass) for (x, y), mass in _MASSES.items())
_PLATES = (
    BrickType(
        f"{x}x{y}-plate", (x, y), round(_PLATE_STUD_MASSES[x] * x * y, 8), height=1
    )
    for x, y in _MASSES
)

BRICKS: Mapping[str, BrickType] = MappingProxyType(
    {brick.name: brick for brick in (*_BRICKS, *_PLATES)}
)
"""Bricks by name, such as ``"2x4"``, and plates, such as ``"2x4-plate"``."""


def brick_of_size(
    studs: tuple[int, int], height: int, bare: frozenset[tuple[int, int]] = frozenset()
) -> BrickType:
    """Return the brick type of a size: that of the library, or one with a mass in proportion to its studs.

    Args:
        studs: along its x and y, the lesser number first.
        height: without its studs [levels].
        bare: studs without a knob; the name tells which have one, as bits.
    """
    x, y = studs
    layers, rest = divmod(height, BRICK_LEVELS)
    names = {1: f"{x}x{y}-plate", BRICK_LEVELS: f"{x}x{y}"}
    name = names.get(height, f"{x}x{y}-{height}" if rest else f"{x}x{y}x{layers}")
    if bare:
        bits = "".join(str(int(at not in bare)) for at in product(range(x), range(y)))
        name += f"-knobs-{int(bits, 2):x}"
    if name in BRICKS:
        return BRICKS[name]
    if height == 1:
        stud_mass = _PLATE_STUD_MASSES[min(x, 2)]
    else:
        stud_mass = _MASSES[min(x, 2), 8] / (min(x, 2) * 8) * height / BRICK_LEVELS
    return BrickType(name, studs, round(stud_mass * x * y, 8), height, bare)

"""Hollow houses of bricks 2x4, laid in bond."""

from planning.lego.bricks.assembly import BRICKS, Cell, PlacedBrick


def hollow_house(
    wide: int, deep: int, high: int, at: tuple[int, int] = (0, 0)
) -> list[PlacedBrick]:
    """Return four walls, one brick 2x4 thick, that bind at their corners and in between.

    Args:
        wide, deep: studs along x and y, multiples of 4 and at least 8.
        high: layers.
        at: the least stud.
    """
    if wide % 4 or deep % 4 or min(wide, deep) < 8:
        raise ValueError(f"no house of {wide} x {deep} studs")
    bricks = []

    def lay(x: int, y: int, z: int, turned: bool) -> None:
        # A brick 2x4 has four studs along y, and along x where it is turned.
        cell = Cell(at[0] + x, at[1] + y, z, turned)
        bricks.append(PlacedBrick(f"b{len(bricks)}", BRICKS["2x4"], cell))

    for z in range(1, high + 1):
        inset = 2 if z % 2 else 0
        for y in (0, deep - 2):
            for x in range(inset, wide - inset, 4):
                lay(x, y, z, True)
        for x in (0, wide - 2):
            for y in range(2 - inset, deep - 2 + inset, 4):
                lay(x, y, z, False)
    return bricks

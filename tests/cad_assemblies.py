"""Assemblies for tests of the import from CAD, modelled with build123d: lengths in mm, z up.

``python tests/cad_assemblies.py NAME FILE.step`` writes one of them.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from math import cos, pi, sin
from pathlib import Path
from typing import Any

# build123d and the CAD kernel take seconds to import, so only where something is modelled.

PLAY = 0.05
"""Play of pins in their holes, all around [mm]."""


def write_step(name: str, file: Path) -> Path:
    """Write an assembly as a STEP file, and return its path."""
    from build123d import export_step

    export_step(ASSEMBLIES[name](), str(file))
    return file


def gearbox() -> Any:
    """Two gears on shafts in a housing, whose cover is held by four screws."""
    from build123d import Box, Cylinder, Pos

    housing = Box(150, 130, 50) - Pos(0, 0, 5) * Box(130, 110, 50)
    for x in (-20.0, 20.0):
        housing += Pos(x, 0, -15) * Cylinder(12, 12)
        housing -= Pos(x, 0, -13) * Cylinder(6 + PLAY, 20)
    shaft = Cylinder(6, 36)
    gear = _gear(18, 2.2, 10) + Pos(0, 0, 12) * Cylinder(11, 14)
    gear -= Cylinder(6 + PLAY, 60)
    cover = Box(150, 130, 8) + Pos(0, 0, 14) * Cylinder(12, 20)
    for x, y in _corners(70, 60):
        cover -= Pos(x, y, 0) * Cylinder(3 + PLAY, 60)
        housing -= Pos(x, y, 0) * Cylinder(3 + PLAY, 200)
    screw = _screw(3.0, 24, 5.5, 14)
    turned = 180 / 18
    return _assembly(
        "gearbox",
        [
            _body("housing", housing, (88, 118, 152), (0, 0, 25)),
            _body("shaft", shaft, (170, 174, 180), (-20, 0, 20)),
            _body("shaft", shaft, (170, 174, 180), (20, 0, 20)),
            _body("gear", gear, (201, 162, 75), (-20, 0, 21)),
            _body("gear", gear, (201, 162, 75), (20, 0, 21), (0, 0, turned)),
            _body("cover", cover, (184, 67, 58), (0, 0, 54)),
            *(
                _body("screw", screw, (70, 74, 82), (x, y, 58))
                for x, y in _corners(70, 60)
            ),
        ],
    )


def valve() -> Any:
    """A piston in a body, a bonnet around its stem held by four screws, and a wheel on the stem."""
    from build123d import Box, Cylinder, Pos

    body = Box(70, 70, 50) - Pos(0, 0, 10) * Cylinder(20 + PLAY, 40)
    piston = Cylinder(20, 15) + Pos(0, 0, 35) * Cylinder(6, 55)
    bonnet = Box(70, 70, 10) + Pos(0, 0, 13) * Cylinder(12, 16)
    bonnet -= Cylinder(6 + PLAY, 60)
    for x, y in _corners(28, 28):
        bonnet -= Pos(x, y, 0) * Cylinder(2.5 + PLAY, 60)
        body -= Pos(x, y, 20) * Cylinder(2.5 + PLAY, 30)
    wheel = Cylinder(30, 6) + Pos(0, 0, 11) * Cylinder(10, 16)
    wheel -= Pos(0, 0, -5) * Cylinder(6 + PLAY, 16)
    screw = _screw(2.5, 18, 4.5, 14)
    return _assembly(
        "valve",
        [
            _body("body", body, (120, 130, 140), (0, 0, 25)),
            _body("piston", piston, (201, 162, 75), (0, 0, 22.5)),
            _body("bonnet", bonnet, (88, 118, 152), (0, 0, 55)),
            *(
                _body("screw", screw, (70, 74, 82), (x, y, 60))
                for x, y in _corners(28, 28)
            ),
            _body("wheel", wheel, (184, 67, 58), (0, 0, 82)),
        ],
    )


def hinge() -> Any:
    """Two leaves, and a pin along the x axis that goes through their knuckles."""
    from build123d import Box, Cylinder, Pos, Rot

    def leaf(side: int, knuckles: list[float]) -> Any:
        plate = Pos(0, side * 28, 0) * Box(100, 40, 14)
        for x in knuckles:
            plate += Pos(x, side * 5, 0) * Box(19.8, 10, 14)
            plate += Pos(x, 0, 0) * Rot(0, 90, 0) * Cylinder(7, 19.8)
        return plate - Rot(0, 90, 0) * Cylinder(4 + PLAY, 200)

    # One leaf has a plate under both, the other one a rib by which it is held.
    first = leaf(-1, [-40, 0, 40]) + Pos(0, 0, -12) * Box(100, 100, 10)
    second = leaf(1, [-20, 20]) + Pos(0, 30, 17) * Box(50, 10, 20)
    # The pin is longer than the hinge on one side, where it is held.
    pin = Rot(0, 90, 0) * Cylinder(4, 140)
    return _assembly(
        "hinge",
        [
            _body("leaf_a", first, (120, 130, 140), (0, 0, 17)),
            _body("leaf_b", second, (88, 118, 152), (0, 0, 17)),
            _body("pin", pin, (201, 162, 75), (20, 0, 17)),
        ],
    )


def drawer() -> Any:
    """Two drawers that slide into a cabinet from its front, -y, and its lid with two dowels."""
    from build123d import Box, Cylinder, Pos

    cabinet = Box(150, 80, 64)
    box = Box(59.8, 70, 29.8) - Pos(0, 0, 5) * Box(50, 60, 29.8)
    # A tongue at the front, by which it is held.
    box += Pos(0, -65, 0) * Box(16, 60, 12)
    lid = Box(60, 70, 16)
    dowel = Cylinder(4, 40)
    for x in (-35, 35):
        cabinet -= Pos(x, -10, -7) * Box(60, 80, 30)
        cabinet -= Pos(x / 35 * 20, 0, 26) * Cylinder(4 + PLAY, 20)
        lid -= Pos(x / 35 * 20, 0, 0) * Cylinder(4 + PLAY, 40)
    return _assembly(
        "drawer",
        [
            _body("cabinet", cabinet, (120, 130, 140), (0, 0, 32)),
            _body("drawer", box, (201, 162, 75), (-35, -5, 24.9)),
            _body("drawer", box, (201, 162, 75), (35, -5, 24.9)),
            _body("lid", lid, (88, 118, 152), (0, 0, 72)),
            _body("dowel", dowel, (170, 174, 180), (-20, 0, 68)),
            _body("dowel", dowel, (170, 174, 180), (20, 0, 68)),
        ],
    )


def stack() -> Any:
    """Three plates on a base, with four screws as pins through all of them."""
    from build123d import Box, Cylinder, Pos

    base, plate = Box(120, 80, 20), Box(90, 56, 12)
    for x, y in _corners(15, 18):
        base -= Pos(x, y, 5) * Cylinder(3 + PLAY, 20)
        plate -= Pos(x, y, 0) * Cylinder(3 + PLAY, 20)
    screw = _screw(3, 48, 5, 14)
    return _assembly(
        "stack",
        [
            _body("base", base, (120, 130, 140), (0, 0, 10)),
            *(
                _body("plate", plate, (88, 118, 152), (0, 0, 26 + 12.0 * k))
                for k in range(3)
            ),
            *(
                _body("screw", screw, (70, 74, 82), (x, y, 56))
                for x, y in _corners(15, 18)
            ),
        ],
    )


def board() -> Any:
    """A board with nineteen pegs in blind holes."""
    from build123d import Box, Cylinder, Pos

    plate, peg = Box(290, 190, 20), Cylinder(8, 40)
    places = [(50.0 * (k % 5) - 100, 50.0 * (k // 5) - 75) for k in range(19)]
    for x, y in places:
        plate -= Pos(x, y, 5) * Cylinder(8 + PLAY, 20)
    return _assembly(
        "board",
        [
            _body("plate", plate, (120, 130, 140), (0, 0, 10)),
            *(_body("peg", peg, (201, 162, 75), (x, y, 25)) for x, y in places),
        ],
    )


def puzzle() -> Any:
    """Three rings on a post, held by a pin across it: they go together in one order only."""
    from build123d import Box, Cylinder, Pos, Rot

    post = Pos(0, 0, 10) * Box(90, 90, 20) + Pos(0, 0, 43) * Cylinder(12, 46)
    post -= Pos(0, 0, 61) * Rot(0, 90, 0) * Cylinder(3 + PLAY, 60)
    rings = [(34, 12), (29, 12), (24, 12)]
    bodies, low = [_body("post", post, (120, 130, 140))], 20.0
    for number, (radius, high) in enumerate(rings):
        ring = Cylinder(radius, high) - Cylinder(12 + PLAY, 60)
        name, colour = f"ring_{number + 1}", (88 + 40 * number, 118, 152 - 40 * number)
        bodies.append(_body(name, ring, colour, (0, 0, low + high / 2)))
        low += high
    pin = Rot(0, 90, 0) * Cylinder(3, 120)
    bodies.append(_body("lock", pin, (201, 162, 75), (0, 0, 61)))
    return _assembly("puzzle", bodies)


def flange() -> Any:
    """Low rings on a post and a cover that is held by bolts with low hexagonal heads."""
    from build123d import Box, Cylinder, Pos, RegularPolygon, extrude

    base = Box(110, 70, 20) + Pos(-25, 0, 22) * Cylinder(9, 24)
    cover = Pos(0, 0, 2) * Box(40, 50, 4)
    for _, y in _corners(0, 18):
        base -= Pos(30, y, 5) * Cylinder(2.5 + PLAY, 20)
        cover -= Pos(0, y, 2) * Cylinder(2.5 + PLAY, 10)
    ring = Cylinder(17, 6) - Cylinder(9 + PLAY, 20)
    bolt = Pos(0, 0, -8) * Cylinder(2.5, 16) + extrude(RegularPolygon(5, 6), 4)
    bodies = [
        _body("base", base, (120, 130, 140), (0, 0, 10)),
        *(_body("ring", ring, (88, 118, 152), (-25, 0, z)) for z in (23, 29)),
        _body("cover", cover, (62, 140, 124), (30, 0, 20)),
        *(_body("bolt", bolt, (70, 74, 82), (30, y, 24)) for y in (-18, 18)),
    ]
    return _assembly("flange", bodies)


def interlocked() -> Any:
    """Two closed links of a chain on a plate, which come out of each other in no order."""
    from build123d import Box

    plate = Box(120, 80, 10)
    link, other = (Box(x, 40, 8) - Box(x - 16, 24, 20) for x in (60, 64))
    return _assembly(
        "interlocked",
        [
            _body("plate", plate, (120, 130, 140), (0, 0, 5)),
            _body("link_a", link, (88, 118, 152), (-16, 0, 30)),
            _body("link_b", other, (201, 162, 75), (22, 0, 30), (90, 0, 0)),
            _body("block", Box(30, 18, 20), (184, 67, 58), (0, -30, 20)),
        ],
    )


def _gear(teeth: int, module: float, high: float) -> Any:
    """Return a gear with straight flanks, a tooth along x."""
    from build123d import Polygon, extrude

    pitch = teeth * module / 2
    corners = []
    for i in range(teeth):
        for radius, share in (
            (pitch - 1.2 * module, -0.32),
            (pitch + 0.8 * module, -0.12),
            (pitch + 0.8 * module, 0.12),
            (pitch - 1.2 * module, 0.32),
        ):
            angle = 2 * pi * (i + share) / teeth
            corners.append((radius * cos(angle), radius * sin(angle)))
    return extrude(Polygon(*corners, align=None), high / 2, both=True)


def _screw(radius: float, length: float, head: float, high: float) -> Any:
    """Return a screw as a pin with a head, whose underside is at the origin."""
    from build123d import Cylinder, Pos

    shank = Pos(0, 0, -length / 2) * Cylinder(radius, length)
    return shank + Pos(0, 0, high / 2) * Cylinder(head, high)


def _corners(x: float, y: float) -> list[tuple[float, float]]:
    return [(-x, -y), (x, -y), (-x, y), (x, y)]


def _body(
    name: str,
    shape: Any,
    colour: tuple[int, int, int],
    at: tuple[float, float, float] = (0, 0, 0),
    turned_deg: tuple[float, float, float] = (0, 0, 0),
) -> Any:
    """Return a body in its place in the assembly."""
    from build123d import Color, Compound, Location, Solid

    solids = shape.solids()
    own: Any = Solid(solids[0].wrapped) if len(solids) == 1 else Compound(solids)
    own = own.moved(Location(at, turned_deg))
    own.label, own.color = name, Color(*(c / 255 for c in colour))
    return own


def _assembly(name: str, bodies: list[Any]) -> Any:
    from build123d import Compound

    return Compound(label=name, children=bodies)


ASSEMBLIES: Mapping[str, Callable[[], Any]] = {
    "gearbox": gearbox,
    "valve": valve,
    "hinge": hinge,
    "drawer": drawer,
    "stack": stack,
    "board": board,
    "puzzle": puzzle,
    "flange": flange,
    "interlocked": interlocked,
}
"""The assemblies by name; ``interlocked`` is one that cannot be put together."""

if __name__ == "__main__":
    write_step(sys.argv[1], Path(sys.argv[2]))

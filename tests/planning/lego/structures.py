"""LEGO structures for tests: single bricks, and strategies for random ones."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from hypothesis import strategies as st

from planning.lego.bricks.assembly import BrickType, Cell, PlacedBrick
from planning.lego.bricks.brick_grips import legal_presses
from planning.lego.bricks.brick_types import BRICKS
from planning.lego.skills.targets import BrickGrip
from planning.transforms import Transform, from_rpy

CELLS = st.builds(
    Cell,
    st.integers(0, 40),
    st.integers(0, 40),
    st.integers(1, 20),
    st.booleans(),
    st.integers(0, 2),
)
"""Anywhere on a plate."""

TOPS = st.builds(
    lambda x, y, z, yaw: from_rpy((x, y, z), (0.0, 0.0, yaw)),
    st.floats(-1, 1),
    st.floats(-1, 1),
    st.floats(0, 1),
    st.floats(-3, 3),
)
"""Poses of the top face of a brick, or of a plate."""


@st.composite
def grips(
    draw: st.DrawFn, frames: Mapping[str, Transform] = MappingProxyType({})
) -> BrickGrip:
    """Return a grip of any brick that has room for it, anywhere."""
    kind = draw(st.sampled_from([k for k in BRICKS.values() if k.studs != (1, 1)]))
    press = draw(st.sampled_from(legal_presses(kind)))
    return BrickGrip(frames, kind, draw(TOPS), press)


def brick(
    name: str, kind: str, x: int, y: int, z: int, turned: bool = False
) -> PlacedBrick:
    """Return a built-in brick in its place."""
    return PlacedBrick(name, BRICKS[kind], Cell(x, y, z, turned))


@st.composite
def dropped(
    draw: st.DrawFn,
    kinds: Sequence[str],
    count: tuple[int, int],
    place: tuple[int, int],
) -> list[PlacedBrick]:
    """Return bricks dropped one after another, each on what is there; ``place`` is of x and y."""
    out: list[PlacedBrick] = []
    filled: set[tuple[int, int, int]] = set()
    for k in range(draw(st.integers(*count))):
        kind = BRICKS[draw(st.sampled_from(list(kinds)))]
        x, y = draw(st.integers(*place)), draw(st.integers(*place))
        turned = draw(st.booleans())
        columns = PlacedBrick("", kind, Cell(x, y, 1, turned)).studs
        level = 1 + max((p[2] for p in filled if p[:2] in columns), default=-1)
        item = PlacedBrick(f"b{k}", kind, Cell.at_level(x, y, level, turned=turned))
        filled |= item.places
        out.append(item)
    return out


@st.composite
def scattered(
    draw: st.DrawFn,
    types: Mapping[str, BrickType],
    most: int,
    xs: tuple[int, int],
    levels: st.SearchStrategy[int],
) -> list[PlacedBrick]:
    """Return bricks anywhere in a small space, none inside another; y is from 0 on."""
    filled: set[tuple[int, int, int]] = set()
    out = []
    for k in range(draw(st.integers(1, most))):
        kind = types[draw(st.sampled_from(list(types)))]
        x, y = draw(st.integers(*xs)), draw(st.integers(0, xs[1]))
        level = draw(levels)
        turned = draw(st.booleans()) and kind.studs[0] != kind.studs[1]
        item = PlacedBrick(f"b{k}", kind, Cell.at_level(x, y, level, turned=turned))
        if filled.isdisjoint(item.places):
            filled |= item.places
            out.append(item)
    return out

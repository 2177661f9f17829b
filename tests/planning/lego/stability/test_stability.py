"""Stability against hand calculations, published collapses, symmetries and a quicker judge."""

import math
from collections.abc import Callable, Iterable
from dataclasses import replace

import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from planning.errors import ScenarioError
from planning.lego.bricks.assembly import STUD_PITCH, BrickType, Cell, PlacedBrick
from planning.lego.bricks.brick_types import BRICKS
from planning.lego.stability.contacts import JointStrength, ToolHold, knob_points
from planning.lego.stability.partial_structures import PartialStructures
from planning.statics.equilibrium import STANDARD_GRAVITY, Load
from tests.planning.lego.structures import brick, dropped
from tests.planning.lego.whole_stability import stability

Change = Callable[[int, int], tuple[int, int]]
"""A map of the grid onto itself."""


def _bar(length: int, mass: float) -> BrickType:
    return BrickType(f"1x{length}", (1, length), mass)


def _stairs(steps: int, mass: float = 0.00216) -> list[PlacedBrick]:
    brick = BrickType("2x4", (2, 4), mass)
    return [
        PlacedBrick(f"b{k:02d}", brick, Cell(2 * k, 21, k + 1, True))
        for k in range(steps)
    ]


_TOWER = [brick(f"b{z}", "2x4", 3, 5, z) for z in range(1, 9)]
_PROP = brick("prop", "1x2", 4, 21, 1)
_HEAVY = BrickType("2x2", (2, 2), 0.2)


@pytest.mark.parametrize(
    ("structure", "stable", "body"),
    [
        ([], True, None),
        (_TOWER[:1], True, None),
        (_TOWER, True, None),
        # As published: stairs, and a weight on their end.
        (_stairs(19), True, "b01"),
        (_stairs(20), False, "b01"),
        ([*_stairs(20), _PROP], True, ...),
        ([*_stairs(3), PlacedBrick("weight", _HEAVY, Cell(5, 21, 4))], True, ...),
        ([*_stairs(4), PlacedBrick("weight", _HEAVY, Cell(7, 21, 5))], False, ...),
    ],
)
def test_what_stands_and_which_brick_is_strained_most(
    structure: list[PlacedBrick], stable: bool, body: object
) -> None:
    report = stability(structure)
    assert report.stable == stable
    assert body in (report.body, ...)
    assert body is not None or report.score == 0.0


def test_a_brick_in_the_air_is_named() -> None:
    structure = [brick("a", "2x4", 0, 0, 1), brick("b", "2x2", 9, 9, 4)]
    report = PartialStructures(structure).weakness(frozenset("ab"))
    assert not report.stable
    assert report.body == "b"
    assert report.score == stability(structure).score == math.inf


@pytest.mark.parametrize("length", [2, 3, 4, 6, 8])
@pytest.mark.parametrize("mass", [0.002, 0.02])
def test_a_bar_held_by_one_stud_pulls_with_its_lever(length: int, mass: float) -> None:
    """The far contact and the two in the middle pull, the near one is the pivot."""
    post = PlacedBrick("post", _bar(1, 0.001), Cell(5, 5, 1))
    bar = PlacedBrick("bar", _bar(length, mass), Cell(5, 5, 2))
    lever = length / 2 - 0.5  # centre of mass, from the axis of the knob
    moment = mass * STANDARD_GRAVITY * max(0.0, lever - 0.25)
    # T (0.5 + 2 * 0.25) about the pivot
    expected = moment / JointStrength().narrow_pull
    assert stability([post, bar]).score == pytest.approx(expected, abs=1e-9)


def test_a_counterweight_takes_the_load_off_the_knob() -> None:
    post = PlacedBrick("post", _bar(1, 0.001), Cell(5, 5, 1))
    bar = PlacedBrick("bar", _bar(6, 0.005), Cell(5, 5, 2))
    weight = PlacedBrick("weight", _bar(1, 0.05), Cell(5, 5, 3))
    alone = STANDARD_GRAVITY * 0.005 * 2.25
    assert stability([post, bar]).score == pytest.approx(alone / 0.98)
    assert alone < STANDARD_GRAVITY * 0.05 * 0.25
    assert stability([post, bar, weight]).score == 0.0


def test_critical_overhang_is_where_the_hand_calculation_says() -> None:
    """A load on a 1x8 bar, held by two studs, moved out stud by stud."""
    posts = PlacedBrick("post", _bar(2, 0.001), Cell(5, 5, 1))
    bar = PlacedBrick("bar", _bar(8, 0.0), Cell(5, 5, 2))
    # Pivot at y = 1.75 studs; contacts at .25, .5 (2), .75, 1.25, 1.5 (2), 1.75.
    capacity = 0.98 * sum(1.75 - y for y in (0.25, 0.5, 0.5, 0.75, 1.25, 1.5, 1.5))
    force = 1.5
    for at in range(2, 8):
        point = (5.5 * STUD_PITCH, (5 + at + 0.5) * STUD_PITCH, 0.0192)
        report = stability([posts, bar], loads=[Load("bar", (0, 0, -force), (point,))])
        expected = force * (at + 0.5 - 1.75) / capacity
        assert report.score == pytest.approx(expected)
        assert report.stable == (expected <= 1.0)
        assert report.body == "bar"


def test_a_supporting_tool_takes_the_load_and_does_not_pull() -> None:
    post = PlacedBrick("post", _bar(1, 0.001), Cell(5, 5, 1))
    bar = PlacedBrick("bar", _bar(8, 0.02), Cell(5, 5, 2))
    end = (5.5 * STUD_PITCH, 12.5 * STUD_PITCH, 0.0096)
    assert stability([post, bar]).score > 0.5
    assert stability([post, bar], holds=[ToolHold("bar", 1, end)]).score == 0.0
    from_above = stability([post, bar], holds=[ToolHold("bar", -1, end)])
    assert from_above.score == pytest.approx(stability([post, bar]).score)


def test_a_loose_brick_is_not_held_down() -> None:
    tower = [brick("a", "2x2", 0, 0, 1), brick("b", "2x4", 0, 0, 2)]
    tip = Load("b", (0.0, 0.0, -1.0), ((0.008, 3.5 * STUD_PITCH, 0.0192),))
    assert math.isfinite(stability(tower, loads=[tip]).score)
    report = stability(tower, loads=[tip], loose=frozenset(("b",)))
    assert (report.stable, report.score) == (False, math.inf)
    found = PartialStructures(tower).weakness(frozenset("ab"), tip)
    assert (found.stable, found.score, found.body) == (False, math.inf, "b")


def test_sideways_force_is_limited() -> None:
    tower = [brick("a", "1x1", 0, 0, 1)]
    push = Load("a", (30.0, 0.0, 0.0), ((0.004, 0.004, 0.0),))
    assert not stability(tower, loads=[push]).stable
    assert stability(tower, loads=[push], strength=JointStrength(sideways=40.0)).stable


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (brick("b", "2x4", 1, 1, 1), "'a' and 'b' overlap"),
        (brick("a", "2x4", 9, 9, 1), "called 'a'"),
        (brick("c", "2x4", 0, 0, 0), "layer 0"),
    ],
)
def test_errors_name_the_brick(other: PlacedBrick, words: str) -> None:
    with pytest.raises(ScenarioError, match=words):
        PartialStructures([brick("a", "2x4", 0, 0, 1), other])


@pytest.mark.parametrize("kind", sorted(BRICKS))
@pytest.mark.parametrize("turned", [False, True])
def test_cavity_contacts_are_those_of_walls_tubes_and_bars(
    kind: str, turned: bool
) -> None:
    item = PlacedBrick("a", BRICKS[kind], Cell(3, 4, 2, turned))
    narrow = min(item.brick.studs) == 1
    for x, y in item.studs:
        points = knob_points(item, (x, y))
        assert len(points) == (4 if narrow else 3)
        away = ((points - [x + 0.5, y + 0.5]) ** 2).sum(axis=1) ** 0.5
        assert away == pytest.approx(0.25)


# Random structures: bricks dropped one after another, each on what is there.


_KINDS = ["1x2", "1x4", "2x2", "2x4", "1x1", "1x6", "1x2-plate", "2x4-plate"]


@st.composite
def _structures(draw: st.DrawFn, most: int = 9, side: int = 6) -> list[PlacedBrick]:
    """Heavy enough for the friction of single knobs to be in question."""
    bricks = draw(dropped(_KINDS, (2, most), (0, side)))
    return _heavier(bricks, draw(st.sampled_from([1.0, 30.0, 100.0])))


def _heavier(bricks: Iterable[PlacedBrick], scale: float) -> list[PlacedBrick]:
    return [
        replace(i, brick=replace(i.brick, mass=i.brick.mass * scale)) for i in bricks
    ]


def _changed(structure: list[PlacedBrick], change: Change) -> list[PlacedBrick]:
    """Return a structure with the rectangle of every brick mapped by ``change``."""
    out = []
    for item in structure:
        span = item.span
        ends = change(span.x0, span.y0), change(span.x1, span.y1)
        (x, wide), (y, _) = (sorted(axis) for axis in zip(*ends, strict=True))
        turned = wide - x != item.brick.studs[0]
        cell = replace(item.cell, x=x, y=y, turned=turned)
        out.append(replace(item, cell=cell))
    return out


@settings(max_examples=25, deadline=None)
@given(
    _structures(),
    st.sampled_from(
        [
            lambda x, y: (x + 7, y + 3),
            lambda x, y: (20 - y, x),
            lambda x, y: (20 - x, y),
            lambda x, y: (x, 20 - y),
            lambda x, y: (y, x),
        ]
    ),
)
def test_shifting_turning_and_mirroring_change_nothing(
    structure: list[PlacedBrick], change: Change
) -> None:
    here, there = stability(structure), stability(_changed(structure, change))
    assert there.score == pytest.approx(here.score, rel=1e-6, abs=1e-8)


@settings(max_examples=25, deadline=None)
@given(_structures(), st.floats(0.1, 4.0))
def test_scores_grow_with_weight_and_shrink_with_strength(
    structure: list[PlacedBrick], factor: float
) -> None:
    wide = JointStrength(0.98 * factor, 0.85 * factor, 1e4)
    here = stability(structure, strength=JointStrength(sideways=1e4)).score
    assert stability(structure, strength=wide).score == pytest.approx(
        here / factor, rel=1e-6, abs=1e-8
    )


@settings(max_examples=25, deadline=None)
@given(_structures(), st.data())
def test_a_post_below_a_brick_never_makes_it_worse(
    structure: list[PlacedBrick], data: st.DataObject
) -> None:
    filled = {p for i in structure for p in i.places}
    gaps = sorted(
        (x, y, z)
        for x, y, z in filled
        if z > 0 and not any((x, y, k) in filled for k in range(z))
    )
    x, y, z = data.draw(st.sampled_from(gaps or [(40, 40, 1)]))
    light = BrickType("1x1", (1, 1), 0.0, height=1)
    posts = [PlacedBrick(f"post{k}", light, Cell.at_level(x, y, k)) for k in range(z)]
    before, after = stability(structure).score, stability([*structure, *posts]).score
    assert after <= before + 1e-7


@st.composite
def _partial_structures(draw: st.DrawFn) -> tuple[list[PlacedBrick], frozenset[str]]:
    """Return a structure and the names of some of its bricks."""
    structure = draw(_structures(most=12, side=4))
    names = st.sets(st.sampled_from([i.name for i in structure]), min_size=1)
    return structure, frozenset(draw(names))


def _all_of(
    scale: float, *bricks: tuple[str, int, int, int, bool]
) -> tuple[list[PlacedBrick], frozenset[str]]:
    """Return a structure of kind, x, y, z, turned with scaled masses, and all its names."""
    out = _heavier([brick(f"b{k}", *one) for k, one in enumerate(bricks)], scale)
    return out, frozenset(i.name for i in out)


_CHAIN = (
    ("2x2", 1, 1, 1, True),
    ("1x6", 1, 0, 2, False),
    ("2x4", 1, 2, 3, True),
    ("1x4", 2, 1, 2, True),
)
"""The 2x4 hangs on the 1x6, which shares only the 2x2 below with the 1x4."""

_LONG_CHAIN = (
    ("1x2", 0, 0, 1, False),
    ("1x2", 1, 0, 1, False),
    ("1x2", 1, 1, 2, False),
    ("1x2", 0, 0, 2, False),
    ("1x2", 0, 1, 3, True),
    ("2x2", 2, 2, 1, True),
    ("1x2", 0, 2, 3, True),
    ("1x2", 2, 1, 1, True),
    ("1x2", 1, 0, 2, True),
)


@settings(max_examples=40, deadline=None)
@given(_partial_structures())
@example(_all_of(40.0, *_CHAIN))  # gives way; without the 2x4 it would stand
@example(_all_of(30.0, *_CHAIN))
@example(_all_of(1.0, *_LONG_CHAIN))
def test_partial_structures_agree_with_the_plain_program(
    some: tuple[list[PlacedBrick], frozenset[str]],
) -> None:
    """The quick judge against one linear program over everything, for any subset."""
    structure, names = some
    structures = PartialStructures(structure)
    plain = stability([i for i in structure if i.name in names])
    assert structures.stands(names) == plain.stable
    weakness = structures.weakness(names)
    assert weakness.score == pytest.approx(plain.score, abs=1e-7)


@settings(max_examples=40, deadline=None)
@given(_structures(most=12, side=4), st.data())
def test_pressing_agrees_with_the_plain_program(
    structure: list[PlacedBrick], data: st.DataObject
) -> None:
    structures = PartialStructures(structure)
    names = frozenset(i.name for i in structure)
    item = structure[-1]  # nothing lies on the last one
    rest = stability([i for i in structure if i != item])
    assume(rest.stable)
    x, y, z = data.draw(st.sampled_from(sorted(item.places)))
    point = ((x + 0.5) * STUD_PITCH, (y + 0.5) * STUD_PITCH, (z + 1) * 0.0032)
    load = Load(
        item.name, (0.0, 0.0, -data.draw(st.sampled_from([2.0, 15.0]))), (point,)
    )
    under = data.draw(st.sampled_from(structure))
    holds = []
    if under != item and data.draw(st.booleans()):
        a, b, c = min(under.places)
        touch = ((a + 0.5) * STUD_PITCH, (b + 0.5) * STUD_PITCH, c * 0.0032)
        holds = [ToolHold(under.name, 1, touch)]
    plain = stability(
        structure, loads=[load], holds=holds, loose=frozenset((item.name,))
    )
    quick = structures.pressed(names, load, holds)
    assert quick.stable == plain.stable

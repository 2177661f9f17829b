"""Plates among bricks: where they touch, against boxes, and where the tool's wall has room beside them."""

from collections import defaultdict
from dataclasses import replace
from itertools import permutations, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.errors import InfeasibleStepError, ScenarioError
from planning.lego.bricks.assembly import (
    STUD_PITCH,
    BrickType,
    Cell,
    PlacedBrick,
    Plate,
    Press,
    Support,
)
from planning.lego.bricks.brick_grips import (
    grip_pose,
    legal_presses,
    lever_cell,
    press_cell,
    side_contact_pose,
)
from planning.lego.bricks.brick_types import BRICKS
from planning.lego.bricks.grid import (
    box_pose,
    box_size,
    brick_height,
    bricks_joined_to_plate,
    plate_corner,
    top_pose,
)
from planning.lego.sequencing.sequencing import sequence_structure
from planning.lego.skills.targets import resting_contacts, support_targets
from planning.lego.stability.contacts import (
    bricks_by_name,
    filled_places,
    find_joints,
    side_contacts,
)
from planning.lego.stability.partial_structures import PartialStructures
from planning.transforms import Array, inverse
from tests.planning.lego.structures import scattered
from tests.planning.lego.whole_stability import stability

GRID = Plate(np.eye(4))
LEVEL = 0.0032
KINDS = ("1x1", "1x2", "2x2", "2x4", "1x2-plate", "2x2-plate", "2x4-plate")
TYPES = {kind: BRICKS[kind] for kind in KINDS}
TYPES["panel"] = BrickType("panel", (1, 4), 0.003, height=9)


STRUCTURES = scattered(TYPES, 10, (0, 4), st.integers(0, 7))


def box(item: PlacedBrick) -> tuple[Array, Array]:
    """Return least and greatest corner of a brick's share of the grid [studs, studs, levels]."""
    pose = inverse(plate_corner(GRID)) @ box_pose(GRID, item)
    half = np.abs(pose[:3, :3]) @ box_size(item.brick) / 2
    unit = (STUD_PITCH, STUD_PITCH, LEVEL)
    low, high = (pose[:3, 3] - half) / unit, (pose[:3, 3] + half) / unit
    return np.round(low), np.round(high)


def shared(a: tuple[Array, Array], b: tuple[Array, Array]) -> Array:
    """Return how far two boxes share each axis."""
    return np.asarray(np.minimum(a[1], b[1]) - np.maximum(a[0], b[0]))


@settings(max_examples=150, deadline=None)
@given(STRUCTURES)
def test_joints_are_where_boxes_meet(structure: list[PlacedBrick]) -> None:
    bricks = bricks_by_name(structure)
    found = {
        (j.lower, j.upper, bricks[j.upper].cell.level): j.studs
        for j in find_joints(bricks, filled_places(bricks))
    }
    expected = {}
    boxes = {name: box(item) for name, item in bricks.items()}
    ground = (np.array([-99, -99, -9]), np.array([99, 99, 0]))
    for upper, above in boxes.items():
        for lower, below in ((None, ground), *boxes.items()):
            common = shared(above, below)
            if lower == upper or common[2] != 0 or above[0][2] != below[1][2]:
                continue
            if (common[:2] > 0).all():
                low = np.maximum(above[0], below[0]).astype(int)
                expected[lower, upper, int(above[0][2])] = tuple(
                    (low[0] + i, low[1] + j)
                    for i in range(int(common[0]))
                    for j in range(int(common[1]))
                )
    assert found == expected


@settings(max_examples=150, deadline=None)
@given(STRUCTURES)
def test_sides_touch_where_boxes_meet(structure: list[PlacedBrick]) -> None:
    bricks = bricks_by_name(structure)
    found = defaultdict(list)
    for c in side_contacts(bricks, filled_places(bricks)):
        x, y, z = c.point
        corner = (x, y, round(z * STUD_PITCH / LEVEL, 6))
        found[c.first, c.second, c.direction.index(1.0)].append(corner)
    expected = {}
    boxes = {name: box(item) for name, item in bricks.items()}
    for (first, a), (second, b) in permutations(boxes.items(), 2):
        common = shared(a, b)
        for axis in (0, 1):
            if a[1][axis] == b[0][axis] and (np.delete(common, axis) > 0).all():
                low, high = np.maximum(a[0], b[0]), np.minimum(a[1], b[1])
                corners = product(*zip(low, high, strict=True))
                expected[first, second, axis] = sorted(set(corners))
    assert {key: sorted(corners) for key, corners in found.items()} == expected


@settings(max_examples=100, deadline=None)
@given(STRUCTURES)
def test_what_is_joined_to_the_plate_is_what_joints_link(
    structure: list[PlacedBrick],
) -> None:
    bricks = bricks_by_name(structure)
    every = find_joints(bricks, filled_places(bricks))
    held: set[str | None] = {None}
    while new := {
        name
        for j in every
        for name in (j.lower, j.upper)
        if {j.lower, j.upper} & held and name not in held
    }:
        held |= new
    places = {n: i.places for n, i in bricks.items()}
    assert bricks_joined_to_plate(places) == held - {None}


@settings(max_examples=60, deadline=None)
@given(STRUCTURES)
def test_the_quick_judge_agrees_with_the_plain_program(
    structure: list[PlacedBrick],
) -> None:
    names = frozenset(item.name for item in structure)
    stands = PartialStructures(structure).stands(names)
    assert stands == stability(structure).stable


@given(st.sampled_from([b for b in BRICKS.values() if b.height == 3]), st.booleans())
def test_three_plates_are_as_high_as_a_brick(brick: BrickType, turned: bool) -> None:
    cell = Cell(5, 6, 2, turned)
    plate = BRICKS[f"{brick.name}-plate"]
    assert plate.studs == brick.studs
    stack = [Cell.at_level(5, 6, 3 + k, turned=turned) for k in range(3)]
    assert [c.raised for c in stack] == [0, 1, 2]
    item = PlacedBrick("", brick, cell)
    thin = [PlacedBrick("", plate, c) for c in stack]
    assert frozenset().union(*(one.places for one in thin)) == item.places
    assert sum(len(one.places) for one in thin) == len(item.places)
    np.testing.assert_allclose(
        top_pose(GRID, thin[-1]), top_pose(GRID, item), atol=1e-15
    )
    assert 3 * brick_height(plate) == pytest.approx(brick_height(brick), abs=1e-15)
    # What is pressed on the third plate is where it would be on the brick.
    press = Press(1, 0)
    assert press_cell(thin[-1], press, up=False) == press_cell(item, press, up=False)
    # From below, the tool comes where it comes for the brick.
    low, whole = (
        side_contact_pose(top_pose(GRID, one), one.brick, press)
        for one in (thin[0], item)
    )
    np.testing.assert_allclose(low, whole, atol=1e-15)


def test_a_wall_of_plates_stands_as_the_wall_of_bricks() -> None:
    """Equally heavy, with the same knobs below: the same centre and the same score."""
    light = BRICKS["2x4"]
    third = BrickType("third", (2, 4), light.mass / 3, height=1)
    post = PlacedBrick("post", BRICKS["2x2"], Cell(0, 0, 1))
    brick = PlacedBrick("whole", light, Cell(0, 0, 2))
    thirds = [PlacedBrick(f"t{k}", third, Cell(0, 0, 2, raised=k)) for k in range(3)]
    # The least friction is at the joint below: the plates need no more than the brick.
    one, three = stability([post, brick]), stability([post, *thirds])
    assert 0 < one.score == pytest.approx(three.score)


@pytest.mark.parametrize("level", range(2, 9))
@pytest.mark.parametrize("orientation", range(4))
def test_supports_follow_their_level(level: int, orientation: int) -> None:
    """Each level is 3.2 mm, whole layers are those that layers name."""
    for top in (False, True):
        support = Support(Cell.at_level(10, 12, level), orientation, top)
        base = Support(Cell(10, 12, 1), orientation, top)
        here, below = (
            support_targets(GRID, s)[0].subgoals[-1].pose[:3, 3]
            for s in (support, base)
        )
        np.testing.assert_allclose(here - below, [0, 0, level * LEVEL], atol=1e-12)


def test_plates_overlap_where_their_levels_do() -> None:
    low = PlacedBrick("low", BRICKS["2x4"], Cell(0, 0, 1))
    inside = PlacedBrick("in", BRICKS["2x2-plate"], Cell(0, 0, 1, raised=2))
    with pytest.raises(ScenarioError, match="'low' and 'in' overlap"):
        PartialStructures([low, inside])
    assert PartialStructures([low, replace(inside, cell=Cell(0, 0, 2))]).bricks


def test_a_plate_is_gripped_at_its_own_top() -> None:
    plate = PlacedBrick("", BRICKS["2x4-plate"], Cell(0, 0, 2, raised=1))
    grip = grip_pose(top_pose(GRID, plate), plate.brick, Press(1, 0))
    assert grip[2, 3] == pytest.approx(5 * LEVEL)


POST = PlacedBrick("post", BRICKS["2x8"], Cell(20, 20, 1))


def plate(x: int, y: int, z: int, raised: int = 0) -> PlacedBrick:
    return PlacedBrick("top", BRICKS["2x4-plate"], Cell(x, y, z, raised=raised))


def test_a_plate_goes_on_a_brick_by_the_edges_that_are_flush() -> None:
    """A 2x4 plate on one end of a 2x8 brick: three edges are flush, beside the fourth are knobs."""
    found = sequence_structure([POST, plate(20, 20, 2)])
    step = found.steps[-1]
    assert step.brick == BRICKS["2x4-plate"]
    assert {p.side for p in step.presses} == {1, 3, 4}
    for press in legal_presses(step.brick):
        beside = PlacedBrick("wall", BRICKS["1x2"], lever_cell(step, press))
        assert (press in step.presses) == beside.studs.isdisjoint(POST.studs)


def test_a_plate_on_the_base_plate_has_no_room_for_the_tool() -> None:
    with pytest.raises(InfeasibleStepError, match="the plate is in its way"):
        sequence_structure([plate(20, 20, 1)])


def test_plates_between_layers_carry_bricks() -> None:
    brick = PlacedBrick("lid", BRICKS["2x4"], Cell(20, 20, 2, raised=2))
    plates = [
        PlacedBrick(f"p{k}", BRICKS["2x4-plate"], Cell(20, 20, 2, raised=k))
        for k in range(2)
    ]
    found = sequence_structure([brick, POST, *plates[::-1]])
    assert [s.name for s in found.sequence] == ["post", "p0", "p1", "lid"]
    assert "at [20, 20, 2] raised 2" in found.steps[-1].words


@pytest.mark.parametrize(
    ("press", "turned", "at"),
    [
        (Press(1, 0), False, (4, 5)),
        (Press(4, 2), False, (7, 7)),
        (Press(2, 0), False, (5, 9)),
        (Press(3, 0), False, (5, 4)),
        (Press(1, 0), True, (7, 4)),
        (Press(4, 0), True, (7, 7)),
        (Press(2, 0), True, (4, 5)),
        (Press(3, 0), True, (9, 5)),
    ],
)
def test_the_wall_stands_beside_the_pressed_edge(
    press: Press, turned: bool, at: tuple[int, int]
) -> None:
    """A 2x4 at [5, 5]: the least stud of the cell beside each of its edges."""
    item = PlacedBrick("", BRICKS["2x4-plate"], Cell(5, 5, 3, turned, 1))
    found = lever_cell(item, press)
    assert (found.x, found.y) == at
    assert (found.z, found.raised) == (3, 1)
    assert found.turned == ((press.side in (2, 3)) != turned)


OTHERS = {
    "post": POST,
    "row": PlacedBrick("row", BRICKS["2x8"], Cell(18, 20, 1)),
    "wall": PlacedBrick("wall", BRICKS["2x4"], Cell(22, 20, 2)),
    "high": PlacedBrick("high", BRICKS["2x4-plate"], Cell(18, 24, 2)),
    "far": PlacedBrick("far", BRICKS["2x4"], Cell(30, 30, 1)),
}


@pytest.mark.parametrize("press", legal_presses(BRICKS["2x4-plate"]))
def test_the_wall_touches_what_ends_beside_it_and_no_knobs(press: Press) -> None:
    """Which bricks around a plate may touch the tool, against the box of its wall."""
    item, grid = plate(20, 20, 2), Plate(np.eye(4))
    pose = box_pose(grid, item)
    pairs = resting_contacts("r", item, pose, press, OTHERS, ())
    tool = {next(iter(pair - {"r/tool"})) for pair in pairs if "r/tool" in pair}
    top = top_pose(grid, item)
    grip = grip_pose(top, item.brick, press)
    corners = np.array([[-0.008, -0.008, 0.0], [0.0, 0.008, 0.0032]])
    wall = np.sort(corners @ grip[:3, :3].T + grip[:3, 3], axis=0)
    expected = {"top", "wall", "high"}  # beside the plate, as for any brick
    for name, other in OTHERS.items():
        centre = box_pose(grid, other)
        half = np.abs(centre[:3, :3]) @ box_size(other.brick) / 2
        low, high = centre[:3, 3] - half, centre[:3, 3] + half
        gap = np.maximum(low - wall[1], wall[0] - high)
        if (gap < 0.0003).all() and (gap[:2] > 0.0).any():
            expected.add(name)
    assert tool == expected
    assert "far" not in tool

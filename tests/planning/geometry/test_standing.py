"""Tables of standing boxes: every row that compiled code looks up is there, and objects that are followed are where each state says."""

from collections.abc import Callable

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.cell.cover import box_body
from planning.cell.shape import box_shape
from planning.cell.workcell import (
    Attachment,
    CellObject,
    Fixture,
    PlacedRobot,
    Workcell,
)
from planning.geometry.hull_table import AT_REST
from planning.geometry.standing import sort_objects, stand_boxes
from planning.transforms import from_rpy, read_only_copy, translation

SIZE = np.array([0.06, 0.12, 0.04])


def test_tables_reach_as_far_as_the_rows_of_a_scene(
    make_arm: Callable[..., PlacedRobot],
) -> None:
    robot = make_arm("one")
    cell = Workcell((robot,), (), ())
    brick = box_body("brick", SIZE)
    rng = np.random.default_rng(0)
    poses = [from_rpy(rng.uniform(-1, 1, 3), rng.uniform(-3, 3, 3)) for _ in range(40)]
    stand_boxes(cell.fixtures, [(f"other{k}", brick, p) for k, p in enumerate(poses)])
    # A scene of few boxes, whose rows come after those of many others.
    few = stand_boxes(cell.fixtures, [("last", brick, poses[-1])])
    table = few.hulls
    rows = table.solid[0]
    assert rows.tolist() == few.rows.tolist()
    assert rows.min() >= 39
    assert len(table.corner_first) > rows.max() + 1
    assert len(table.capsule_first) > rows.max() + 1
    assert table.joint[rows].tolist() == [AT_REST]
    first, last = table.corner_first[rows[0]], table.corner_first[rows[0] + 1]
    placed = brick.vertices @ poses[-1][:3, :3].T + poses[-1][:3, 3]
    assert np.array_equal(table.corners[first:last], placed)


BRICK_SIZE = read_only_copy([0.016, 0.032, 0.0096])
SHAPE = box_shape("brick", BRICK_SIZE)
TABLE = Fixture("table", SHAPE, read_only_copy(np.eye(4)))
OBJECTS = tuple(
    CellObject(f"b{k}", "2x4", SHAPE, read_only_copy(translation(k, 0, 0)))
    for k in range(6)
)

places = st.none() | st.tuples(
    st.sampled_from([None, None, "arm", "other"]), st.integers(0, 3)
)
states = st.tuples(
    st.integers(1, len(OBJECTS)),
    st.lists(places, min_size=len(OBJECTS), max_size=len(OBJECTS)),
    st.sampled_from([(), (TABLE,)]),
)


@settings(max_examples=100, deadline=None)
@given(st.lists(states, min_size=1, max_size=12))
def test_following_is_sorting_anew(
    run: list[tuple[int, list[tuple[str | None, int] | None], tuple[Fixture, ...]]],
) -> None:
    """Objects come, go, change hands, and other cells are asked about in between."""
    for count, where, fixtures in run:
        objects = OBJECTS[:count]
        at = {
            item.name: Attachment(place[0], read_only_copy(translation(0, place[1], 0)))
            for item, place in zip(objects, where, strict=False)
            if place is not None
        }
        held, boxes = sort_objects(fixtures, objects, at)
        there = [(item, at[item.name]) for item in objects if item.name in at]
        assert held == [pair for pair in there if pair[1].holder is not None]
        anew = stand_boxes(
            fixtures,
            [
                p
                for i, a in there
                if a.holder is None
                for p in i.shape.placed(i.name, a.pose)
            ],
        )
        assert boxes.names == anew.names
        assert np.array_equal(boxes.pose, anew.pose)
        assert boxes.fixtures == len(fixtures)


def test_boxes_left_out_and_the_first_ones() -> None:
    boxes = stand_boxes(
        (TABLE,), [p for i in OBJECTS for p in i.shape.placed(i.name, i.start)]
    )
    assert boxes.first(3).names == ("table", "b0", "b1")
    fewer = boxes.without(["b1", "unknown", "b4"])
    assert fewer.names == ("table", "b0", "b2", "b3", "b5")
    assert np.array_equal(fewer.pose[2], OBJECTS[2].start)
    assert boxes.without([]) is boxes

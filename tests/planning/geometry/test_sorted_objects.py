"""Objects that are followed from state to state are where each state says."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.cell.shape import box_shape
from planning.cell.workcell import Attachment, CellObject, Fixture
from planning.geometry.standing import sort_objects, stand_boxes
from planning.transforms import readonly, translation

SIZE = readonly([0.016, 0.032, 0.0096])
SHAPE = box_shape("brick", SIZE)
TABLE = Fixture("table", SHAPE, readonly(np.eye(4)))
OBJECTS = tuple(
    CellObject(f"b{k}", "2x4", SHAPE, readonly(translation(k, 0, 0))) for k in range(6)
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
def test_following_is_sorting_anew(run):
    """Objects come, go, change hands, and other cells are asked about in between."""
    for count, where, fixtures in run:
        objects = OBJECTS[:count]
        at = {
            item.name: Attachment(place[0], readonly(translation(0, place[1], 0)))
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


def test_boxes_left_out_and_the_first_ones():
    boxes = stand_boxes(
        (TABLE,), [p for i in OBJECTS for p in i.shape.placed(i.name, i.start)]
    )
    assert boxes.first(3).names == ("table", "b0", "b1")
    fewer = boxes.without(["b1", "unknown", "b4"])
    assert fewer.names == ("table", "b0", "b2", "b3", "b5")
    assert np.array_equal(fewer.pose[2], OBJECTS[2].start)
    assert boxes.without([]) is boxes

"""Contacts of convex solids: known areas, and distances against coal."""

import coal
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.geometry.exact import hull_shape
from planning.statics.contact_patch import ContactPatch, contact_patch
from planning.statics.standing import PlacedBody
from planning.transforms import from_rpy, translation
from tests.planning.statics.bodies import bar, box


def patch_of(first: PlacedBody, second: PlacedBody) -> ContactPatch:
    return contact_patch(first.pieces[0], first.pose, second.pieces[0], second.pose)


def test_a_box_on_a_box_touches_in_their_common_rectangle() -> None:
    low = box("low", (0.4, 0.2, 0.1), (0.0, 0.0, 0.05))
    high = box("high", (0.4, 0.2, 0.1), (0.3, 0.1, 0.15))
    patch = patch_of(low, high)
    assert patch.gap == pytest.approx(0.0, abs=1e-9)
    assert patch.normal == pytest.approx([0, 0, 1])
    assert patch.points.min(axis=0) == pytest.approx([0.1, 0.0, 0.1], abs=5e-5)
    assert patch.points.max(axis=0) == pytest.approx([0.2, 0.1, 0.1], abs=5e-5)


def test_the_direction_is_from_the_first_to_the_second() -> None:
    low = box("low", (0.4, 0.2, 0.1), (0.0, 0.0, 0.05))
    high = box("high", (0.1, 0.1, 0.1), (0.0, 0.0, 0.1505))
    assert patch_of(high, low).normal == pytest.approx([0, 0, -1])
    assert patch_of(high, low).gap == pytest.approx(5e-4, abs=1e-9)


def test_crossing_bars_touch_in_a_point() -> None:
    along_x = bar("x", 0.01, 0.4, from_rpy((0, 0, 0), (0, np.pi / 2, 0)))
    along_y = bar("y", 0.01, 0.4, from_rpy((0, 0, 0.02), (np.pi / 2, 0, 0)))
    patch = patch_of(along_x, along_y)
    assert abs(patch.gap) < 2e-4
    assert patch.normal == pytest.approx([0, 0, 1], abs=0.01)
    assert np.abs(patch.points[:, :2]).max() < 0.004
    assert patch.points[:, 2] == pytest.approx(0.01, abs=2e-4)


def test_a_tilted_box_touches_along_its_edge() -> None:
    floor = box("floor", (1.0, 1.0, 0.1), (0.0, 0.0, -0.05))
    tilt = np.radians(30)
    height = 0.1 * (np.cos(tilt) + np.sin(tilt))
    block = box("b", (0.2, 0.2, 0.2), (0, 0, height), from_rpy((0, 0, 0), (0, tilt, 0)))
    patch = patch_of(floor, block)
    assert patch.gap == pytest.approx(0.0, abs=1e-9)
    assert np.ptp(patch.points[:, 1]) == pytest.approx(0.2, abs=1e-4)
    assert np.ptp(patch.points[:, 0]) < 2e-3


@settings(max_examples=60, deadline=None)
@given(
    st.tuples(*[st.floats(-0.25, 0.25)] * 3),
    st.tuples(*[st.floats(-np.pi, np.pi)] * 3),
    st.booleans(),
)
def test_the_gap_never_exceeds_the_distance_and_finds_every_separation(
    xyz: tuple[float, float, float], rpy: tuple[float, float, float], round_: bool
) -> None:
    first = box("first", (0.2, 0.1, 0.06), (0.0, 0.0, 0.0))
    if round_:
        second = bar("second", 0.02, 0.2, from_rpy(xyz, rpy))
    else:
        second = box("second", (0.15, 0.05, 0.08), xyz, from_rpy((0, 0, 0), rpy))
    patch = patch_of(first, second)
    result = coal.DistanceResult()
    poses = [coal.Transform3s(b.pose[:3, :3], b.pose[:3, 3]) for b in (first, second)]
    shapes = [hull_shape(b.pieces[0]) for b in (first, second)]
    apart = coal.distance(
        shapes[0], poses[0], shapes[1], poses[1], coal.DistanceRequest(), result
    )
    if apart > 1e-6:
        assert 0.0 < patch.gap <= apart + 1e-6
    elif apart < -1e-6:
        # The least overlap along any direction is how far they must be moved apart.
        assert patch.gap == pytest.approx(apart, abs=2e-5)


def test_the_contact_is_the_same_wherever_both_are() -> None:
    floor = box("floor", (0.3, 0.2, 0.1), (0.0, 0.0, -0.05))
    block = box("b", (0.1, 0.1, 0.1), (0.12, 0.0, 0.05))
    here = patch_of(floor, block)
    move = translation(1.0, 2.0, 3.0) @ from_rpy((0, 0, 0), (0.3, -0.7, 1.1))
    moved = contact_patch(
        floor.pieces[0], move @ floor.pose, block.pieces[0], move @ block.pose
    )
    assert moved.gap == pytest.approx(here.gap, abs=1e-9)
    back = (moved.points - move[:3, 3]) @ move[:3, :3]
    assert back.min(axis=0) == pytest.approx(here.points.min(axis=0), abs=5e-5)
    assert back.max(axis=0) == pytest.approx(here.points.max(axis=0), abs=5e-5)

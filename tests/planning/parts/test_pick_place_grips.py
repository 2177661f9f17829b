"""Grips hold a box squarely, within the opening, and point where they may."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planning.parts.assembly import GripRules, box_grips
from planning.transforms import from_rpy, identity

ROD = np.array([0.3, 0.024, 0.024])
edges = st.floats(0.01, 0.4)
angles = st.floats(-np.pi, np.pi)


def test_a_flat_rod_is_gripped_from_above_both_ways_round_at_every_place() -> None:
    rules = GripRules(positions=5, end_margin=0.02)
    found = box_grips(ROD, identity(), from_rpy((0.5, 0, 0), (0, 0, 1.0)), rules)
    assert len(found) == 5 * 2
    places = [g.pose[0, 3] for g in found]
    assert sorted(set(places)) == pytest.approx([-0.13, -0.065, 0, 0.065, 0.13])
    assert places[:2] == [0.0, 0.0]
    for grip in found:
        np.testing.assert_allclose(grip.pose[:3, 2], [0, 0, -1], atol=1e-12)
        np.testing.assert_allclose(np.abs(grip.pose[:3, 1]), [0, 1, 0], atol=1e-12)


def test_a_rod_that_is_rolled_over_has_no_grip_but_one_turned_a_quarter_has() -> None:
    rules = GripRules(steepest=np.radians(60))
    over = from_rpy((0, 0, 0), (np.pi, 0, 0))
    assert box_grips(ROD, identity(), over, rules) == []
    leaning = from_rpy((0, 0, 0), (np.radians(50), 0, 0))
    assert box_grips(ROD, identity(), leaning, rules)


def test_the_tool_leans_about_the_axis_along_which_it_closes() -> None:
    tilts = (0.0, np.radians(25))
    found = box_grips(ROD, identity(), identity(), GripRules(positions=1, tilts=tilts))
    leanings = {round(float(np.degrees(np.arccos(-g.pose[2, 2])))) for g in found}
    assert leanings == {0, 25}
    for grip in found:
        assert abs(grip.pose[1, 1]) == pytest.approx(1.0)


def test_a_deep_box_is_gripped_near_the_face_that_the_tool_comes_from() -> None:
    size = np.array([0.2, 0.03, 0.12])
    for grip in box_grips(size, identity(), identity(), GripRules(depth=0.03)):
        assert grip.pose[2, 3] == pytest.approx(0.06 - 0.03)


@given(edges, edges, edges, angles, angles)
def test_every_grip_keeps_the_rules(
    x: float, y: float, z: float, yaw: float, roll: float
) -> None:
    size = np.array([x, y, z])
    start, goal = from_rpy((0, 0, 0), (0, 0, yaw)), from_rpy((0, 0, 0), (roll, 0, 0))
    rules = GripRules(tilts=(0.0, 0.4, -0.4), steepest=1.0)
    found = box_grips(size, start, goal, rules)
    for grip in found:
        rotation = grip.pose[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        width = float(np.abs(rotation[:, 1]) @ size)
        assert width <= rules.opening + 1e-9
        assert (np.abs(grip.pose[:3, 3]) <= size / 2 + 1e-9).all()
        for pose in (start, goal):
            pointing = (pose[:3, :3] @ rotation)[:, 2]
            assert np.arccos(np.clip(-pointing[2], -1, 1)) <= rules.steepest + 1e-6
    if size.min() > rules.opening:
        assert found == []
    assert len({g.pose.round(9).tobytes() for g in found}) == len(found)

"""Support poses: what they touch, and that the four orientations are one turned by quarters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planning.errors import ScenarioError
from planning.lego.bricks.assembly import (
    LAYER_HEIGHT,
    STUD_PITCH,
    Plate,
    Support,
)
from planning.lego.skills.targets import (
    LEVER_WALL,
    STUD_HEIGHT,
    support_bottom_targets,
    support_top_targets,
    supported_span,
)
from planning.steps.skill import SkillTargets
from planning.transforms import from_rpy, inverse, rotation

HEADING = {0: (1, 0), 1: (0, -1), 2: (0, 1), 3: (-1, 0)}
QUARTER_TURN = {0: 2, 2: 3, 3: 1, 1: 0}
Build = Callable[[Plate, Support], tuple[SkillTargets, ...]]
BUILDERS: tuple[Build, ...] = (support_bottom_targets, support_top_targets)

places = st.tuples(st.integers(4, 40), st.integers(4, 40), st.integers(2, 20))
orientations = st.sampled_from([0, 1, 2, 3])
builders = st.sampled_from(BUILDERS)


def _turned_by_a_quarter(support: Support, studs: int = 48) -> Support:
    """Return the support on the grid turned by +90 degrees about the plate's centre."""
    far = supported_span(support).y1
    orientation = QUARTER_TURN[support.orientation]
    return replace(support, x=studs - far, y=support.x, orientation=orientation)


@given(places, orientations, builders)
def test_orientations_are_quarter_turns_of_each_other(
    place: tuple[int, int, int], orientation: int, build: Build
) -> None:
    plate = Plate(np.eye(4))
    support = Support(*place, orientation)
    here = build(plate, support)[0].subgoals
    there = build(plate, _turned_by_a_quarter(support))[0].subgoals
    quarter = rotation("z", np.pi / 2)
    for a, b in zip(here, there, strict=True):
        np.testing.assert_allclose(b.pose, quarter @ a.pose, atol=1e-12)


@given(places, orientations)
def test_the_tip_lies_under_the_supported_studs(
    place: tuple[int, int, int], orientation: int
) -> None:
    plate = Plate(np.eye(4))
    support = Support(*place, orientation)
    pose = support_bottom_targets(plate, support)[0].subgoals[-1].pose
    heading = np.array([*HEADING[orientation], 0.0])
    np.testing.assert_allclose(pose[:3, 2], heading, atol=1e-12)
    # The tip is two studs high: it fills up to the bottom of layer z + 1.
    assert pose[2, 3] + STUD_PITCH == pytest.approx(place[2] * LAYER_HEIGHT)
    # It ends at the far edge of the supported studs, the wall included, centred on them.
    tip = (pose[:3, 3] + LEVER_WALL * heading)[:2] / STUD_PITCH + 24
    x0, x1, y0, y1, *_ = supported_span(support)
    expected = [(x0 + x1) / 2, (y0 + y1) / 2] + 0.5 * heading[:2]
    np.testing.assert_allclose(tip, expected, atol=1e-9)


@given(places, orientations)
def test_the_wall_stands_on_the_studs_from_above(
    place: tuple[int, int, int], orientation: int
) -> None:
    (targets,) = support_top_targets(Plate(np.eye(4)), Support(*place, orientation))
    pose = targets.subgoals[-1].pose
    np.testing.assert_allclose(pose[:3, 2], [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(pose[:2, 0], HEADING[orientation], atol=1e-12)
    top_of_studs = (place[2] - 1) * LAYER_HEIGHT + STUD_HEIGHT
    assert pose[2, 3] - LEVER_WALL == pytest.approx(top_of_studs)


@given(places, orientations, st.floats(-3, 3), builders)
def test_support_poses_move_with_the_plate(
    place: tuple[int, int, int], orientation: int, yaw: float, build: Build
) -> None:
    support = Support(*place, orientation)
    moved = from_rpy((0.3, -0.2, 1.0), (0.0, 0.0, yaw))
    a = build(Plate(np.eye(4)), support)[0].subgoals[-1].pose
    b = build(Plate(moved), support)[0].subgoals[-1].pose
    np.testing.assert_allclose(inverse(moved) @ b, a, atol=1e-9)


def test_pre_poses_are_apart_and_the_first_is_straight() -> None:
    plate = Plate(np.eye(4))
    bottom = support_bottom_targets(plate, Support(20, 20, 5, 0))
    moves = [
        tuple(np.round((pre.pose - support.pose)[:3, 3] * 1e3, 6) + 0.0)
        for pre, support in (way.subgoals for way in bottom)
    ]
    assert moves[0] == (0.0, 0.0, -1.0)
    assert len(set(moves)) == 9
    assert {m[2] for m in moves} == {-1.0}
    ((pre, support),) = (
        way.subgoals for way in support_top_targets(plate, Support(20, 20, 5, 1))
    )
    lift = (pre.pose - support.pose)[:3, 3]
    np.testing.assert_allclose(lift, [0, 0, 0.005], atol=1e-12)


def test_an_unknown_orientation_is_refused() -> None:
    with pytest.raises(ScenarioError, match="orientation 4"):
        support_bottom_targets(Plate(np.eye(4)), Support(1, 1, 1, 4))

"""Bounds on the overlap of a moving tool with a box, against measured distances."""

from __future__ import annotations

from unittest.mock import patch

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.cell.shape import box_shape
from planning.cell.workcell import Fixture, PlacedRobot, Workcell, WorldState
from planning.geometry import scene_checker
from planning.geometry.exact import hull_distance_at
from planning.geometry.scene_checker import SceneChecker
from planning.kinematics.kinematics import frame_pose
from planning.robots.registry import robot_model
from planning.transforms import Array, from_rpy, identity

MODEL = robot_model("gp4")
ROBOT = PlacedRobot("arm", MODEL, identity(), MODEL.home)
TOOL = [k for k, part in enumerate(MODEL.parts) if part.group == "tool"]


def checker(shift: tuple[float, float, float], turn: float) -> SceneChecker:
    """Return the checker of an arm whose flange is at HOME near a brick."""
    pose = frame_pose(ROBOT, MODEL.home) @ from_rpy(shift, (0.0, 0.3 * turn, turn))
    size = np.array([0.032, 0.016, 0.0096])
    brick = Fixture("brick", box_shape("brick", size), pose)
    cell = Workcell((ROBOT,), (brick,), ())
    return SceneChecker(cell, "arm", WorldState({"arm": MODEL.home}, {}))


def least_gap(checked: SceneChecker, path: Array) -> float:
    """Return the least distance of the tool from the brick at many configurations."""
    box = checked._boxes.solid(0)
    return min(
        hull_distance_at(checked._own.solids[body], q, box, q)
        for body in TOOL
        for a, b in zip(path, path[1:], strict=False)
        for q in np.linspace(a, b, 6)
    )


shifts = st.tuples(
    st.floats(-0.045, 0.045), st.floats(-0.045, 0.045), st.floats(0.105, 0.125)
)


@settings(max_examples=25, deadline=None)
@given(
    shifts,
    st.floats(-1.5, 1.5),
    st.sampled_from([-0.003, -0.0002, 0.0007]),
    st.integers(0, 2**32 - 1),
)
def test_a_tool_comes_within_a_limit_with_and_without_bounds(
    shift: tuple[float, float, float], turn: float, limit: float, seed: int
) -> None:
    """The bounds decide as the exact check of all stretches does, and as samples do where these are certain."""
    checked, rng = checker(shift, turn), np.random.default_rng(seed)
    steps = rng.uniform(-0.004, 0.004, (3, MODEL.dof))
    path = MODEL.home + np.cumsum(np.vstack([np.zeros((1, MODEL.dof)), steps]), axis=0)
    found = checked.tool_comes_within(path, "brick", limit)
    with patch.object(scene_checker, "_AXES", 0):
        assert checked.tool_comes_within(path, "brick", limit) == found
    gap = least_gap(checked, path)
    if gap < limit - 1e-6:
        assert found
    if gap > limit + 0.002:
        assert not found

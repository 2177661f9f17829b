"""The bound of the tool's speed: never passed in dense sampling by pinocchio, and hardly above it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.kinematics.chain import joint_table
from planning.kinematics.kinematics import frame_in_last_joint
from planning.robots.registry import robot_model
from planning.timing.path_bounds import greatest_tool_speed, tool_speed_along
from tests.planning.timing.pinocchio_arm import PinocchioArm
from twin.run.driven_motion import cubic_at

MODELS = ("ur5e", "iiwa14", "gp4", "mobile-manipulator", "tower-crane")


@pytest.mark.parametrize("name", MODELS)
@settings(deadline=None, max_examples=15)
@given(st.integers(0, 10**6))
def test_along_straight_lines(name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = robot_model(name)
    low, high = np.maximum(model.lower, -3.0), np.minimum(model.upper, 3.0)
    start, end = rng.uniform(low, high), rng.uniform(low, high)
    way = (end - start) * rng.choice([1.0, 0.3, 0.01])
    way[rng.random(model.dof) < 0.3] = 0.0
    tip = frame_in_last_joint(model, "tool")[:3, 3]
    bound = tool_speed_along(joint_table(model), tip, start, way)
    shares = np.linspace(0.0, 1.0, 400)
    q = start + shares[:, None] * way
    most = PinocchioArm(model).tool_speeds(q, np.tile(way, (len(q), 1))).max()
    assert most <= bound + 1e-9
    assert bound <= most * 1.005 + 1e-3 * np.abs(way).sum()


@pytest.mark.parametrize("name", ["ur5e", "mobile-manipulator"])
@settings(deadline=None, max_examples=15)
@given(st.integers(0, 10**6))
def test_along_cubic_motions(name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = robot_model(name)
    t = np.concatenate([[0.0], np.cumsum(rng.uniform(0.05, 0.5, 3))])
    a = rng.normal(size=(4, model.dof)) * 3.0
    v, q = [rng.normal(size=model.dof)], [model.home]
    for k, h in enumerate(np.diff(t)):
        q.append(q[-1] + h * v[-1] + h * h * (2.0 * a[k] + a[k + 1]) / 6.0)
        v.append(v[-1] + h * (a[k] + a[k + 1]) / 2.0)
    rows = t, np.array(q), np.array(v), a
    tip = frame_in_last_joint(model, "tool")[:3, 3]
    bound = greatest_tool_speed(joint_table(model), tip, *rows)
    at, rate, _ = cubic_at(t, rows[1], rows[2], np.linspace(0.0, t[-1], 600))
    most = PinocchioArm(model).tool_speeds(at, rate).max()
    assert most <= bound + 1e-9
    assert bound <= most * 1.005 + 1e-3

"""Efforts of joints: within their limits in dense sampling by pinocchio, and no slower than need be."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from planning.cell.motion_limits import MotionLimits
from planning.cell.shape import box_shape
from planning.cell.workcell import PlacedRobot
from planning.robots.registry import robot_model
from planning.timing.smooth_path import smooth_path
from planning.timing.stretch import Stretch, straight_stretch
from planning.timing.torque import (
    ArmDynamics,
    HandPayload,
    explain_unchecked_efforts,
    torque_limited_stretch,
)
from tests.planning.timing.drawn_arm import ARMS, MODELS, Drawn
from twin.runs.cubic_motion import cubic_at


def slower(stretch: Stretch, factor: float) -> Stretch:
    return replace(stretch, cruise=stretch.cruise * factor, ramp=stretch.ramp * factor)


def corners(
    drawn: Drawn, start: np.ndarray, way: np.ndarray, stretch: Stretch
) -> float:
    """Return the greatest share of effort at all accelerations and speeds of a stretch."""
    q = start + np.linspace(0.0, 1.0, 301)[:, None] * way
    most = 1.0 / (stretch.cruise * stretch.ramp)
    fast = np.sqrt(min(1.0, stretch.cruise / stretch.ramp)) / stretch.cruise
    return max(
        drawn.worst(q, np.tile(speed * way, (301, 1)), np.tile(rise * way, (301, 1)))
        for speed in (0.0, fast)
        for rise in (-most, most)
    )


@pytest.mark.parametrize("name", MODELS)
@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10**6))
def test_a_stretch_is_slowed_as_much_as_need_be(name: str, seed: int) -> None:
    drawn = Drawn(name, seed)
    start = drawn.configuration()
    way = (drawn.configuration() - start) * drawn.rng.choice([1.0, 0.2])
    stretch = straight_stretch(drawn.limits, way)
    found = drawn.dynamics.along_stretch(start, way, stretch)
    assume(found.overloaded < 0)
    assert corners(drawn, start, way, slower(stretch, found.factor)) <= 1.0 + 1e-6
    borne = torque_limited_stretch(stretch, found)
    assert corners(drawn, start, way, borne) <= 1.0 + 1e-6
    assert borne.seconds <= slower(stretch, found.factor).seconds
    if found.joint < 0:
        assert found.factor == 1.0
        assert borne == stretch
        return
    assert found.factor > 1.0
    quicker = slower(stretch, 0.998 * found.factor)
    assert corners(drawn, start, way, quicker) > 1.0
    eased = replace(stretch, ramp=stretch.ramp * found.easing)
    if eased.ramp <= eased.cruise:
        # Full speed is reached, so that both of what is allowed for happen.
        assert corners(drawn, start, way, eased) <= 1.0 + 1e-6
        quicker = replace(eased, ramp=0.995 * eased.ramp)
        assert corners(drawn, start, way, quicker) > 1.0


@pytest.mark.parametrize("name", MODELS)
@settings(deadline=None, max_examples=15)
@example(269988, True)
@given(st.integers(0, 10**6), st.booleans())
def test_so_is_a_skill(name: str, seed: int, gentle: bool) -> None:
    drawn = Drawn(name, seed)
    first = drawn.configuration()
    if gentle:
        steps = np.tile((drawn.configuration() - first) / 5, (5, 1))
        steps += drawn.rng.normal(size=steps.shape) * 0.01
        path = first + np.cumsum(steps, axis=0)
    else:
        path = np.array([first, *(drawn.configuration() for _ in range(2))])
    motion = smooth_path(drawn.limits, path)
    found = drawn.dynamics.along_skill(motion, slice(0, len(motion.t)))
    assume(found.overloaded < 0)
    # Jerk may make an acceleration a peak at a row, too narrow for samples beside it.
    often = np.union1d(np.linspace(0.0, motion.seconds, 2000), motion.t)
    q, v, a = cubic_at(motion.t, motion.q, motion.v, often)
    a[[0, -1]] = 0.0

    def worst(factor: float) -> float:
        return drawn.worst(q, v / factor, a / factor**2)

    for later in (1.0, 1.3, 5.0):
        assert worst(found.factor * later) <= 1.0 + 1e-6
    if found.factor > 1.0:
        assert worst(0.97 * found.factor) > 1.0


@pytest.mark.parametrize("name", MODELS)
def test_gravity_is_that_of_the_description(name: str) -> None:
    drawn = Drawn(name, 3)
    still = np.zeros((1, drawn.robot.model.dof))
    q = drawn.configuration()
    own = drawn.efforts(q[None], still, still)[0]
    assert np.allclose(drawn.dynamics.gravity(q), own, atol=1e-9)


def test_what_an_arm_cannot_hold_is_said() -> None:
    model = robot_model("ur5e")
    robot = PlacedRobot("arm", model, np.eye(4), model.home)
    heavy = HandPayload(30.0, box_shape("part", (0.1, 0.1, 0.1)), np.eye(4))
    stretched = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    way = np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.0])
    stretch = straight_stretch(MotionLimits.of(model), way)
    loaded = ArmDynamics(robot, model, [heavy]).along_stretch(stretched, way, stretch)
    assert loaded.overloaded == 1
    assert (
        ArmDynamics(robot, model).along_stretch(stretched, way, stretch).overloaded < 0
    )


def test_descriptions_that_tell_too_little_are_not_checked() -> None:
    def why(name: str, **changes: object) -> str | None:
        model = replace(robot_model(name), **changes)  # type: ignore[arg-type]
        return explain_unchecked_efforts(
            PlacedRobot("arm", model, np.eye(4), model.home)
        )

    model = robot_model("ur5e")
    assert model.drives is not None
    assert model.inertias is not None
    assert all(why(name) is None for name in ARMS)
    assert why("gp4") == "its effort limits are unknown"
    assert why("ur5e", inertias=None) == "its masses are unknown"
    nothing = replace(model.inertias, mass=np.zeros(6))
    assert "shoulder_pan_joint" in str(why("ur5e", inertias=nothing))
    alike = replace(model.inertias, mass=np.ones(6))
    assert "same mass" in str(why("ur5e", inertias=alike))
    weak = replace(model.drives, effort=np.full(6, 1.0))
    assert "hold the arm at HOME" in str(why("ur5e", drives=weak))


def test_a_joint_of_unknown_effort_bears_anything() -> None:
    model = robot_model("ur5e")
    assert model.drives is not None
    effort = np.array(model.drives.effort)
    effort[2] = np.inf
    model = replace(model, drives=replace(model.drives, effort=effort))
    robot = PlacedRobot("arm", model, np.eye(4), model.home)
    way = np.array([0.5, 0.0, 0.5, 0.0, 0.0, 0.0])
    stretch = straight_stretch(MotionLimits.of(model), way)
    found = ArmDynamics(robot, model).along_stretch(model.home, way, stretch)
    assert found.overloaded < 0
    assert found.joint != 2

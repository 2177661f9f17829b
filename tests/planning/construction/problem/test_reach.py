"""Who reaches what: drawn configurations, and what cannot be built at all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.cell.workcell import PlacedRobot, Workcell
from planning.construction.problem.feasibility import (
    require_buildable,
    require_free_supply,
    require_grounded,
)
from planning.construction.problem.models import ModelPart, tower
from planning.construction.problem.problem import ConstructionProblem
from planning.construction.problem.reach_bounds import ReachBounds, require_reach
from planning.construction.problem.reach_sampler import ReachSampler
from planning.construction.problem.site import (
    build_problem,
    ground_fixture,
    part_objects,
)
from planning.construction.problem.supply_layout import Rows, Spiral, SupplyLayout
from planning.errors import ConstructionError
from planning.kinematics.kinematics import frame_pose, inverse_kinematics
from planning.robots.registry import robot_model
from planning.transforms import from_rpy, read_only_copy, translation


def standing(name: str, model: str, *park: float, base: float = 0.0) -> PlacedRobot:
    """Return a robot, parked where it can drive, its base along x where it cannot."""
    kind = robot_model(model)
    home = np.array(kind.home)
    home[: len(park)] = park
    return PlacedRobot(name, kind, translation(base, 0.0, 0.0), home)


def team(*extra: PlacedRobot) -> tuple[PlacedRobot, ...]:
    return (standing("arm", "mobile-iiwa14", 5.0, 0.0, np.pi), *extra)


CRANE = standing("crane", "tower-crane", base=-1.9)


def problem(
    robots: tuple[PlacedRobot, ...],
    parts: tuple[ModelPart, ...],
    layout: SupplyLayout | None = None,
    offsets: tuple[float, ...] = (0.0, 0.25, -0.25),
) -> ConstructionProblem:
    objects = part_objects(parts, layout or Spiral())
    cell = Workcell(robots, (ground_fixture(),), objects)
    return build_problem(cell, parts, offsets=offsets)


def test_which_robots_drive() -> None:
    assert robot_model("mobile-manipulator").is_mobile
    assert robot_model("mobile-iiwa14").is_mobile
    for name in ("tower-crane", "gp4"):
        assert not robot_model(name).is_mobile


def test_a_mobile_base_is_drawn_between_two_places() -> None:
    a, b = np.array([3.0, -2.0]), np.array([0.0, 4.0])
    rng = np.random.default_rng(4)
    sampler = ReachSampler(standing("r", "mobile-manipulator"))
    model = sampler.robot.model
    drawn = np.array([sampler.draw(rng, (a, b)) for _ in range(200)])
    assert np.all((drawn >= model.lower) & (drawn <= model.upper))
    along = (drawn[:, :2] - a) @ (b - a) / ((b - a) @ (b - a))
    off = drawn[:, :2] - (a + np.clip(along, 0.0, 1.0)[:, None] * (b - a))
    assert np.median(np.linalg.norm(off, axis=1)) < 2.0
    assert along.min() < 0.2
    assert along.max() > 0.8
    assert np.ptp(drawn[:, 2]) > np.pi


@pytest.mark.parametrize(
    "model", ["mobile-manipulator", "mobile-iiwa14", "tower-crane"]
)
def test_drawn_configurations_are_solutions(model: str) -> None:
    robot = standing("r", model)
    sampler, rng = ReachSampler(robot), np.random.default_rng(1)
    heights = (1.0, 1.5, 2.2) if model == "tower-crane" else (0.15, 0.6, 1.1)
    count = 0
    for z in heights:
        target = from_rpy((1.7, -1.2, z), (np.pi, 0.0, 0.4))
        found = sampler.sample(target, rng, 10)
        for q in found:
            assert np.all((q >= robot.model.lower) & (q <= robot.model.upper))
            assert np.allclose(frame_pose(robot, q, "tool"), target, atol=1e-6)
        count += len(found)
    if sampler.mobile:
        assert count >= 25  # of 30 starts: nearly every one


@given(
    st.floats(-3.0, 3.0),
    st.floats(-3.0, 3.0),
    st.floats(0.1, 2.2),
    st.floats(-1.5, 1.5),
    st.floats(-3.1, 3.1),
    st.floats(-3.1, 3.1),
)
@settings(max_examples=25, deadline=None)
def test_what_plain_search_reaches_is_drawn_too(
    x: float, y: float, z: float, lean: float, turn: float, roll: float
) -> None:
    # The oracle: damped least squares from many random starts, base and all.
    robot = standing("r", "mobile-manipulator")
    target = from_rpy((x, y, z), (roll, np.pi / 2 + lean, turn))
    plain = inverse_kinematics(robot, "tool", target, robot.home, restarts=60)
    drawn = ReachSampler(robot).sample(target, np.random.default_rng(0), 24)
    if len(plain) >= 3:  # well inside of what can be reached
        assert drawn


def test_last_beams_need_a_handover_and_a_chain_is_found() -> None:
    parts = tower(15, (0.7, 0.2, 0.096))
    bounds = require_buildable(problem(team(CRANE), parts))
    for k, part in enumerate(bounds.problem.parts, start=1):
        assert bounds.pickers(part) == ("arm",)
        assert bounds.chain(part) == (("arm",) if k <= 12 else ("arm", "crane"))
    last = bounds.problem.parts[-1]
    drawn = bounds.draw_handover(
        "arm", "crane", last, np.random.default_rng(3), bounds.pick_grips("arm", last)
    )
    assert drawn is not None
    tools = [
        frame_pose(bounds.problem.cell.robot(name), q, "tool")
        for name, q in zip(("arm", "crane"), drawn.q, strict=True)
    ]
    for tool, wanted in zip(tools, drawn.tools, strict=True):
        assert np.allclose(tool, wanted, atol=1e-6)
    # Both pads lie on the top of the beam, apart from each other.
    away = tools[0][:3, 3] - tools[1][:3, 3]
    assert np.allclose(tools[0][:3, 2], tools[1][:3, 2], atol=1e-6)
    assert away @ tools[0][:3, 2] == pytest.approx(0.0, abs=1e-6)
    assert np.linalg.norm(away) > 0.2


def test_without_a_second_spot_to_hold_there_is_no_handover() -> None:
    parts = tower(15, (0.7, 0.2, 0.096))
    with pytest.raises(ConstructionError) as caught:
        require_buildable(problem(team(CRANE), parts, offsets=(0.0,)))
    assert caught.value.message == (
        "the team cannot build beam13, beam14, beam15: arm can pick beam13, only crane can "
        "place it, and no handover between them was found"
    )


def test_a_place_too_high_is_named() -> None:
    with pytest.raises(ConstructionError) as caught:
        require_reach(ReachBounds(problem(team(), tower(15, (0.7, 0.2, 0.096)))))
    assert caught.value.message == (
        "beam13 cannot be placed: none of arm reaches its place, at (0.00, 0.00, 1.20) m"
    )


def test_a_supply_out_of_reach_is_named() -> None:
    far = Rows((15.0, 0.0), 1, (1.0, 1.0))
    with pytest.raises(ConstructionError, match=r"beam1 cannot be picked: none of arm"):
        require_reach(ReachBounds(problem(team(), tower(2), far)))


def test_a_supply_in_collision_is_named() -> None:
    close = Rows((3.0, 0.0), 1, (1.0, 0.5))
    with pytest.raises(
        ConstructionError, match=r"beam2 and beam1 overlap by 100 mm at the start"
    ):
        require_free_supply(problem(team(), tower(3), close))
    under = Rows((5.0, 0.0), 1, (1.0, 1.0))
    with pytest.raises(
        ConstructionError,
        match=r"arm cannot stand at HOME at the start: arm/arm.*beam1",
    ):
        require_free_supply(problem(team(), tower(1), under))
    require_free_supply(problem(team(), tower(3)))


def test_parts_in_the_air_are_named() -> None:
    parts = tower(4)
    loose = replace(parts[3], goal=read_only_copy(translation(0.0, 0.0, 1.0)))
    with pytest.raises(ConstructionError, match="nothing connects beam4 to the ground"):
        require_grounded(problem(team(), (*parts[:3], loose)))


def test_robots_of_one_kind_are_asked_once() -> None:
    two = (*team(), standing("other", "mobile-iiwa14", -5.0, 0.0, 0.0))
    bounds = ReachBounds(problem(two, tower(2)))
    part = bounds.problem.parts[0]
    assert (
        bounds.pick_grips("arm", part) == bounds.pick_grips("other", part) == (0, 1, 2)
    )
    assert bounds.able_alone(part) == ("arm", "other")

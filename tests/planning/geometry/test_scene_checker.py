"""Scene checks against every pair of hulls measured at dense samples."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from planning.cell.shape import box_shape
from planning.cell.workcell import (
    Attachment,
    CellObject,
    Fixture,
    PlacedRobot,
    Workcell,
    WorldState,
)
from planning.geometry.exact import distance_at, resting_solid
from planning.geometry.robot_bodies import robot_bodies
from planning.geometry.scene_checker import SceneChecker
from planning.kinematics.kinematics import frame_pose
from planning.motion.speed import L1Speed
from planning.motion.transit import RrtConnect
from planning.transforms import from_rpy, translation


def _cell(make_arm: Callable[..., PlacedRobot], seed: int) -> Workcell:
    rng = np.random.default_rng(seed)
    one = make_arm("one")
    two = make_arm("two", from_rpy((0.9, 0.1, 0.0), (0.0, 0.0, 3.0)))
    size = np.array([0.06, 0.12, 0.04])
    brick = box_shape("brick", size)
    objects = tuple(
        CellObject(
            f"brick{k}",
            "brick",
            brick,
            from_rpy(rng.uniform(-0.6, 0.6, 3), rng.uniform(-3, 3, 3)),
        )
        for k in range(6)
    )
    table_size = np.array([2.0, 2.0, 0.02])
    table = Fixture("table", box_shape("table", table_size), translation(0, 0, -0.2))
    return Workcell((one, two), (table,), objects)


def _state(cell: Workcell, held: str | None) -> WorldState:
    attachments = {o.name: Attachment(None, o.start) for o in cell.objects}
    if held is not None:
        attachments["brick0"] = Attachment(held, translation(0.05, 0.0, 0.0))
    configurations = {
        "one": np.zeros(4),
        "two": np.array([0.1, 0.3, -0.2, 0.0]),
    }
    return WorldState(configurations, attachments)


def _least_gap(cell: Workcell, state: WorldState, q: np.ndarray) -> float:
    """Return the least distance over every pair that counts, less its clearance."""
    one, two = cell.robots
    mine = robot_bodies(one).solids
    other = robot_bodies(two).solids
    q_two = state.configurations["two"]
    gaps = []
    for a in mine:
        for b in other:
            gaps.append(distance_at(a, q, b, q_two) - cell.clearances.robot_robot)
    for i in range(len(mine)):
        for j in range(i + 1, len(mine)):
            if (i, j) not in one.model.never_collide:
                gaps.append(distance_at(mine[i], q, mine[j], q))
    boxes = [(f.shape.pieces[0], f.pose, 0.0) for f in cell.fixtures]
    hand = None
    between = cell.clearances.robot_robot
    for item in cell.objects:
        at = state.attachments[item.name]
        if at.holder == "one":
            hand = resting_solid(
                item.name, item.shape.pieces[0], frame_pose(one, q) @ at.pose
            )
        elif at.holder == "two":
            boxes.append(
                (item.shape.pieces[0], frame_pose(two, q_two) @ at.pose, between)
            )
        else:
            boxes.append((item.shape.pieces[0], at.pose, 0.0))
    solids = [(resting_solid("box", body, pose), least) for body, pose, least in boxes]
    for solid, least in solids:
        gaps.extend(distance_at(a, q, solid, q) - least for a in mine)
    if hand is not None:
        gaps.extend(distance_at(hand, q, b, q_two) - between for b in other)
        gaps.extend(distance_at(hand, q, solid, q) - least for solid, least in solids)
        gaps.extend(distance_at(a, q, hand, q) for a in mine[:3])
    return min(gaps)


@pytest.mark.parametrize("held", [None, "one", "two"])
@pytest.mark.parametrize("seed", range(4))
def test_configurations_agree_with_all_pairs(
    make_arm: Callable[..., PlacedRobot], held: str | None, seed: int
) -> None:
    cell = _cell(make_arm, seed)
    state = _state(cell, held)
    allowed = frozenset({frozenset(("one/tool", "brick0"))} if held == "one" else ())
    checker = SceneChecker(cell, "one", state, allowed)
    rng = np.random.default_rng(seed + 100)
    answers = set()
    for _ in range(60):
        q = rng.uniform(cell.robots[0].model.lower, cell.robots[0].model.upper)
        gap = _least_gap(cell, state, q)
        if abs(gap) < 3e-4:
            continue
        assert checker.configuration_free(q) is (gap > 0)
        contact = checker.contact(q)
        assert (contact is None) is (gap > 0)
        if contact is not None:
            assert contact.distance - contact.limit == pytest.approx(gap, abs=1e-6)
        answers.add(gap > 0)
    assert answers == {True, False} or held == "one"


@pytest.mark.parametrize("seed", range(6))
def test_a_free_motion_is_free_at_every_sample(
    make_arm: Callable[..., PlacedRobot], seed: int
) -> None:
    cell = _cell(make_arm, seed)
    state = _state(cell, None)
    checker = SceneChecker(cell, "one", state)
    rng = np.random.default_rng(seed)
    model = cell.robots[0].model
    for _ in range(12):
        q_a, q_b = rng.uniform(model.lower, model.upper, (2, 4))
        gaps = [
            _least_gap(cell, state, q_a + t * (q_b - q_a))
            for t in np.linspace(0, 1, 60)
        ]
        free = checker.motion_free(q_a, q_b)
        seems = checker.seems_free(q_a, q_b)
        assert seems or not free
        assert checker.configuration_free(q_b) or not seems
        if min(gaps) < 0:
            assert not free
        if min(gaps) > 0.03:
            assert free


@pytest.mark.parametrize("seed", range(4))
def test_a_planned_way_is_free_at_every_sample(
    make_arm: Callable[..., PlacedRobot], seed: int
) -> None:
    cell = _cell(make_arm, seed)
    state = _state(cell, None)
    checker = SceneChecker(cell, "one", state)
    model = cell.robots[0].model
    planner = RrtConnect(model.lower, model.upper, L1Speed())
    rng = np.random.default_rng(seed)
    planned = 0
    for query in range(20):
        start, goal = rng.uniform(model.lower, model.upper, (2, 4))
        if not (checker.configuration_free(start) and checker.configuration_free(goal)):
            continue
        path = planner.plan(checker, start, goal, query)
        if path is None or len(path) == 2:
            continue
        planned += 1
        for a, b in pairwise(path):
            steps = int(np.max(np.abs(b - a)) / 0.01) + 2
            for t in np.linspace(0.0, 1.0, steps):
                assert _least_gap(cell, state, a + t * (b - a)) >= 0.0
        if planned == 3:
            break
    assert planned > 0


def test_an_allowed_pair_is_not_checked(make_arm: Callable[..., PlacedRobot]) -> None:
    arm = make_arm("one")
    size = np.array([0.05, 0.05, 0.05])
    at_tip = frame_pose(arm, np.zeros(4)) @ translation(0.0, 0.0, 0.0)
    brick = CellObject("brick0", "brick", box_shape("brick", size), at_tip)
    cell = Workcell((arm,), (), (brick,))
    state = WorldState({"one": np.zeros(4)}, {"brick0": Attachment(None, at_tip)})
    assert not SceneChecker(cell, "one", state).configuration_free(np.zeros(4))
    pair = frozenset({frozenset(("one/tool", "brick0"))})
    assert SceneChecker(cell, "one", state, pair).configuration_free(np.zeros(4))

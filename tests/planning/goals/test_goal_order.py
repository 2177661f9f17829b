"""Robots make room for each other at their goals, and end at their last ones."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from planning.cell.workcell import PlacedRobot, Workcell
from planning.errors import InfeasibleStepError
from planning.geometry.scene_checker import SceneChecker
from planning.goals.goal_order import ReachedGoal, order_goals
from planning.goals.goal_work import prepare_goals
from planning.goals.robot_goal import RobotGoal
from planning.kinematics.kinematics import frame_pose, inverse_kinematics
from planning.motion.sequential import MARGIN
from planning.tasks.highs_solver import assign_steps
from planning.transforms import Array, Transform, from_rpy
from tests.planning.parts.boxes import two_arms

CELL = two_arms()
NORTH, SOUTH = ((0.0, y, 0.3) for y in (0.2, -0.2))
MIDDLE = (0.0, 0.0, 0.3)


def three_arms() -> Workcell:
    """Return three arms on a circle around the origin."""
    model = CELL.robots[0].model
    turns = {"east": 0.0, "north": 2.0 * np.pi / 3.0, "south": -2.0 * np.pi / 3.0}
    robots = (
        PlacedRobot(
            name,
            model,
            from_rpy((0.6 * np.cos(a), 0.6 * np.sin(a), 0), (0, 0, a + np.pi)),
            model.home,
        )
        for name, a in turns.items()
    )
    return replace(CELL, robots=tuple(robots))


def goal(robot: str, at: tuple[float, float, float], turned: float = 0.0) -> RobotGoal:
    return RobotGoal(robot, pose=from_rpy(at, (np.pi, 0.0, turned)))


def order(cell: Workcell, *goals: RobotGoal) -> list[ReachedGoal]:
    numbered = [replace(item, number=k) for k, item in enumerate(goals, start=1)]
    return order_goals(cell, numbered)


def labels(reached: list[ReachedGoal]) -> list[str]:
    return [f"{item.goal.robot} {item.goal.label}" for item in reached]


def collides(cell: Workcell, name: str, at: dict[str, Array]) -> bool:
    """Tell whether a robot is in contact with another one or a fixture."""
    state = cell.start_state()
    for robot, q in at.items():
        state = state.with_robot(robot, q)
    checker = SceneChecker(cell, name, state, margin=MARGIN)
    return checker.contact(at[name]) is not None


def follow(cell: Workcell, reached: list[ReachedGoal]) -> dict[str, Array]:
    """Return where robots end, after a check that each finds a free configuration of its goal."""
    at = {robot.name: robot.home for robot in cell.robots}
    for item in reached:
        name = item.goal.robot
        tried = ({**at, name: q} for q in item.nearest_first())
        free = next((then for then in tried if not collides(cell, name, then)), None)
        assert free, f"{name} {item.goal.label}: another robot stands there"
        at = free
    return at


def at_pose(robot: PlacedRobot, q: Array, pose: Transform) -> bool:
    return bool(np.allclose(frame_pose(robot, q, "tool"), pose, atol=1e-5))


def test_goals_that_nobody_stands_at_keep_their_order() -> None:
    reached = order(CELL, goal("west", NORTH), goal("east", SOUTH))
    assert labels(reached) == ["west to goal 1", "east to goal 2"]


def test_two_robots_that_change_places_make_room() -> None:
    goals = [goal("west", NORTH), goal("east", SOUTH)]
    goals += [goal("west", SOUTH), goal("east", NORTH)]
    reached = order(CELL, *goals)
    assert [item.goal.number for item in reached if item.goal.purpose == "goal"] == [
        1,
        2,
        3,
        4,
    ]
    assert "east out of the way of goal 3" in labels(reached)
    at = follow(CELL, reached)
    for robot, wanted in zip(CELL.robots, goals[2:], strict=True):
        assert wanted.pose is not None
        assert at_pose(robot, at[robot.name], wanted.pose)


def test_a_robot_that_can_go_on_does_so_first() -> None:
    """East stands in the middle and has a goal elsewhere: no other motion is needed."""
    reached = order(
        CELL, goal("east", MIDDLE), goal("west", MIDDLE), goal("east", (0.45, 0.3, 0.3))
    )
    assert labels(reached) == ["east to goal 1", "east to goal 3", "west to goal 2"]


def test_a_robot_returns_to_its_last_goal() -> None:
    reached = order(
        CELL, goal("east", MIDDLE), goal("west", MIDDLE), goal("west", (-0.45, 0, 0.4))
    )
    assert labels(reached) == [
        "east to goal 1",
        "east out of the way of goal 2",
        "west to goal 2",
        "west to goal 3",
        "east back to goal 1",
    ]
    follow(CELL, reached)


def test_three_robots_change_places_in_a_ring() -> None:
    cell = three_arms()
    angles = np.deg2rad([0.0, 120.0, -120.0])
    places = [(0.22 * np.cos(a), 0.22 * np.sin(a), 0.3) for a in angles]
    first = [goal(r.name, p) for r, p in zip(cell.robots, places, strict=True)]
    shifted = places[1:] + places[:1]
    then = [goal(r.name, p) for r, p in zip(cell.robots, shifted, strict=True)]
    reached = order(cell, *first, *then)
    assert any(item.goal.purpose == "make room" for item in reached)
    at = follow(cell, reached)
    for robot, wanted in zip(cell.robots, then, strict=True):
        assert wanted.pose is not None
        assert at_pose(robot, at[robot.name], wanted.pose)


def test_last_goals_at_one_place_are_refused_with_both_names() -> None:
    goals = [goal("east", MIDDLE), goal("west", MIDDLE)]
    numbered = [replace(item, number=k) for k, item in enumerate(goals, start=1)]
    work = prepare_goals(CELL, numbered)
    with pytest.raises(InfeasibleStepError, match="east stands there at goal 1"):
        assign_steps(work.problem)


PLACES = st.tuples(st.integers(-2, 2), st.integers(-2, 2)).map(
    lambda k: (0.12 * k[0], 0.12 * k[1], 0.35)
)


@settings(max_examples=12, deadline=None)
@given(st.lists(st.tuples(st.sampled_from(["west", "east"]), PLACES), max_size=5))
@example([("west", MIDDLE), ("east", MIDDLE), ("west", NORTH), ("east", NORTH)])
def test_random_goals_are_reached_or_end_at_one_place(
    moves: list[tuple[str, tuple[float, float, float]]],
) -> None:
    goals = [goal(*move) for move in moves]
    reached = order(CELL, *goals)
    last = {item.robot: item for item in goals}
    stuck = [item for item in reached if not item.configurations]
    if not stuck:
        at = follow(CELL, reached)
        done = [item.goal.number for item in reached if item.goal.purpose == "goal"]
        assert sorted(done) == list(range(1, len(goals) + 1))
        for name, item in last.items():
            assert item.pose is not None
            assert at_pose(CELL.robot(name), at[name], item.pose)
        return
    if any("out of reach" in why.words for why in stuck[0].rejected.values()):
        return
    # Oracle: the last goals collide in all configurations, or one of them collides alone.
    ends = {}
    for name, item in last.items():
        assert item.pose is not None
        robot = CELL.robot(name)
        ends[name] = inverse_kinematics(robot, "tool", item.pose, robot.home)
    pairs = product(*ends.values())
    for pair in pairs:
        at = dict(zip(ends, pair, strict=True))
        assert any(collides(CELL, name, at) for name in at)

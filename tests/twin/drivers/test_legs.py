"""Cleared nodes as straight legs, against brute force."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from planning.transforms import Array
from twin.drivers.driver import ClearedNode
from twin.drivers.legs import STRAIGHT, ClearedPath


def node(
    number: int, points: list[list[float]], task: int = 0, act: str = ""
) -> ClearedNode:
    seconds: Array = 0.5 * np.arange(1.0, len(points) + 1)
    return ClearedNode(number, task, "transit", "", np.array(points), seconds, act)


def nearest(points: Array, q: Array) -> float:
    """Return the distance to a polyline, by looking at many of its points."""
    dense = [
        a + s * (b - a)
        for a, b in zip(points, points[1:], strict=False)
        for s in np.linspace(0.0, 1.0, 400)
    ]
    return float(np.abs(np.array(dense) - q).max(axis=1).min())


def test_a_leg_ends_at_corners_and_where_a_tool_acts() -> None:
    path = ClearedPath(np.zeros(2), 0)
    path.add(node(0, [[1, 0], [2, 0]]))
    path.add(node(1, [[3, 0.001], [3, 1]]))
    path.add(node(2, [[3, 1]], act="close"))
    path.add(node(3, [[3, 2]]))
    assert [path.leg_end(k) for k in (0, 3, 4)] == [3, 4, 5]
    stands = [k for k, point in enumerate(path.points) if point.stands]
    assert stands == [5]
    assert [point.done for point in path.points] == [0, 0, 1, 1, 2, 3, 4]
    assert path.turn_sine(0, 3) > 0.99


def test_a_leg_does_not_turn_back() -> None:
    path = ClearedPath(np.zeros(2), 0)
    path.add(node(0, [[1, 1], [0, 0]]))
    assert path.leg_end(0) == 1
    assert path.turn_sine(0, 1) == 1.0


def test_what_is_cleared_later_makes_a_leg_longer() -> None:
    path = ClearedPath(np.zeros(2), 0)
    path.add(node(0, [[1, 1]]))
    known = path.leg_end(0)
    path.add(node(1, [[2, 2]]))
    path.add(node(2, [[2, 3]]))
    assert path.leg_end(0, known) == path.leg_end(0) == 2


def test_the_way_back_leads_to_where_the_task_began() -> None:
    path = ClearedPath(np.zeros(1), 4)
    path.add(node(4, [[1]], task=7))
    path.add(node(5, [[2], [3]], task=8))
    path.add(node(6, [[3]], task=8, act="close"))
    back = path.path_back(4)
    assert [float(point.q[0]) for point in back.points] == [3, 2, 1]
    assert {point.done for point in back.points} == {6}


def test_a_robot_takes_up_the_path_where_it_is_nearest() -> None:
    path = ClearedPath(np.zeros(2), 0)
    path.add(node(0, [[1, 0], [1, 1]]))
    path.add(node(1, [[1, 0]]))
    assert path.nearest_segment(np.array([0.5, 0.01])) == (0, 0.01)
    assert path.nearest_segment(np.array([1.0, 0.5])) == (1, 0.0)


@given(
    st.lists(st.tuples(*[st.floats(-1, 1)] * 2), min_size=2, max_size=8, unique=True),
    st.tuples(*[st.floats(-1, 1)] * 2),
)
def test_legs_stay_by_the_path(
    points: list[tuple[float, float]], q: tuple[float, float]
) -> None:
    path = ClearedPath(np.array(points[0]), 0)
    path.add(node(0, [list(point) for point in points[1:]]))
    begin, end = 0, len(path.points) - 1
    while begin < end:
        stop = path.leg_end(begin)
        own = path.configurations(begin, stop)
        if len(own) > 1:
            for share in np.linspace(0.0, 1.0, 7):
                middle = own[0] + share * (own[-1] - own[0])
                assert path.deviation(begin, stop, middle) <= 2 * STRAIGHT
        begin = stop
    dense = nearest(path.configurations(0, end), np.array(q))
    euclid = path.deviation(0, end, np.array(q))
    assert dense - 0.01 <= euclid <= np.sqrt(2) * dense + 0.01

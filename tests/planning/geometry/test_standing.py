"""Tables of standing boxes: every row that compiled code looks up is there."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from planning.cell.cover import box_body
from planning.cell.workcell import PlacedRobot, Workcell
from planning.geometry.hull_table import AT_REST
from planning.geometry.standing import stand_boxes
from planning.transforms import from_rpy

SIZE = np.array([0.06, 0.12, 0.04])


def test_tables_reach_as_far_as_the_rows_of_a_scene(
    make_arm: Callable[..., PlacedRobot],
) -> None:
    robot = make_arm("one")
    cell = Workcell((robot,), (), ())
    brick = box_body("brick", SIZE)
    rng = np.random.default_rng(0)
    poses = [from_rpy(rng.uniform(-1, 1, 3), rng.uniform(-3, 3, 3)) for _ in range(40)]
    stand_boxes(cell.fixtures, [(f"other{k}", brick, p) for k, p in enumerate(poses)])
    # A scene of few boxes, whose rows come after those of many others.
    few = stand_boxes(cell.fixtures, [("last", brick, poses[-1])])
    table = few.hulls
    rows = table.solid[0]
    assert rows.tolist() == few.rows.tolist()
    assert rows.min() >= 39
    assert len(table.corner_first) > rows.max() + 1
    assert len(table.capsule_first) > rows.max() + 1
    assert table.joint[rows].tolist() == [AT_REST]
    first, last = table.corner_first[rows[0]], table.corner_first[rows[0] + 1]
    placed = brick.vertices @ poses[-1][:3, :3].T + poses[-1][:3, 3]
    assert np.array_equal(table.corners[first:last], placed)

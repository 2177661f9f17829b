"""Rows of what was measured of a robot that stands, and never quite still."""

from __future__ import annotations

import numpy as np

from twin.drivers.driver import Sample
from twin.live.measured import MeasuredRows


def test_a_robot_that_settles_while_it_stands_has_not_begun_its_next_node() -> None:
    rows = MeasuredRows()
    rows.cleared_ns = [0, 0]
    told = [
        (0, 0.0, 0, 0),
        (10, 0.0, 1, 0),
        (20, 1.0, 1, 1),
        (30, 1.001, 1, 1),
        (40, 1.002, 1, 1),
        (50, 1.1, 2, 1),
        (60, 2.0, 2, 2),
    ]
    for t_ns, q, begun, done in told:
        rows.add(t_ns, Sample(t_ns / 1e9, np.array([q]), begun, done))
    found = rows.measured()
    second = found.t_ns[found.node == 1]
    # Its first row is the last one of standing, where nothing moves between the two nodes.
    assert second.min() == 40
    assert rows.begin_ns == [10, 50]
    at = np.flatnonzero(found.t_ns == 40)
    assert found.node[at].tolist() == [0, 1]
    assert np.ptp(found.q[at]) == 0.0

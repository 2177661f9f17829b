"""What the audit looks at while a robot stands: both ends of it, however long that is."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.cell.workcell import Workcell
from tests.twin.twin_toys import toy_cell
from twin.audits.motion.deviations import with_flange_deviations
from twin.audits.motion.executed import Recording, RobotRows

STEP_S = 0.02


def stopped_rows(stand_s: float, *, smooth: bool, off: float = 0.0) -> RobotRows:
    """Return a robot that is stopped in the middle of its second node; rounding moves it meanwhile."""
    t = np.cumsum([0.0, 1.0, 0.5, stand_s, 0.5])
    q = np.array([0.0, 0.3, 0.5, 0.5 + off, 0.8])[:, None] * np.ones(2)
    node = np.array([-1, 0, 1, 1, 1])
    v = np.array([0.0, 0.5, 0.0, 0.0, 0.9])[:, None] * np.ones(2)
    a = np.zeros_like(v)
    return RobotRows(t, q, node, *((v, a) if smooth else ()))


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("off", [0.0, 1e-16])
def test_a_standstill_of_days_is_looked_at_as_often_as_one_of_a_minute(
    smooth: bool, off: float
) -> None:
    counts = []
    for stand_s in (60.0, 1e6):
        rows = stopped_rows(stand_s, smooth=smooth, off=off)
        times = rows.moving_samples(0.25, float(rows.t[-1]), STEP_S)
        counts.append(len(times))
        assert set(rows.t[1:]) <= set(times)
        gaps = np.diff(times)
        assert np.sum(gaps > STEP_S + 1e-6) == 1
        assert gaps.max() == pytest.approx(stand_s)
    assert abs(counts[0] - counts[1]) <= 1  # rounding of the sums of times
    assert counts[0] > 2.0 / STEP_S * 0.8


@settings(max_examples=20)
@given(st.floats(0.0, 1e6))
def test_a_deviation_does_not_depend_on_how_long_the_robot_stands_within_it(
    stand_s: float,
) -> None:
    found = []
    for seconds in (1.0, 1.0 + stand_s):
        rows = stopped_rows(seconds, smooth=False)
        cell: Workcell = toy_cell((2,))
        twist = {("robot_0", 1): np.array([0.0, 0.002, 0.0, 0.0, 0.0, 0.0])}
        recording = Recording({"robot_0": rows}, (), float(rows.t[-1]))
        found.append(with_flange_deviations(cell, recording, twist).robots["robot_0"])
    one, other = found
    assert abs(len(one.t) - len(other.t)) <= 1
    assert np.abs(one.q.max(axis=0) - other.q.max(axis=0)).max() < 1e-4
    # The node before takes a second, too, between two rows.
    stands = np.flatnonzero((np.diff(other.t) > 0.5) & (other.t[:-1] >= 1.0))
    assert len(stands) == 1
    assert np.allclose(other.q[stands], other.q[stands + 1], atol=1e-9)

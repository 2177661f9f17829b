"""Motions from rest, in pieces of constant jerk."""

import numpy as np
import numpy.typing as npt

from planning.transforms import Array
from twin.audits.motion.executed import RobotRows


def jerked(spans: npt.ArrayLike, jerks: npt.ArrayLike) -> RobotRows:
    """From rest, in pieces of some seconds, shape (k,), and jerks, shape (k, joints)."""
    jerk = np.asarray(jerks, dtype=float)
    times = np.asarray(spans, dtype=float)
    q, v, a = np.zeros((3, len(times) + 1, jerk.shape[1]))
    for k, (h, j) in enumerate(zip(times, jerk, strict=True)):
        a[k + 1] = a[k] + h * j
        v[k + 1] = v[k] + h * a[k] + h * h * j / 2.0
        q[k + 1] = q[k] + h * v[k] + h * h * a[k] / 2.0 + h**3 * j / 6.0
    return RobotRows(np.append(0.0, np.cumsum(times)), q, np.arange(len(q)), v, a)


def swing(
    jerk: float,
    seconds: float,
    shares: npt.ArrayLike = (1.0,),
    home: Array | float = 0.0,
) -> RobotRows:
    """From rest at HOME to rest in four pieces; each joint does its share of that."""
    pieces = jerk * np.outer(np.array([1.0, -1.0, -1.0, 1.0]), np.asarray(shares))
    rows = jerked([seconds] * 4, pieces)
    return RobotRows(rows.t, home + rows.q, rows.node, rows.v, rows.a)


def states_of(rows: RobotRows, times: Array) -> tuple[Array, Array, Array]:
    """Positions, speeds and accelerations of the first joint, by Taylor's formula."""
    assert rows.v is not None
    assert rows.a is not None
    k = np.minimum(np.searchsorted(rows.t, times, side="right") - 1, len(rows.t) - 2)
    s, (q, v, a) = times - rows.t[k], (own[k, 0] for own in (rows.q, rows.v, rows.a))
    j = (rows.a[k + 1, 0] - a) / (rows.t[k + 1] - rows.t[k])
    way = q + s * (v + s * (a / 2.0 + s * j / 6.0))
    return way, v + s * (a + s * j / 2.0), a + s * j

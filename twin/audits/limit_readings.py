"""Comparison of joint values with their limits; each time interval of excess is one violation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from planning.transforms import Array, Indices
from twin.audits.case import Violation, ViolationKind

LIMIT_TOLERANCE = 1e-6
"""Rounding tolerance: joint values, or ratios to their limits, may exceed limits by this much [rad, m or 1]."""

STEP_TOLERANCE_S = 2e-9
"""Rounding tolerance of the duration of a step, because times are whole nanoseconds [s]."""


@dataclass(frozen=True, eq=False)
class LimitReadings:
    """Rows of a robot, or steps between rows, with joint values to compare with limits.

    Attributes:
        robot: its name.
        names: of the joints.
        begin, end: of each row or step, shape (m,) [s].
        node: of each, shape (m,); None where that is not known.
    """

    robot: str
    names: Sequence[str]
    begin: Array
    end: Array
    node: Indices | None = None

    def excesses(
        self,
        kind: ViolationKind,
        units: Sequence[str],
        share: Array,
        values: Array,
        limits: Array | float,
        words: str = "",
    ) -> Iterator[Violation]:
        """Yield one violation for each interval in which a joint exceeds its limit.

        Args:
            kind: of limit.
            units: of values and limits, joint by joint.
            share: values over limits, above 1 for a violation, shape (m, n).
            values: shape (m, n).
            limits: shape (n,) or (m, n), or one for all.
            words: added to values and limits.
        """
        limits = np.broadcast_to(limits, share.shape)
        for joint, where in runs(share > 1.0):
            worst = where[np.argmax(share[where, joint])]
            value, limit = values[worst, joint], limits[worst, joint]
            # What must fit has no limit that could be named.
            said = _against(value, limit, units[joint]) if np.isfinite(limit) else ""
            node = "" if self.node is None else f", node {self.node[worst]}"
            times = float(self.begin[where[0]]), float(self.end[where[-1]])
            name, detail = self.names[joint], said + words + node
            yield Violation(*times, self.robot, name, 0.0, detail, kind)


def _against(value: float, limit: float, unit: str) -> str:
    """Return value and limit as text, with enough digits to differ."""
    digits = next((d for d in range(6, 17) if f"{value:.{d}g}" != f"{limit:.{d}g}"), 17)
    return f"{value:.{digits}g} {unit}, its limit is {limit:.{digits}g} {unit}"


def runs(bad: npt.NDArray[np.bool_]) -> Iterator[tuple[int, npt.NDArray[np.intp]]]:
    """Yield each run of consecutive True rows, by column."""
    for column in np.flatnonzero(bad.any(axis=0)).tolist():
        rows = np.flatnonzero(bad[:, column])
        for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1):
            yield column, run

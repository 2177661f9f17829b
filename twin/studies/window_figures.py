"""Statistics of the time windows between steps, over the replications of a study."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from planning.transforms import Array
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations.nanoseconds import NANOSECONDS, Nanoseconds
from twin.studies.replications.block_results import UNKNOWN, WindowTimes
from twin.studies.replications.statistics import (
    Figures,
    Interval,
    SummaryEntry,
    mean_interval,
    share_interval,
)

Flags = npt.NDArray[np.bool_]


class WindowFigures(Figures):
    """Figures of one window of time.

    Attributes:
        window: which steps.
        at_least_s, within_s: its bounds; None for no upper one.
        passed_s: mean time that passes [s].
        passed_p95_s: its percentile [s].
        broken: share of the replications in which it is broken; None where that cannot be.
        broken_free: the same without holding back, None where the plan has none.
    """

    window: str
    at_least_s: float
    within_s: float | None
    passed_s: SummaryEntry
    passed_p95_s: float
    broken: SummaryEntry | None
    broken_free: SummaryEntry | None


class WindowsSummary(Figures):
    """Figures of the windows of a cell.

    Attributes:
        windows: each of them.
        hold: required probability of keeping them, 0 without holding back.
        holding_s: increase of the makespan by holding back, replication by
            replication; None where nothing is [s].
    """

    windows: tuple[WindowFigures, ...]
    hold: float
    holding_s: SummaryEntry | None


def windows_summary(
    tpg: TemporalPlanGraph,
    hold: float,
    times: WindowTimes,
    makespans_s: Array,
    confidence: float,
) -> WindowsSummary | None:
    """Return the figures of a cell, None where no replication completed.

    Args:
        tpg: the executed plan.
        hold: required probability of keeping windows.
        times: elapsed times in them.
        makespans_s: of all replications, NaN where one did not complete, shape (r,) [s].
        confidence: of the intervals.
    """
    known = np.all(times.gap_ns != UNKNOWN, axis=0)
    if not known.any():
        return None
    gaps = times.gap_ns[:, known]
    late, free = _late(tpg, gaps), None
    holding = None
    if times.free_makespan_ns.size:
        both = known & np.isfinite(makespans_s) & (times.free_makespan_ns >= 0)
        free = _late(tpg, times.free_gap_ns[:, both])
        if both.any():
            longer = makespans_s[both] - times.free_makespan_ns[both] / NANOSECONDS
            holding = mean_interval(longer, confidence=confidence)

    def share(hits: Flags) -> Interval | None:
        total = hits.shape[-1]
        if not total:
            return None
        number = int(np.count_nonzero(hits))
        return share_interval(number, total, confidence=confidence)

    timed = [window.most is not None for window in tpg.windows]
    return WindowsSummary(
        windows=tuple(
            WindowFigures(
                window=window.words,
                at_least_s=window.least,
                within_s=window.most,
                passed_s=mean_interval(gaps[k] / NANOSECONDS, confidence=confidence),
                passed_p95_s=float(np.quantile(gaps[k], 0.95)) / NANOSECONDS,
                broken=share(late[k]) if timed[k] else None,
                broken_free=share(free[k]) if timed[k] and free is not None else None,
            )
            for k, window in enumerate(tpg.windows)
        ),
        hold=hold,
        holding_s=holding,
    )


def _late(tpg: TemporalPlanGraph, gaps: Nanoseconds) -> Flags:
    """Return whether windows are exceeded, shape (windows, r)."""
    most = [np.inf if w.most is None else w.most * NANOSECONDS for w in tpg.windows]
    return np.asarray(gaps > np.array(most)[:, None])

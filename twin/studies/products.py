"""Statistics of products over the replications of a study.

They are throughput, takt, lateness, and time windows between steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from planning.transforms import Array
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations.nanoseconds import NANOSECONDS, Nanoseconds
from twin.studies.replications.block_results import (
    UNKNOWN,
    ProductTimes,
    WindowTimes,
    cell_part,
)
from twin.studies.replications.statistics import (
    Figures,
    Interval,
    SummaryEntry,
    mean_interval,
    share_interval,
)
from twin.throughput.throughput import line_figures, start_up_of, takts_s

Due = tuple[tuple[float, ...], int | None]
"""Due time of each product [s], and number of start-up products."""

_QUANTILES = (0.5, 0.9, 0.99)
Flags = npt.NDArray[np.bool_]


class DueSummary(Figures):
    """Lateness of products, over replications.

    Attributes:
        late: share of products that are complete after they are due.
        any_late: share of replications in which one is.
        lateness_s: mean time by which they are [s].
        lateness_quantiles_s: its quantiles over all products, by ``p50``, ``p90``, ``p99`` [s].
    """

    late: SummaryEntry | None
    any_late: SummaryEntry
    lateness_s: SummaryEntry | None
    lateness_quantiles_s: dict[str, float]


class LineSummary(Figures):
    """Figures of a cell that makes several products.

    Attributes:
        products: how many.
        start_up: how many of them at the beginning do not count.
        throughput_per_h: products an hour.
        takt_s: time from one completion to the next [s].
        takt_quantiles_s: its quantiles over all products, by ``p50``, ``p90``, ``p99`` [s].
        cycle_time_s: time from the begin of a product to its completion [s].
        cycle_time_quantiles_s: its quantiles over all products [s].
        work_in_progress: products begun and not complete.
        due: lateness; None where nothing is due.
    """

    products: int
    start_up: int
    throughput_per_h: SummaryEntry | None
    takt_s: SummaryEntry | None
    takt_quantiles_s: dict[str, float]
    cycle_time_s: SummaryEntry | None
    cycle_time_quantiles_s: dict[str, float]
    work_in_progress: SummaryEntry | None
    due: DueSummary | None


def product_times(blocks: Path, cell: int) -> ProductTimes | None:
    """Return start and completion times of products in all replications of a cell.

    None where there is only one product, or no replication completed.
    """
    found: ProductTimes | None = cell_part(blocks, cell, "products")
    return found if found is not None and found.product_end_ns.size else None


def product_columns(times: ProductTimes, due_s: Sequence[float] = ()) -> dict[str, Any]:
    """Return columns with one row per product: completion time, probability of lateness."""
    begin = times.product_begin_ns / NANOSECONDS
    end = times.product_end_ns / NANOSECONDS
    count = len(end)
    columns: dict[str, Any] = {
        "product": np.arange(1, count + 1),
        "begin_mean_s": begin.mean(axis=1),
        "end_mean_s": end.mean(axis=1),
        "cycle_mean_s": (end - begin).mean(axis=1),
    }
    for p in (5, 50, 95):
        columns[f"end_p{p}_s"] = np.percentile(end, p, axis=1)
    if len(due_s):
        late = end - np.asarray(due_s)[:, None]
        columns["due_s"] = np.asarray(due_s, dtype=float)
        columns["lateness_mean_s"] = late.mean(axis=1)
        columns["late"] = (late > 0).mean(axis=1)
    return columns


def line_summary(times: ProductTimes, due: Due, confidence: float) -> LineSummary:
    """Return the figures of a cell.

    Args:
        times: of its products.
        due: when they are due, and which do not count.
        confidence: of the intervals.
    """
    due_s, start_up = due
    begin, end = times.product_begin_ns, times.product_end_ns
    found = line_figures(begin, end, due_s, start_up)
    takts = takts_s(end, start_up).ravel()
    cycles = (end - begin)[start_up_of(len(end), start_up) :].ravel() / NANOSECONDS

    def mean(values: Array) -> Interval | None:
        known = values[np.isfinite(values)]
        return mean_interval(known, confidence=confidence) if len(known) else None

    lateness = None
    if len(due_s):
        after = end / NANOSECONDS - np.asarray(due_s)[:, None]
        anyone = int(np.count_nonzero((after > 0).any(axis=0)))
        lateness = DueSummary(
            late=mean(found.late),
            any_late=share_interval(anyone, after.shape[1], confidence=confidence),
            lateness_s=mean(found.lateness_s),
            lateness_quantiles_s=_quantiles(after.ravel()),
        )
    return LineSummary(
        products=len(end),
        start_up=start_up_of(len(end), start_up),
        throughput_per_h=mean(found.per_hour) if len(takts) else None,
        takt_s=mean(found.takt_s) if len(takts) else None,
        takt_quantiles_s=_quantiles(takts),
        cycle_time_s=mean(found.cycle_s),
        cycle_time_quantiles_s=_quantiles(cycles),
        work_in_progress=mean(found.in_progress),
        due=lateness,
    )


def _quantiles(values: Array) -> dict[str, float]:
    if not len(values):
        return {}
    return {
        f"p{100 * q:.0f}": float(v)
        for q, v in zip(_QUANTILES, np.quantile(values, _QUANTILES), strict=True)
    }


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

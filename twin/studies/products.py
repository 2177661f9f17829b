"""Key figures of the products of a production line over the replications of a study: throughput, takt, lateness."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from planning.transforms import Array
from twin.durations.nanoseconds import NANOSECONDS
from twin.studies.replications.block_results import ProductTimes, cell_part
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

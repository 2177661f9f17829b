"""Figures of a line over the replications of a study: throughput, takt, lateness."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from planning.transforms import Array
from twin.durations import NANOSECONDS
from twin.run.throughput import line_figures, start_up_of, takts_s
from twin.study.replications.block_results import ProductTimes, cell_blocks
from twin.study.replications.statistics import mean_interval, share_interval

Due = tuple[tuple[float, ...], int | None]
"""When each product is due [s], and how many at the beginning do not count."""

_QUANTILES = (0.5, 0.9, 0.99)


def product_times(blocks: Path, cell: int) -> ProductTimes | None:
    """Return when products began and were complete in all replications of a cell.

    None where there is only one product, or no replication completed.
    """
    found = [b.products for b in cell_blocks(blocks, cell) if b.products is not None]
    if not found:
        return None
    begin = np.concatenate([item.product_begin_ns for item in found], axis=1)
    end = np.concatenate([item.product_end_ns for item in found], axis=1)
    return ProductTimes(begin, end) if end.shape[1] else None


def line_content(times: ProductTimes, due: Due, confidence: float) -> dict[str, Any]:
    """Return the figures of a cell for ``summary.json``.

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

    def mean(values: Array) -> dict[str, Any] | None:
        known = values[np.isfinite(values)]
        if not len(known):
            return None
        return mean_interval(known, confidence=confidence, antithetic=False).content()

    content: dict[str, Any] = {
        "products": len(end),
        "start_up": start_up_of(len(end), start_up),
        "throughput_per_h": mean(found.per_hour) if len(takts) else None,
        "takt_s": mean(found.takt_s) if len(takts) else None,
        "takt_quantiles_s": _quantiles(takts),
        "cycle_time_s": mean(found.cycle_s),
        "cycle_time_quantiles_s": _quantiles(cycles),
        "work_in_progress": mean(found.in_progress),
        "due": None,
    }
    if len(due_s):
        after = end / NANOSECONDS - np.asarray(due_s)[:, None]
        anyone = int(np.count_nonzero((after > 0).any(axis=0)))
        content["due"] = {
            "late": mean(found.late),
            "any_late": share_interval(
                anyone, after.shape[1], confidence=confidence
            ).content(),
            "lateness_s": mean(found.lateness_s),
            "lateness_quantiles_s": _quantiles(after.ravel()),
        }
    return content


def _quantiles(values: Array) -> dict[str, float]:
    if not len(values):
        return {}
    return {
        f"p{100 * q:.0f}": float(v)
        for q, v in zip(_QUANTILES, np.quantile(values, _QUANTILES), strict=True)
    }

"""Key figures of the products of a production line over the replications of a study: throughput, takt, lateness."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import Field

from planning.transforms import Array
from twin.scenario.sections.kind import StartUp, assembly_kind
from twin.scenario.sections.scenario import Scenario
from twin.studies.replications.block_results import cell_part
from twin.studies.replications.statistics import (
    Figures,
    SummaryEntry,
    mean_interval,
    share_interval,
)
from twin.studies.replications.workload import Workload
from twin.throughput.states import STATES, WorkerTimes, worker_chains
from twin.throughput.throughput import (
    OF_VARIANT,
    RATES,
    ProductTimes,
    due_of_places,
    line_figures,
    mean_known,
    products_of_variants,
    seconds,
    settled_start_up,
    takts_s,
)

_QUANTILES = (0.5, 0.9, 0.99)
_SHARES = frozenset({*STATES, "availability", "service_level"})
"""Figures between 0 and 1."""


class Orders(NamedTuple):
    """Products that are ordered.

    Attributes:
        due_s: when each is due [s]; empty where none is.
        start_up: number at the beginning that does not count, see ``settled_start_up``.
        variants: the variant of each; empty where all are the same.
    """

    due_s: tuple[float, ...] = ()
    start_up: StartUp = None
    variants: tuple[str, ...] = ()


Entries = dict[str, dict[str, SummaryEntry | None]]
"""Figures by their names, of robots and machines or of variants."""


class DueSummary(Figures):
    """Lateness of products, over replications.

    Attributes:
        late: share of complete products that are complete after they are due.
        service_level: share of the ordered products that are complete when they are due.
        any_late: share of replications in which one is.
        lateness_s: mean time by which they are [s].
        lateness_quantiles_s: its quantiles over all products, by ``p50``, ``p90``, ``p99`` [s].
    """

    late: SummaryEntry | None
    service_level: SummaryEntry | None
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
        first_pass_yield: share of the products made that are complete without rework, with replanning.
        workers: of robots and machines that work at parts, see ``WorkerTimes.shares_and_factors``.
        variants: of each variant, see ``LineFigures``; empty where all products are the same.
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
    first_pass_yield: SummaryEntry | None = None
    workers: Entries = Field(default_factory=dict)
    variants: Entries = Field(default_factory=dict)


def orders_of(scenario: Scenario) -> Orders:
    """Return what a scenario orders."""
    kind = assembly_kind(scenario.assembly)
    return Orders(*kind.due(), kind.variants())


def study_product_times(blocks: Path, cell: int) -> ProductTimes | None:
    """Return start and completion times of products in all replications of a cell.

    None where there is only one product, or no replication came to its end.
    """
    found: ProductTimes | None = cell_part(blocks, cell, "products")
    return found if found is not None and found.product_end_ns.size else None


def product_columns(times: ProductTimes, orders: Orders) -> dict[str, Any]:
    """Return columns with one row per product: completion time, probability of lateness, variant."""
    begin, end = seconds(times.product_begin_ns), seconds(times.product_end_ns)
    count, due_s = len(end), due_of_places(orders.due_s, len(end))
    columns: dict[str, Any] = {
        "product": np.arange(1, count + 1),
        "begin_mean_s": mean_known(begin, axis=1),
        "end_mean_s": mean_known(end, axis=1),
        "cycle_mean_s": mean_known(end - begin, axis=1),
    }
    if orders.variants:
        columns["variant"] = list(orders.variants)[:count]
    for p in (5, 50, 95):
        known = (own[np.isfinite(own)] for own in end)
        rows = [np.percentile(own, p) if len(own) else np.nan for own in known]
        columns[f"end_p{p}_s"] = np.array(rows)
    if orders.due_s:
        late = end - due_s[:, None]
        columns["due_s"] = due_s
        columns["lateness_mean_s"] = mean_known(late, axis=1)
        columns["late"] = mean_known(np.where(np.isfinite(late), late > 0, np.nan), 1)
    return columns


def line_summary(
    blocks: Path, cell: int, load: Workload, orders: Orders, confidence: float
) -> LineSummary | None:
    """Return the figures of a cell; None where ``study_product_times`` has none.

    Args:
        blocks: folder of the blocks.
        cell: index of the cell.
        load: its workload.
        orders: what is ordered.
        confidence: of the intervals.
    """
    times = study_product_times(blocks, cell)
    if times is None:
        return None
    start_up = settled_start_up(times, orders.start_up)
    begin, end = seconds(times.product_begin_ns), seconds(times.product_end_ns)
    found = line_figures(times, orders.due_s, start_up)
    workers: WorkerTimes = cell_part(blocks, cell, "workers")
    spent = workers.shares_and_factors(found.good)

    def mean(values: Array, name: str = "") -> SummaryEntry | None:
        known = values[np.isfinite(values)]
        if not len(known):
            return None
        entry = mean_interval(known, confidence=confidence)
        if name not in _SHARES:
            return entry
        return replace(entry, low=max(entry.low, 0.0), high=min(entry.high, 1.0))

    def passing(own: Any = ...) -> SummaryEntry | None:
        # Without replanning, replications with failures for good do not complete.
        made, passed = times.products_made[own], times.products_passed[own]
        if load.operated is None:
            return None
        return share_interval(int(passed.sum()), int(made.sum()), confidence=confidence)

    lateness = None
    if orders.due_s:
        after = end - due_of_places(orders.due_s, len(end))[:, None]
        anyone = int(np.count_nonzero((after > 0).any(axis=0)))
        lateness = DueSummary(
            late=mean(found.late),
            service_level=mean(found.service_level, "service_level"),
            any_late=share_interval(anyone, after.shape[1], confidence=confidence),
            lateness_s=mean(found.lateness_s),
            lateness_quantiles_s=_quantiles(after.ravel()),
        )
    variants: Entries = {}
    for name, own in products_of_variants(orders.variants, len(end)).items():
        part = vars(line_figures(times, orders.due_s, start_up, own))
        entries = {key: mean(part[key], key) for key in OF_VARIANT}
        variants[name] = entries | {"first_pass_yield": passing(own)}
    return LineSummary(
        products=len(end),
        start_up=start_up,
        **{key: mean(getattr(found, key)) for key in RATES},
        takt_quantiles_s=_quantiles(takts_s(times.product_end_ns, start_up).ravel()),
        cycle_time_quantiles_s=_quantiles((end - begin)[start_up:].ravel()),
        due=lateness,
        first_pass_yield=passing(),
        workers={
            load.tpg.chains[k].robot: {
                name: mean(own[place], name)
                for name, own in spent.items()
                if name not in STATES or own[place].any()
            }
            for place, k in enumerate(worker_chains(load.tpg))
        },
        variants=variants,
    )


def _quantiles(values: Array) -> dict[str, float]:
    values = values[np.isfinite(values)]
    if not len(values):
        return {}
    return {
        f"p{100 * q:.0f}": float(v)
        for q, v in zip(_QUANTILES, np.quantile(values, _QUANTILES), strict=True)
    }

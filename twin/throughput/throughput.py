"""Performance of a production line: start and completion of products, takt, throughput, work in progress."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from planning.tasks.task import changed_tools, is_product_task, is_work
from planning.transforms import Array, Indices
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations.nanoseconds import NANOSECONDS, Nanoseconds
from twin.runs.execution_record import ExecutionRecord

_START_UP = 0.1
"""Default fraction of products in the start-up phase, which throughput and takt exclude."""


@dataclass(frozen=True)
class ProductNodes:
    """Nodes that start and complete each product, numbered through all chains.

    A product begins when a robot takes its first part or begins its first process, and is complete
    when its last step is.

    Attributes:
        first: first node of a robot for a product, product after product.
        first_of: index of each product's first entry in ``first``, shape (products,).
        last, last_of: the same for last nodes of steps.
        products: numbers of the products, from 1, shape (products,).
    """

    first: Indices
    first_of: Indices
    last: Indices
    last_of: Indices
    products: Indices

    def begin(self, start_ns: Nanoseconds) -> Nanoseconds:
        """Return the start times of products, shape (products, ...) [ns].

        Args:
            start_ns: start of every node, shape (nodes, ...) [ns].
        """
        return np.minimum.reduceat(start_ns[self.first], self.first_of, axis=0)

    def end(self, end_ns: Nanoseconds) -> Nanoseconds:
        """Return the completion times of products, shape (products, ...) [ns].

        Args:
            end_ns: end of every node, shape (nodes, ...) [ns].
        """
        return np.maximum.reduceat(end_ns[self.last], self.last_of, axis=0)


def product_nodes(tpg: TemporalPlanGraph) -> ProductNodes | None:
    """Return the nodes of products of a graph, contracted or not; None for fewer than two products."""
    if not np.any(tpg.products):
        return None
    tools = changed_tools(tpg.tasks)
    works = np.array([is_work(task, tools) for task in tpg.tasks])
    steps = np.array([is_product_task(task, tools) for task in tpg.tasks])
    works, steps = works & (tpg.products > 0), steps & (tpg.products > 0)
    first: list[tuple[int, int]] = []
    last: list[tuple[int, int]] = []
    offset = 0
    for chain in tpg.chains:
        product = tpg.products[chain.task]
        for which, index, found in ((works, 0, first), (steps, -1, last)):
            nodes = np.flatnonzero(which[chain.task])
            cuts = np.flatnonzero(np.diff(product[nodes])) + 1
            for own in np.split(nodes, cuts):
                if len(own):
                    node = int(own[index])
                    found.append((int(product[node]), offset + node))
        offset += len(chain)
    columns: list[Indices] = []
    for found in (first, last):
        rows = np.array(sorted(found), dtype=np.int64).reshape(-1, 2)
        columns += [rows[:, 1], np.flatnonzero(np.diff(rows[:, 0], prepend=0))]
    columns.append(np.unique(rows[:, 0]))
    return ProductNodes(*columns)


def start_up_of(products: int, asked: int | None = None) -> int:
    """Return the number of products of the start-up, so that at least two others are left."""
    wanted = int(np.ceil(_START_UP * products)) if asked is None else asked
    return max(0, min(wanted, products - 2))


@dataclass(frozen=True)
class LineFigures:
    """Figures of a line in some replications, each of shape (replications,).

    Attributes:
        takt_s: mean time from one completion to the next, after the start-up [s].
        cycle_s: mean time from the begin of a product to its completion, after it [s].
        in_progress: mean number of products begun and not complete, after it.
        late: share of products that are complete after they are due, NaN where they are not due.
        lateness_s: mean time by which products are complete after they are due, negative where
            they are early [s].
    """

    takt_s: Array
    cycle_s: Array
    in_progress: Array
    late: Array
    lateness_s: Array

    @property
    def per_hour(self) -> Array:
        """Products an hour."""
        zero = np.zeros_like(self.takt_s)
        return np.divide(3600.0, self.takt_s, out=zero, where=self.takt_s > 0)


def line_figures(
    begin_ns: Nanoseconds,
    end_ns: Nanoseconds,
    due_s: Sequence[float] = (),
    start_up: int | None = None,
) -> LineFigures:
    """Return the figures of a line.

    Args:
        begin_ns, end_ns: of every product, shape (products, replications) [ns].
        due_s: when each product is due [s].
        start_up: products at the beginning that do not count for takt and work in progress.
    """
    count, replications = end_ns.shape
    begin, end = begin_ns / NANOSECONDS, end_ns / NANOSECONDS
    skipped = start_up_of(count, start_up)
    done = np.sort(end, axis=0)
    since, until = done[skipped], done[-1]
    span = until - since
    overlap = np.minimum(end, until) - np.maximum(begin, since)
    inside = np.maximum(overlap, 0.0).sum(axis=0)
    unknown = np.full(replications, np.nan)
    late, lateness = unknown, unknown
    if len(due_s):
        after = end - np.asarray(due_s)[:, None]
        late, lateness = (after > 0.0).mean(axis=0), after.mean(axis=0)
    takt = span / max(count - 1 - skipped, 1) if count > 1 else unknown
    return LineFigures(
        takt,
        (end - begin)[skipped:].mean(axis=0),
        np.divide(inside, span, out=np.full(replications, np.nan), where=span > 0),
        late,
        lateness,
    )


def takts_s(end_ns: Nanoseconds, start_up: int | None = None) -> Array:
    """Return the times from one completion to the next, after the start-up [s].

    Args:
        end_ns: completion of every product, shape (products, replications) [ns].
        start_up: products at the beginning that do not count.

    Returns:
        Shape (takts, replications).
    """
    done = np.sort(end_ns, axis=0)[start_up_of(len(end_ns), start_up) :]
    return np.diff(done, axis=0) / NANOSECONDS


def line_summary(
    tpg: TemporalPlanGraph,
    run: ExecutionRecord,
    due_s: Sequence[float] = (),
    start_up: int | None = None,
) -> dict[str, Any] | None:
    """Return the line figures of a run's summary; None for one product or an unfinished run.

    Args:
        tpg: the executed plan; tasks for scrapped products belong to no product.
        run: how.
        due_s: when each product is due, scrapped or not [s]. One that is made in place of another is due when that
            was, and one more that is ordered with the last one.
        start_up: products at the beginning that do not count for throughput and takt.
    """
    nodes = product_nodes(tpg)
    if nodes is None or any((own < 0).any() for own in run.end_ns):
        return None
    if len(due_s):
        due_s = _due_of(nodes.products.tolist(), due_s)
    begin = nodes.begin(np.concatenate(run.start_ns))[:, None]
    end = nodes.end(np.concatenate(run.end_ns))[:, None]
    found = line_figures(begin, end, due_s, start_up)
    takts = takts_s(end, start_up)
    several = len(takts) > 0
    out: dict[str, Any] = {
        "products": len(end),
        "start_up": start_up_of(len(end), start_up),
        "throughput_per_h": float(found.per_hour[0]) if several else None,
        "takt_s": {
            "mean": float(found.takt_s[0]),
            "least": float(takts.min()),
            "greatest": float(takts.max()),
        }
        if several
        else None,
        "cycle_time_s": {
            "mean": float(found.cycle_s[0]),
            "greatest": float((end - begin).max()) / NANOSECONDS,
        },
        "work_in_progress": float(found.in_progress[0]) if several else None,
        "first_complete_s": float(end.min()) / NANOSECONDS,
        "due": None,
    }
    if len(due_s):
        after = end[:, 0] / NANOSECONDS - np.asarray(due_s)
        out["due"] = {
            "late": int(np.count_nonzero(after > 0)),
            "mean_lateness_s": float(after.mean()),
            "greatest_lateness_s": float(after.max()),
        }
    return out


def _due_of(products: Sequence[int], due_s: Sequence[float]) -> list[float]:
    """Return the due times of complete products [s]; see ``line_summary``."""
    scrapped = sorted(set(range(1, len(due_s) + 1)) - set(products))
    left = iter([due_s[k - 1] for k in scrapped])
    return [
        due_s[k - 1] if k <= len(due_s) else next(left, due_s[-1]) for k in products
    ]

"""Performance of a production line: takt, throughput, work in progress, lateness and yield, of all products and by variant."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from planning.tasks.task import TaskKind, changed_tools, is_product_task, is_work
from planning.transforms import Array, Indices
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations.nanoseconds import NANOSECONDS, Nanoseconds
from twin.host.atomic_files import finite_or_none
from twin.runs.execution_record import ExecutionRecord
from twin.scenario.sections.kind import StartUp
from twin.throughput.states import ratio, run_worker_times, worker_chains

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


@dataclass(frozen=True)
class ProductTimes:
    """Products of replications, a row for each place of the order, shape (places, replications) each.

    A product that is made in place of one that was not completed has its place.

    Attributes:
        product_begin_ns, product_end_ns: begin and completion, -1 where none was completed [ns].
        products_made: products made for the place, complete or scrapped.
        products_passed: those of them that are complete and had no failure for good at a step.
    """

    product_begin_ns: Nanoseconds
    product_end_ns: Nanoseconds
    products_made: Indices
    products_passed: Indices


def product_times(
    tpg: TemporalPlanGraph,
    start_ns: Nanoseconds,
    end_ns: Nanoseconds,
    ordered: int = 0,
    scrapped: Collection[int] = (),
) -> ProductTimes | None:
    """Return the products of replications of a plan; None for fewer than two.

    Args:
        tpg: the executed plan, contracted or not; tasks for incomplete products belong to no product.
        start_ns, end_ns: of every node through all chains, shape (nodes, replications) [ns].
        ordered: number of products of the order, by default the greatest number of a product; further
            ones have places after those.
        scrapped: numbers of the products that were begun and are not complete.
    """
    nodes = product_nodes(tpg)
    if nodes is None:
        return None
    complete = set(nodes.products.tolist())
    begun = sorted(complete.union(scrapped))
    ordered = ordered or begun[-1]
    missing = [k for k in range(ordered) if k + 1 not in complete]
    place, rows = dict[int, int](), ordered
    for number in begun:
        row = number - 1 if number <= ordered else missing[0] if missing else rows
        place[number] = row
        if number > ordered and number in complete:
            missing, rows = missing[1:], max(rows, row + 1)
    rows = max(rows, 1 + max(place.values()))
    tasks = (task.index for task in tpg.tasks if task.kind == TaskKind.FAILED)
    failed = {int(tpg.products[index]) for index in tasks}
    begin, end = (np.full((rows, end_ns.shape[1]), -1, np.int64) for _ in range(2))
    made, passed = np.zeros_like(begin), np.zeros_like(begin)
    for number, row in place.items():
        made[row] += 1
        passed[row] += number in complete and number not in failed
    own = [place[number] for number in nodes.products.tolist()]
    begin[own], end[own] = nodes.begin(start_ns), nodes.end(end_ns)
    return ProductTimes(begin, end, made, passed)


def run_product_times(
    tpg: TemporalPlanGraph,
    run: ExecutionRecord,
    ordered: int = 0,
    scrapped: Collection[int] = (),
) -> ProductTimes | None:
    """Return the products of a run, see ``product_times``; None also for an unfinished run."""
    if any((own < 0).any() for own in run.end_ns):
        return None
    starts, ends = (np.concatenate(own)[:, None] for own in (run.start_ns, run.end_ns))
    return product_times(tpg, starts, ends, ordered, scrapped)


def start_up_of(products: int, asked: int | None = None) -> int:
    """Return the number of products of the start-up, so that at least two others are left."""
    wanted = int(np.ceil(_START_UP * products)) if asked is None else asked
    return max(0, min(wanted, products - 2))


def settled_start_up(times: ProductTimes, asked: StartUp = None) -> int:
    """Return the number of products of the start-up.

    Args:
        times: of the products.
        asked: a number; None for a tenth; ``auto`` for what MSER-5 leaves out of the times between
            completions or of the cycle times, whichever is more. Of several replications their means count.
    """
    begin, end = times.product_begin_ns, times.product_end_ns
    if asked == "auto":
        series = takts_s(end, 0), seconds(end) - seconds(begin)
        asked = max(mser(mean_known(own, axis=1)) for own in series)
    return start_up_of(len(end), asked)


def mser(values: Array, batch: int = 5) -> int:
    """Return how many first values are left out for the least standard error of the mean of the rest (MSER-5).

    At most half of the values are (White, 1997).

    Args:
        values: in order, shape (n,); those that are not known do not count.
        batch: values of a batch, whose means are taken; what is left over at the end does not count.
    """
    known = values[np.isfinite(values)]
    means = known[: len(known) // batch * batch].reshape(-1, batch).mean(axis=1)
    if len(means) < 2:
        return 0
    rests = [means[k:] for k in range(len(means) // 2 + 1)]
    return batch * int(np.argmin([rest.var() / len(rest) for rest in rests]))


@dataclass(frozen=True)
class LineFigures:
    """Figures of a line in some replications, each of shape (replications,); NaN for what is not known.

    Attributes:
        throughput_per_h: products an hour, after the start-up.
        takt_s: mean time from one completion to the next, after it [s].
        cycle_time_s: mean time from the begin of a product to its completion, after it [s].
        work_in_progress: mean number of products begun and not complete, after it.
        service_level: share of the ordered products that are complete when they are due.
        lateness_s: mean time by which products are complete after they are due, negative where
            they are early [s].
        first_pass_yield: share of the products made that are complete without rework.
        late: share of complete products that are complete after they are due.
        good: share of the products made that are complete.
    """

    throughput_per_h: Array
    takt_s: Array
    cycle_time_s: Array
    work_in_progress: Array
    service_level: Array
    lateness_s: Array
    first_pass_yield: Array
    late: Array
    good: Array


RATES = ("throughput_per_h", "takt_s", "cycle_time_s", "work_in_progress")
OF_VARIANT = (*RATES, "service_level", "lateness_s", "first_pass_yield")
"""Figures of the flow of products, and all figures of a variant."""


def line_figures(
    times: ProductTimes,
    due_s: Sequence[float] = (),
    start_up: int = 0,
    own: npt.NDArray[np.bool_] | None = None,
) -> LineFigures:
    """Return the figures of a line, or of some of its products.

    Rates and work in progress are of the time from the last completion of the start-up to the last one
    of all products: those of the variants add up to those of the line.

    Args:
        times: of all products.
        due_s: when each product is due [s].
        start_up: products at the beginning that do not count for takt and work in progress.
        own: True for the products of interest, shape (places,); all by default.
    """
    begin, end = seconds(times.product_begin_ns), seconds(times.product_end_ns)
    own = np.ones(len(end), np.bool_) if own is None else own
    known, after = np.isfinite(end), end - due_of_places(due_s, len(end))[:, None]
    order = np.argsort(end, axis=0, kind="stable")  # unknown times come last
    rank = np.argsort(order, axis=0, kind="stable")
    since = np.take_along_axis(end, order[start_up : start_up + 1], axis=0)[0]
    until = np.fmax.reduce(end, axis=0)
    overlap = np.minimum(end, until) - np.maximum(begin, since)
    inside = np.nansum(np.maximum(overlap, 0.0)[own], axis=0)
    takt = ratio(until - since, ((rank > start_up) & known)[own].sum(axis=0))
    made = times.products_made[own].sum(axis=0)
    late = np.where(np.isfinite(after), after > 0.0, np.nan)
    in_time = np.where(len(due_s) > 0, after <= 0.0, np.nan)
    return LineFigures(
        np.nan_to_num(ratio(np.full_like(takt, 3600.0), takt)),
        takt,
        mean_known((end - begin)[start_up:][own[start_up:]]),
        ratio(inside, until - since),
        in_time[own].mean(axis=0),
        mean_known(after[own]),
        ratio(times.products_passed[own].sum(axis=0), made),
        mean_known(late[own]),
        ratio(known[own].sum(axis=0), made),
    )


def seconds(times_ns: Nanoseconds) -> Array:
    """Return times in seconds, NaN for what did not happen."""
    return np.where(times_ns < 0, np.nan, times_ns / NANOSECONDS)


def mean_known(values: Array, axis: int = 0) -> Array:
    """Return the means of the values that are known, NaN where none is."""
    return ratio(np.nansum(values, axis=axis), np.isfinite(values).sum(axis=axis))


def due_of_places(due_s: Sequence[float], places: int) -> Array:
    """Return when the product of each place is due, NaN without due times, shape (places,) [s]."""
    known = np.asarray(due_s if len(due_s) else [np.nan], dtype=float)
    return known[np.minimum(np.arange(places), len(known) - 1)]


def products_of_variants(
    variants: Sequence[str], places: int
) -> dict[str, npt.NDArray[np.bool_]]:
    """Return which places of the order are of each variant, in the order of their first products."""
    last = len(variants) - 1
    known = np.array(
        [variants[min(k, last)] for k in range(places)] if variants else ()
    )
    return {name: known == name for name in dict.fromkeys(variants)}


def takts_s(end_ns: Nanoseconds, start_up: int) -> Array:
    """Return the times from one completion to the next, after the start-up [s].

    Args:
        end_ns: completion of every product, shape (products, replications) [ns].
        start_up: products at the beginning that do not count.

    Returns:
        Shape (takts, replications); NaN at the end where products are not complete.
    """
    return np.diff(np.sort(seconds(end_ns), axis=0)[start_up:], axis=0)


def line_summary(
    tpg: TemporalPlanGraph,
    run: ExecutionRecord,
    due_s: Sequence[float] = (),
    start_up: StartUp = None,
    variants: Sequence[str] = (),
    scrapped: Collection[int] = (),
) -> dict[str, Any] | None:
    """Return the line figures of a run's summary; None for one product or an unfinished run.

    Args:
        tpg: the executed plan; tasks for scrapped products belong to no product.
        run: how.
        due_s: when each product is due, scrapped or not [s]. One that is made in place of another is due when that
            was, and one more that is ordered with the last one.
        start_up: products at the beginning that do not count for throughput and takt, see ``settled_start_up``.
        variants: the variant of each product, likewise; empty where there is only one.
        scrapped: numbers of the products that were begun and are not complete.
    """
    times = run_product_times(tpg, run, len(due_s) or len(variants), scrapped)
    if times is None:
        return None
    begin, end = seconds(times.product_begin_ns), seconds(times.product_end_ns)
    skipped = settled_start_up(times, start_up)
    found = line_figures(times, due_s, skipped)
    takts = takts_s(times.product_end_ns, skipped)
    several = bool(np.isfinite(takts).any())
    spent = run_worker_times(tpg, run).shares_and_factors(found.good)
    names = [tpg.chains[k].robot for k in worker_chains(tpg)]
    out: dict[str, Any] = {
        "products": int(np.isfinite(end).sum()),
        "start_up": skipped,
        "throughput_per_h": float(found.throughput_per_h[0]) if several else None,
        "takt_s": {
            "mean": float(found.takt_s[0]),
            "least": float(np.nanmin(takts)),
            "greatest": float(np.nanmax(takts)),
        }
        if several
        else None,
        "cycle_time_s": {
            "mean": float(found.cycle_time_s[0]),
            "greatest": float(np.nanmax(end - begin)),
        },
        "work_in_progress": float(found.work_in_progress[0]) if several else None,
        "first_complete_s": float(np.nanmin(end)),
        "first_pass_yield": float(found.first_pass_yield[0]),
        "due": None,
        "workers": {
            name: {key: finite_or_none(own[k, 0]) for key, own in spent.items()}
            for k, name in enumerate(names)
        },
        "variants": {},
    }
    for name, own in products_of_variants(variants, len(end)).items():
        part = vars(line_figures(times, due_s, skipped, own))
        entry = {key: finite_or_none(part[key][0]) for key in OF_VARIANT}
        out["variants"][name] = {"products": int(np.isfinite(end[own]).sum()), **entry}
    if len(due_s):
        after = end[:, 0] - due_of_places(due_s, len(end))
        out["due"] = {
            "late": int(np.count_nonzero(after > 0)),
            "service_level": float(found.service_level[0]),
            "mean_lateness_s": float(found.lateness_s[0]),
            "greatest_lateness_s": float(np.nanmax(after)),
        }
    return out

"""Charts of a whole study: makespans and waits under all policies and variants of the inputs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from planning.transforms import Array
from scheduling.graph.temporal_plan_graph import MOTION_CONFLICT, TASK_DEPENDENCY
from twin.drawing.pictures import INK, bar_chart, legend_below, one_chart
from twin.engine.execution_model import OTHER
from twin.scenario.variations import Variant, is_of_execution
from twin.studies.folder import plain_value
from twin.studies.products import Orders
from twin.studies.replications.block_results import WAIT_COLUMNS
from twin.studies.replications.statistics import Interval
from twin.studies.summary import StudySummary, cell_label
from twin.throughput.throughput import (
    ProductTimes,
    seconds,
    settled_start_up,
    takts_s,
)

COLOURS = (
    *("#1f5f9e", "#d97b29", "#2f7f66", "#9c4a8f", "#7a8592", "#b8433a"),
    "#8c6d31",
)
CAUSE_STYLE = {
    TASK_DEPENDENCY: ("#6fa8dc", "for another robot's task"),
    MOTION_CONFLICT: ("#d97b29", "for the way to be free"),
    OTHER: ("#b9c0c8", "for a message, the clock or a turn"),
}
_BEST, _OTHER, _ALIKE = "#2f7f66", "#1f5f9e", "#7fa6cf"
_DASHES = ("-", "--", ":", "-.")


def draw_ecdf(
    summary: StudySummary, samples: Sequence[Array], policies: Sequence[str]
) -> Figure:
    """Draw the share of replications that are over by a time, for every cell.

    Args:
        summary: of the study.
        samples: makespans of each cell, NaN where it did not complete [s].
        policies: in the order of their colours.
    """
    figure, axes = one_chart(4.6)
    for k, (cell, sample) in enumerate(zip(summary.cells, samples, strict=True)):
        ordered = np.sort(sample[np.isfinite(sample)])
        if len(ordered) == 0:
            continue
        variant = k // len(policies)
        lines = len(samples) // len(policies)
        axes.step(
            np.concatenate([ordered[:1], ordered]),
            np.arange(len(ordered) + 1) / len(sample) * 100,
            where="post",
            linewidth=1.8,
            label=cell.label,
            **_line_style(policies.index(cell.policy), variant, lines),
        )
    if summary.deadline_s is not None:
        deadline = f"deadline {summary.deadline_s:g} s"
        axes.axvline(summary.deadline_s, color=INK, linewidth=1.0, label=deadline)
    axes.set_xlabel("makespan [s]")
    axes.set_ylabel("replications that are over [%]")
    axes.set_ylim(0, 100.5)
    legend_below(axes)
    return figure


def draw_waits(summary: StudySummary) -> Figure:
    """Draw waiting times of robots by cause, one bar per cell."""
    cells = [cell for cell in summary.cells if cell.wait_s]
    figure, axes = bar_chart([cell.label for cell in cells], 0.42)
    left = np.zeros(len(cells))
    for cause, (colour, label) in CAUSE_STYLE.items():
        values = np.array([cell.wait_s[WAIT_COLUMNS[cause]] for cell in cells])
        axes.barh(range(len(cells)), values, left=left, color=colour, label=label)
        left = left + values
    for k, total in enumerate(left.tolist()):
        axes.annotate(f" {total:.0f} s", (total, k), va="center", fontsize=9, color=INK)
    axes.set_xlim(0, 1.1 * max([*left.tolist(), 1e-9]))
    axes.set_xlabel("mean wait of all robots together [s]")
    legend_below(axes)
    return figure


def draw_response(summary: StudySummary, key: str, policies: Sequence[str]) -> Figure:
    """Draw the mean makespan, with its interval, over a varied input.

    Where other inputs are varied too, each of their combinations is a line.
    """
    figure, axes = one_chart(4.2)
    lines: dict[tuple[str, str], list[tuple[Any, Interval]]] = {}
    for cell in summary.cells:
        if cell.makespan_s is None:
            continue
        others = {k: v for k, v in cell.variant.items() if k != key}
        line = (cell.policy, cell_label(cell.policy, others))
        entry = (plain_value(cell.variant[key]), cell.makespan_s)
        lines.setdefault(line, []).append(entry)
    values = list(
        dict.fromkeys(plain_value(cell.variant[key]) for cell in summary.cells)
    )
    numeric = all(isinstance(value, int | float) for value in values)
    lines_each = max([1, *Counter(policy for policy, _ in lines).values()])
    seen: Counter[str] = Counter()
    for (policy, label), entries in lines.items():
        place = [value if numeric else values.index(value) for value, _ in entries]
        mean = np.array([found.estimate for _, found in entries])
        below = mean - [found.low for _, found in entries]
        above = [found.high for _, found in entries] - mean
        axes.errorbar(
            place,
            mean,
            # Where nothing is known of the spread there is no bar.
            yerr=np.where(np.isfinite([below, above]), [below, above], 0.0),
            marker="o",
            markersize=4,
            capsize=3,
            label=label,
            **_line_style(list(policies).index(policy), seen[policy], lines_each),
        )
        seen[policy] += 1
    if not numeric:
        texts = [fill(str(value), 90 // len(values)) for value in values]
        axes.set_xticks(range(len(values)), texts)
    axes.set_xlabel(key)
    axes.set_ylabel("mean makespan [s]")
    axes.set_ylim(bottom=0)
    legend_below(axes)
    return figure


def draw_ranking(summary: StudySummary, policy: str) -> Figure:
    """Draw the mean makespans of the layouts under a policy, the fastest on top.

    The line at each is the interval of its mean alone; pale ones do not differ significantly from the
    fastest. Other varied inputs form groups.
    """
    rows = summary.ranked(policy)
    names = [", ".join(f"{k} = {v}" for k, v in _ordered(r.variant)) for r in rows]
    figure, axes = bar_chart(names, 0.34)
    for place, row in enumerate(rows):
        mean = summary.cells[row.cell].makespan_s
        assert mean is not None
        low, high = (
            bound if np.isfinite(bound) else row.mean_s
            for bound in (mean.low, mean.high)
        )
        colour = (
            _BEST if row.rank == 1 else _OTHER if row.significantly_slower else _ALIKE
        )
        axes.barh(place, row.mean_s, color=colour, height=0.62)
        axes.plot([low, high], [place, place], color=INK, linewidth=1.4)
        axes.annotate(
            f"  {row.mean_s:.1f} s", (high, place), va="center", fontsize=9, color=INK
        )
    axes.set_xlim(0, 1.12 * max(row.mean_s for row in rows))
    axes.set_xlabel(f"mean makespan, {policy} [s]")
    return figure


def _ordered(variant: Variant) -> list[tuple[str, object]]:
    """Return varied inputs, those of the layout first."""
    return sorted(variant.items(), key=lambda item: is_of_execution(item[0]))


def draw_line(times: ProductTimes, orders: Orders) -> Figure:
    """Draw completion times of products, due times, and the takt."""
    figure, axes = one_chart(4.2)
    end = seconds(times.product_end_ns)
    number = np.arange(1, len(end) + 1)
    takt = takts_s(times.product_end_ns, settled_start_up(times, orders.start_up))
    pace = float(np.nanmean(takt)) if np.isfinite(takt).any() else 0.0
    # The mean pace is subtracted, so that deviations are visible.
    level = (number - 1) * pace
    low, middle, high = np.nanquantile(end, (0.05, 0.5, 0.95), axis=1)
    axes.fill_between(
        number, low - level, high - level, color="#c6d8ea", label="P5 to P95"
    )
    axes.plot(number, middle - level, color="#1f5f9e", lw=1.8, label="complete, median")
    if orders.due_s:
        axes.plot(
            number,
            np.asarray(orders.due_s) - level,
            color="#b8433a",
            lw=1.4,
            ls="--",
            label="due",
        )
    axes.set_xlabel("product", color=INK)
    axes.set_ylabel(f"time [s], less {pace:.2f} s a product", color=INK)
    axes.legend(frameon=False, labelcolor=INK, fontsize=9)
    return figure


def _line_style(policy: int, line: int, lines: int) -> dict[str, Any]:
    """Return colour and dashes of a policy's line, paler for further ones."""
    pale = 0.6 * line / max(lines - 1, 1)
    own = to_rgb(COLOURS[policy % len(COLOURS)])
    return {
        "color": tuple(pale + (1.0 - pale) * value for value in own),
        "linestyle": _DASHES[line % len(_DASHES)],
    }

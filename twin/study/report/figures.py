"""Pictures of a whole study: makespans and waits of all its cells."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from textwrap import fill
from typing import Any

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from planning.transforms import Array
from scheduling.graph.temporal_plan_graph import MOTION_CONFLICT, TASK_DEPENDENCY
from twin.engine.bulk.policy_graph import OTHER
from twin.host.pictures import INK
from twin.study.replications.block_results import WAIT_COLUMNS
from twin.study.report.layout import bar_chart, legend_below, one_chart
from twin.study.summary import cell_label

COLOURS = (
    *("#1f5f9e", "#d97b29", "#2f7f66", "#9c4a8f", "#7a8592", "#b8433a"),
    "#8c6d31",
)
CAUSE_STYLE = {
    TASK_DEPENDENCY: ("#6fa8dc", "for another robot's task"),
    MOTION_CONFLICT: ("#d97b29", "for the way to be free"),
    OTHER: ("#b9c0c8", "for a message, the clock or a turn"),
}
_DASHES = ("-", "--", ":", "-.")


def draw_ecdf(
    summary: Mapping[str, Any], samples: Sequence[Array], policies: Sequence[str]
) -> Figure:
    """Draw the share of replications that are over by a time, for every cell.

    Args:
        summary: the content of ``summary.json``.
        samples: makespans of each cell, NaN where it did not complete [s].
        policies: in the order of their colours.
    """
    figure, axes = one_chart(4.6)
    for k, (cell, sample) in enumerate(zip(summary["cells"], samples, strict=True)):
        ordered = np.sort(sample[np.isfinite(sample)])
        if len(ordered) == 0:
            continue
        policy = policies.index(cell["policy"])
        variant = k // len(policies)
        axes.step(
            np.concatenate([ordered[:1], ordered]),
            np.arange(len(ordered) + 1) / len(sample) * 100,
            where="post",
            color=_shade(policy, variant, len(samples) // len(policies)),
            linestyle=_DASHES[variant % len(_DASHES)],
            linewidth=1.8,
            label=cell_label(cell),
        )
    if summary["deadline_s"] is not None:
        deadline = f"deadline {summary['deadline_s']:g} s"
        axes.axvline(summary["deadline_s"], color=INK, linewidth=1.0, label=deadline)
    axes.set_xlabel("makespan [s]")
    axes.set_ylabel("replications that are over [%]")
    axes.set_ylim(0, 100.5)
    legend_below(axes)
    return figure


def draw_waits(summary: Mapping[str, Any]) -> Figure:
    """Draw what the robots waited for, by cause, a bar a cell."""
    cells = [cell for cell in summary["cells"] if "wait_s" in cell]
    figure, axes = bar_chart([cell_label(cell) for cell in cells], 0.42)
    left = np.zeros(len(cells))
    for cause, (colour, label) in CAUSE_STYLE.items():
        values = np.array([cell["wait_s"][WAIT_COLUMNS[cause]] for cell in cells])
        axes.barh(range(len(cells)), values, left=left, color=colour, label=label)
        left = left + values
    for k, total in enumerate(left.tolist()):
        axes.annotate(f" {total:.0f} s", (total, k), va="center", fontsize=9, color=INK)
    axes.set_xlim(0, 1.1 * max([*left.tolist(), 1e-9]))
    axes.set_xlabel("mean wait of all robots together [s]")
    legend_below(axes)
    return figure


def draw_response(
    summary: Mapping[str, Any], key: str, policies: Sequence[str]
) -> Figure:
    """Draw the mean makespan, with its interval, over an input that is varied.

    Where other inputs are varied too, each of their combinations is a line.
    """
    figure, axes = one_chart(4.2)
    lines: dict[tuple[str, str], list[tuple[Any, Mapping[str, Any]]]] = {}
    for cell in summary["cells"]:
        if "makespan_s" not in cell:
            continue
        others = {k: v for k, v in cell["variant"].items() if k != key}
        label = cell_label({"policy": cell["policy"], "variant": others})
        entry = (_plain(cell["variant"][key]), cell["makespan_s"])
        lines.setdefault((cell["policy"], label), []).append(entry)
    values = list(dict.fromkeys(_plain(c["variant"][key]) for c in summary["cells"]))
    numeric = all(isinstance(value, int | float) for value in values)
    lines_each = max([1, *Counter(policy for policy, _ in lines).values()])
    seen: dict[str, int] = {}
    for (policy, label), entries in lines.items():
        place = [value if numeric else values.index(value) for value, _ in entries]
        mean = np.array([entry["estimate"] for _, entry in entries])
        low = np.array([_known(entry["low"], entry) for _, entry in entries])
        high = np.array([_known(entry["high"], entry) for _, entry in entries])
        line = seen.get(policy, 0)
        seen[policy] = line + 1
        axes.errorbar(
            place,
            mean,
            yerr=[mean - low, high - mean],
            color=_shade(list(policies).index(policy), line, lines_each),
            linestyle=_DASHES[line % len(_DASHES)],
            marker="o",
            markersize=4,
            capsize=3,
            label=label,
        )
    if not numeric:
        texts = [fill(str(value), 90 // len(values)) for value in values]
        axes.set_xticks(range(len(values)), texts)
    axes.set_xlabel(key)
    axes.set_ylabel("mean makespan [s]")
    axes.set_ylim(bottom=0)
    legend_below(axes)
    return figure


def _plain(value: Any) -> Any:
    """Return a value that has a place on an axis: what is no number or word as text."""
    return value if isinstance(value, int | float | str) else json.dumps(value)


def _known(bound: float | None, entry: Mapping[str, Any]) -> float:
    return float(entry["estimate"] if bound is None else bound)


def _shade(policy: int, line: int, lines: int) -> tuple[float, ...]:
    """Return the colour of a policy, paler for each of its further lines."""
    pale = 0.6 * line / max(lines - 1, 1)
    own = to_rgb(COLOURS[policy % len(COLOURS)])
    return tuple(pale + (1.0 - pale) * value for value in own)

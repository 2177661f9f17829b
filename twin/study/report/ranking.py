"""Layouts of a study in their order: a table and a picture, and those that have no plan."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from twin.drawing.markup import breakable, table, text
from twin.host.pictures import INK
from twin.scenario.variations import Variant, is_of_execution
from twin.study.report.layout import bar_chart
from twin.study.summary import StudySummary

_BEST, _OTHER, _ALIKE = "#2f7f66", "#1f5f9e", "#7fa6cf"


def ranking_table(summary: StudySummary, policy: str) -> str:
    """Return the layouts under a policy in their order, as a table."""
    rows = summary.ranked(policy)
    keys = list(rows[0].variant)
    cells = [
        [
            str(row.rank),
            *(breakable(row.variant[key]) for key in keys),
            f"{row.mean_s:.1f}",
            text(row.behind),
            "" if row.rank == 1 or row.told_apart else "not told apart",
        ]
        for row in rows
    ]
    share = f"{100 * summary.confidence:g} %"
    caption = (
        f"Layouts under {policy} by mean makespan in seconds; behind the quickest,"
        f" replication by replication, with intervals that hold together with {share}"
    )
    return table(caption, ["rank", *keys, "mean", "behind", ""], cells)


def refused_table(summary: StudySummary) -> str:
    """Return the layouts that have no plan, with the reason; nothing where all have one."""
    keys = list(summary.refused[0].layout) if summary.refused else []
    rows = [
        [*(breakable(item.layout[key]) for key in keys), text(item.reason)]
        for item in summary.refused
    ]
    return table("Layouts without a plan", [*keys, "reason"], rows, "named")


def draw_ranking(summary: StudySummary, policy: str) -> Figure:
    """Draw the mean makespans of the layouts under a policy, the quickest on top.

    The line at each is the interval of its mean alone; pale ones are not told apart from the
    quickest. Where something is varied besides, groups follow each other.
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
        colour = _BEST if row.rank == 1 else _OTHER if row.told_apart else _ALIKE
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

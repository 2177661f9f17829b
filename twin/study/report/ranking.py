"""Layouts of a study in their order: a table and a picture, and those that have no plan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from twin.drawing.markup import breakable, table, text
from twin.host.pictures import INK
from twin.scenario.variations import is_of_execution
from twin.study.report.layout import bar_chart

_BEST, _OTHER, _ALIKE = "#2f7f66", "#1f5f9e", "#7fa6cf"

Row = Mapping[str, Any]


def ranking_rows(summary: Row, policy: str) -> Sequence[Row]:
    """Return the rows of the ranking that are of a policy."""
    return [row for row in summary["ranking"] if row["policy"] == policy]


def told_apart(row: Row) -> bool:
    """Tell whether a layout is slower than the quickest beyond doubt."""
    behind = row["behind_s"]
    return behind is not None and behind["low"] is not None and behind["low"] > 0.0


def behind_words(row: Row) -> str:
    """Return by how much a layout is behind the quickest, in words."""
    if row["rank"] == 1:
        return "quickest"
    behind = row["behind_s"]
    if behind is None:
        return "-"
    words = f"{behind['estimate']:+.2f} s"
    if behind["low"] is None:
        return words
    return f"{words} ({behind['low']:+.2f} to {behind['high']:+.2f})"


def ranking_table(summary: Row, policy: str) -> str:
    """Return the layouts under a policy in their order, as a table."""
    rows = ranking_rows(summary, policy)
    keys = list(rows[0]["variant"])
    cells = [
        [
            str(row["rank"]),
            *(breakable(row["variant"][key]) for key in keys),
            f"{row['mean_s']:.1f}",
            text(behind_words(row)),
            "" if row["rank"] == 1 or told_apart(row) else "not told apart",
        ]
        for row in rows
    ]
    share = f"{100 * summary['confidence']:g} %"
    caption = (
        f"Layouts under {policy} by mean makespan in seconds; behind the quickest,"
        f" replication by replication, with intervals that hold together with {share}"
    )
    return table(caption, ["rank", *keys, "mean", "behind", ""], cells)


def refused_table(summary: Row) -> str:
    """Return the layouts that have no plan, with the reason; nothing where all have one."""
    refused = summary["refused"]
    if not refused:
        return ""
    keys = list(refused[0]["layout"])
    rows = [
        [*(breakable(item["layout"][key]) for key in keys), text(item["reason"])]
        for item in refused
    ]
    return table("Layouts without a plan", [*keys, "reason"], rows, "named")


def draw_ranking(summary: Row, policy: str) -> Figure:
    """Draw the mean makespans of the layouts under a policy, the quickest on top.

    The line at each is the interval of its mean alone; pale ones are not told apart from the
    quickest. Where something is varied besides, groups follow each other.
    """
    rows = ranking_rows(summary, policy)
    names = [", ".join(f"{k} = {v}" for k, v in _short(row).items()) for row in rows]
    figure, axes = bar_chart(names, 0.34)
    for place, row in enumerate(rows):
        mean = summary["cells"][row["cell"]]["makespan_s"]
        low, high = (
            row["mean_s"] if mean[side] is None else mean[side]
            for side in ("low", "high")
        )
        first = row["rank"] == 1
        colour = _BEST if first else _OTHER if told_apart(row) else _ALIKE
        axes.barh(place, row["mean_s"], color=colour, height=0.62)
        axes.plot([low, high], [place, place], color=INK, linewidth=1.4)
        axes.annotate(
            f"  {row['mean_s']:.1f} s",
            (high, place),
            va="center",
            fontsize=9,
            color=INK,
        )
    axes.set_xlim(0, 1.12 * max(row["mean_s"] for row in rows))
    axes.set_xlabel(f"mean makespan, {policy} [s]")
    return figure


def _short(row: Row) -> Mapping[str, Any]:
    """Return the varied inputs of a row, layouts first."""
    variant = row["variant"]
    return dict(sorted(variant.items(), key=lambda item: is_of_execution(item[0])))

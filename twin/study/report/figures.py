"""The pictures of a study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from planning.transforms import Array
from scheduling.graph.temporal_plan_graph import MOTION_CONFLICT, TASK_DEPENDENCY
from twin.engine.bulk.policy_graph import OTHER
from twin.host.pictures import INK, new_picture, style_axes
from twin.study.replications.replication_rows import WAIT_COLUMNS
from twin.study.sensitivity.sobol import SobolIndex
from twin.study.sensitivity.tornado import Influence

COLOURS = ("#1f5f9e", "#d97b29", "#2f7f66", "#9c4a8f", "#7a8592", "#b8433a")
CAUSE_STYLE = {
    TASK_DEPENDENCY: ("#6fa8dc", "for another robot's task"),
    MOTION_CONFLICT: ("#d97b29", "for the way to be free"),
    OTHER: ("#b9c0c8", "for a message, the clock or a turn"),
}
_DASHES = ("-", "--", ":", "-.")


def cell_label(cell: Mapping[str, Any]) -> str:
    """Return policy and varied inputs of a cell in one line."""
    varied = ", ".join(f"{key} = {value}" for key, value in cell["variant"].items())
    return f"{cell['policy']}, {varied}" if varied else str(cell["policy"])


def draw_ecdf(
    summary: Mapping[str, Any], samples: Sequence[Array], policies: Sequence[str]
) -> Figure:
    """Draw the share of replications that are over by a time, for every cell.

    Args:
        summary: the content of ``summary.json``.
        samples: makespans of each cell, NaN where it did not complete [s].
        policies: in the order of their colours.
    """
    figure, axes = _figure(9.0, 4.6)
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
            color=COLOURS[policy % len(COLOURS)],
            linestyle=_DASHES[variant % len(_DASHES)],
            linewidth=1.8,
            label=cell_label(cell),
        )
    if summary["deadline_s"] is not None:
        axes.axvline(summary["deadline_s"], color=INK, linewidth=1.0)
        axes.annotate(
            f" deadline {summary['deadline_s']:g} s",
            (summary["deadline_s"], 2),
            color=INK,
            fontsize=9,
        )
    axes.set_xlabel("makespan [s]")
    axes.set_ylabel("replications that are over [%]")
    axes.set_ylim(0, 100.5)
    _legend_below(axes)
    return figure


def draw_waits(summary: Mapping[str, Any]) -> Figure:
    """Draw what the robots waited for, by cause, a bar a cell."""
    cells = [cell for cell in summary["cells"] if "wait_s" in cell]
    figure, axes = _figure(9.0, 1.5 + 0.42 * max(len(cells), 1))
    left = np.zeros(len(cells))
    for cause, (colour, label) in CAUSE_STYLE.items():
        values = np.array([cell["wait_s"][WAIT_COLUMNS[cause]] for cell in cells])
        axes.barh(range(len(cells)), values, left=left, color=colour, label=label)
        left = left + values
    for k, total in enumerate(left.tolist()):
        axes.annotate(f" {total:.0f} s", (total, k), va="center", fontsize=9, color=INK)
    axes.margins(x=0.1)
    _label_bars(axes, [cell_label(cell) for cell in cells])
    axes.set_xlabel("mean wait of all robots together [s]")
    return figure


def draw_tornado(
    influences: Sequence[Influence], share: float, mean_s: float
) -> Figure:
    """Draw what the mean makespan does when inputs are smaller and larger.

    Args:
        influences: the strongest first.
        share: by which inputs were made smaller and larger.
        mean_s: the mean makespan [s].
    """
    shown = list(influences)[:14]
    figure, axes = _figure(9.0, 1.5 + 0.36 * max(len(shown), 1))
    for k, one in enumerate(shown):
        axes.barh(k, one.less_s, color=COLOURS[0], height=0.62)
        axes.barh(k, one.more_s, color=COLOURS[1], height=0.62)
    for colour, word in ((COLOURS[0], "less"), (COLOURS[1], "more")):
        axes.add_patch(
            Rectangle((0, 0), 0, 0, color=colour, label=f"{100 * share:.0f} % {word}")
        )
    axes.axvline(0, color=INK, linewidth=1.0)
    _label_bars(axes, [one.name for one in shown])
    axes.set_xlabel(f"change of the mean makespan of {mean_s:.0f} s [s]")
    return figure


def draw_sobol(indices: Sequence[SobolIndex], share: float) -> Figure:
    """Draw the shares of inputs in the variance of the mean makespan."""
    shown = list(indices)[:14]
    figure, axes = _figure(9.0, 1.5 + 0.42 * max(len(shown), 1))
    places = np.arange(len(shown))
    for offset, colour, label, values in (
        (-0.18, COLOURS[0], "alone", [one.first for one in shown]),
        (0.18, COLOURS[1], "alone and together with others", [o.total for o in shown]),
    ):
        axes.barh(places + offset, values, height=0.34, color=colour, label=label)
    _label_bars(axes, [one.name for one in shown])
    axes.set_xlabel(
        f"share in the variance of the mean makespan, inputs within"
        f" {100 * share:.0f} % of what they are"
    )
    return figure


def draw_response(
    summary: Mapping[str, Any], key: str, policies: Sequence[str]
) -> Figure:
    """Draw the mean makespan, with its interval, over an input that is varied.

    Where other inputs are varied too, each of their combinations is a line.
    """
    figure, axes = _figure(9.0, 4.2)
    lines: dict[tuple[str, str], list[tuple[Any, Mapping[str, Any]]]] = {}
    for cell in summary["cells"]:
        if "makespan_s" not in cell:
            continue
        others = {k: v for k, v in cell["variant"].items() if k != key}
        label = cell_label({"policy": cell["policy"], "variant": others})
        entry = (cell["variant"][key], cell["makespan_s"])
        lines.setdefault((cell["policy"], label), []).append(entry)
    values = list(dict.fromkeys(cell["variant"][key] for cell in summary["cells"]))
    numeric = all(isinstance(value, int | float) for value in values)
    seen: dict[str, int] = {}
    for (policy, label), entries in lines.items():
        place = [value if numeric else values.index(value) for value, _ in entries]
        mean = np.array([entry["estimate"] for _, entry in entries])
        low = np.array([_known(entry["low"], entry) for _, entry in entries])
        high = np.array([_known(entry["high"], entry) for _, entry in entries])
        dash = _DASHES[seen.get(policy, 0) % len(_DASHES)]
        seen[policy] = seen.get(policy, 0) + 1
        axes.errorbar(
            place,
            mean,
            yerr=[mean - low, high - mean],
            color=COLOURS[list(policies).index(policy) % len(COLOURS)],
            linestyle=dash,
            marker="o",
            markersize=4,
            capsize=3,
            label=label,
        )
    if not numeric:
        axes.set_xticks(range(len(values)), [str(value) for value in values])
    axes.set_xlabel(key)
    axes.set_ylabel("mean makespan [s]")
    axes.set_ylim(bottom=0)
    axes.legend(frameon=False, fontsize=9)
    return figure


def _known(bound: float | None, entry: Mapping[str, Any]) -> float:
    return float(entry["estimate"] if bound is None else bound)


def _figure(width: float, height: float) -> tuple[Figure, Axes]:
    figure = new_picture(width, height)
    axes = figure.subplots()
    style_axes(axes)
    return figure, axes


def _label_bars(axes: Axes, names: Sequence[str]) -> None:
    """Name horizontal bars, the first on top."""
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    _legend_below(axes)


def _legend_below(axes: Axes) -> None:
    axes.figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=9)

"""Speed-up and computation time against the size of the team, as pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from benchmarks.construction.rows import (
    best_baseline,
    methods,
    models_of,
    spread,
    teams_of,
)
from benchmarks.construction.tables import paper_total
from benchmarks.store import Row
from planning.files import replace_atomically

_INK = "#2b2f36"
_GRID = "#e4e7eb"
_OURS, _FIXED, _LIMIT = "#1f5f9e", "#d97b29", "#c4566f"
_PARTS = {
    "checks": ("#a99bd0", "checks"),
    "keyframes": ("#e3c64e", "keyframes"),
    "path": ("#6fa8dc", "paths"),
    "postprocessing": ("#3d6f9e", "shortcuts, retiming"),
    "other": ("#9aa3ad", "other"),
}


def draw_speed_ups(path: Path, rows: Sequence[Row]) -> None:
    """Draw the speed-up of every model against the size of its team.

    Args:
        path: of the picture, replaced when it exists.
        rows: what was measured.

    Raises:
        OutputError: the picture cannot be written.
    """
    models = [m for m in models_of(rows) if methods(rows, m, 1)]
    picture, panels = _panels(len(models))
    # Where no robot was alone, there is one panel with nothing in it.
    for axis, model in zip(panels, models, strict=False):
        alone = spread(methods(rows, model, 1), "makespan_s").mean
        teams = [m for m in teams_of(rows, model) if methods(rows, model, m)]
        most = max(max(teams), 2)
        limit = alone / float(methods(rows, model, 1)[0]["chain_s"])
        axis.plot((1, most), (1, most), color="#b8bec6", lw=1.0, ls=":")
        axis.axhline(limit, color=_LIMIT, lw=1.0, ls="--")
        fixed = [
            (m, alone / spread(best[1], "makespan_s").mean)
            for m in teams
            if (best := best_baseline(rows, model, m)) is not None
        ]
        if fixed:
            axis.plot(*zip(*fixed, strict=True), "s-", color=_FIXED, lw=1.2, ms=4)
        spans = [spread(methods(rows, model, m), "makespan_s") for m in teams]
        rate = [alone / s.mean for s in spans]
        error = [alone * s.std / s.mean**2 for s in spans]
        axis.errorbar(
            teams, rate, error, fmt="o-", color=_OURS, lw=1.8, ms=5, capsize=2.5
        )
        for m, value, off in zip(teams, rate, error, strict=True):
            axis.annotate(
                f"{value:.1f}",
                (m, value + off),
                xytext=(0, 6),
                textcoords="offset points",
                ha="center",
                fontsize=7.5,
                color=_INK,
            )
        seeds = len(methods(rows, model, 1))
        _style(axis, model, f"{seeds} seed{'s' if seeds > 1 else ''}")
        axis.set_xticks(teams)
        axis.set_xlim(0.6, most + 0.4)
        axis.set_ylim(0.0, 1.15 * min(max(*rate, limit), 1.6 * max(rate)))
    panels[0].set_ylabel("speed-up over one robot", fontsize=8.5, color=_INK)
    _finish(
        picture,
        path,
        "Speed-up against the size of the team",
        [
            Line2D([], [], color=_OURS, marker="o", label="the method"),
            Line2D(
                [],
                [],
                color=_FIXED,
                marker="s",
                ms=4,
                label="fixed duration, over the method's one robot",
            ),
            Line2D([], [], color=_LIMIT, ls="--", label="limit of the longest pile"),
            Line2D([], [], color="#b8bec6", ls=":", label="number of robots"),
        ],
    )


def draw_times(path: Path, rows: Sequence[Row]) -> None:
    """Draw computation times by component, beside the baseline and a tenth of the paper's.

    Args:
        path: of the picture, replaced when it exists.
        rows: what was measured.

    Raises:
        OutputError: the picture cannot be written.
    """
    models = models_of(rows)
    picture, panels = _panels(len(models))
    for axis, model in zip(panels, models, strict=True):
        teams = teams_of(rows, model)
        for k, m in enumerate(teams):
            found = methods(rows, model, m)
            best = best_baseline(rows, model, m)
            at = k - 0.19 if best else k
            _stack(axis, at, found, hatch="")
            if best:
                _stack(axis, k + 0.2, best[1], hatch="////")
            paper = paper_total(model, m)
            if paper is not None:
                ends = (k - 0.42, k + 0.42)
                axis.plot(ends, (paper / 10, paper / 10), color=_LIMIT, lw=1.6)
        _style(axis, model, "")
        axis.set_xticks(range(len(teams)), [str(m) for m in teams])
        axis.set_xlim(-0.6, len(teams) - 0.4)
        axis.margins(y=0.12)
        axis.set_ylim(bottom=0)
    panels[0].set_ylabel("processor time [s]", fontsize=8.5, color=_INK)
    _finish(
        picture,
        path,
        "Computation time of a plan",
        [
            *(Patch(color=c, label=n) for c, n in _PARTS.values()),
            Patch(fc="#f4f4f4", ec=_INK, hatch="////", label="fixed duration"),
            Line2D([], [], color=_LIMIT, lw=1.6, label="a tenth of the paper's"),
        ],
    )


def _stack(axis: Axes, at: float, found: Sequence[Row], hatch: str) -> None:
    """Draw one stacked bar and write its sum."""
    if not found:
        axis.annotate("none", (at, 0), ha="center", va="bottom", fontsize=7.5)
        return
    bottom = 0.0
    for name, (colour, _) in _PARTS.items():
        value = spread(found, "cpu_s", name).mean
        axis.bar(
            at,
            value,
            0.36,
            bottom=bottom,
            color=colour,
            hatch=hatch,
            ec="white",
            lw=0.3,
        )
        bottom += value
    axis.annotate(
        f"{bottom:.0f}" if bottom >= 10 else f"{bottom:.1f}",
        (at, bottom),
        xytext=(0, 2),
        textcoords="offset points",
        ha="center",
        fontsize=7.5,
        color=_INK,
    )


def _panels(count: int) -> tuple[Figure, list[Axes]]:
    width = 1.0 + 3.4 * max(count, 2)
    picture = Figure(figsize=(width, 4.2), dpi=120, facecolor="white")
    FigureCanvasAgg(picture)
    picture.subplots_adjust(
        left=0.7 / width, right=1 - 0.2 / width, top=0.74, bottom=0.14, wspace=0.2
    )
    axes = picture.subplots(1, max(count, 1), squeeze=False)[0]
    return picture, list(np.ravel(axes))


def _style(axis: Axes, title: str, note: str) -> None:
    text = f"{title}  ({note})" if note else title
    axis.set_title(text, loc="left", fontsize=10, color=_INK, pad=6)
    axis.set_xlabel("robots", fontsize=8.5, color=_INK)
    axis.tick_params(axis="both", labelsize=8, colors=_INK, length=0)
    axis.grid(axis="y", color=_GRID, lw=0.7)
    axis.set_axisbelow(True)
    for side in ("top", "right", "left"):
        axis.spines[side].set_visible(False)
    axis.spines["bottom"].set_color("#b8bec6")


def _finish(
    picture: Figure, path: Path, title: str, handles: Sequence[Line2D | Patch]
) -> None:
    left = 0.7 / picture.get_figwidth()
    picture.text(left, 0.935, title, size=13, weight="bold", color=_INK)
    picture.legend(
        handles=list(handles),
        loc="upper left",
        bbox_to_anchor=(left, 0.915),
        ncols=len(handles) if picture.get_figwidth() > 9.0 else 3,
        frameon=False,
        fontsize=8.5,
        labelcolor=_INK,
        borderaxespad=0,
        handlelength=1.6,
        columnspacing=1.4,
    )
    with replace_atomically(path) as temporary:
        picture.savefig(temporary, format="png")

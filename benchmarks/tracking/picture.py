"""Errors over time as a picture: motions within limits, and at full speed at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from twin.host.atomic import replacing

SHOWN = ("cliff", "gearbox", "boat", "wall")
_INK, _GRID = "#2b2f36", "#e4e7eb"
_COLOURS = {"within": "#1f5f9e", "free": "#d97b29"}
_LABELS = {"within": "within limits", "free": "full speed at once"}
SPACING_S = 0.1
"""The picture shows the largest error in every such span [s]."""


def draw_errors(
    path: Path,
    rows: Mapping[str, Mapping[str, Any]],
    errors: Mapping[str, Mapping[str, Sequence[float]]],
) -> None:
    """Draw the largest error of any joint over time, a panel a scenario.

    Args:
        path: of the picture, replaced when it exists.
        rows: results of cases.
        errors: largest errors of any joint, by case and motion, SPACING_S apart [rad or m]; nothing
            is drawn without a case of SHOWN.

    Raises:
        OutputError: the picture cannot be written.
    """
    names = [name for name in SHOWN if name in rows and name in errors]
    if not names:
        return
    figure = Figure(figsize=(10.0, 1.9 * len(names) + 0.5), layout="constrained")
    FigureCanvasAgg(figure)
    for axis, name in zip(
        figure.subplots(len(names), squeeze=False)[:, 0], names, strict=True
    ):
        for key in ("free", "within"):
            error = 1e3 * np.maximum(errors[name][key], 1e-7)
            time_s = SPACING_S * np.arange(len(error))
            axis.plot(time_s, error, color=_COLOURS[key], lw=0.9, label=_LABELS[key])
            if rows[name][key]["exact"]["lost_s"] is not None:
                axis.plot(time_s[-1], error[-1], "x", color=_COLOURS[key], ms=8, mew=2)
        axis.set_yscale("log")
        axis.set_ylabel(f"{name}\n[mrad or mm]", color=_INK)
        axis.grid(color=_GRID, lw=0.6)
        axis.spines[["top", "right"]].set_visible(False)
        axis.set_xlim(left=0.0)
        axis.set_ylim(1e-4, 2e2)
    axis.set_xlabel("time [s]", color=_INK)
    figure.legend(
        *figure.axes[0].get_legend_handles_labels(),
        loc="outside upper right",
        frameon=False,
        ncols=2,
    )
    with replacing(path) as scratch:
        figure.savefig(scratch, dpi=110, format="png")

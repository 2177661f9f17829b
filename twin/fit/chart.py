"""Chart of a fitted distribution: histogram with density curves, and a quantile-quantile plot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from planning.transforms import Array
from twin.drawing.pictures import INK, new_picture, style_axes
from twin.fit.candidates import Candidate
from twin.fit.fitting import Fit
from twin.host.atomic_files import save_png

_BARS = "#c9d3de"
_COLOURS = ("#1f5f9e", "#d97b29", "#2f7f66")
_SHOWN = len(_COLOURS)


def draw_fit(path: Path, fit: Fit) -> None:
    """Draw a sample and its best candidates as a PNG picture.

    Left: the durations, and the densities of the best three. Right: quantiles of the same
    distributions against those of the sample; a distribution that fits is on the line.

    Args:
        path: of the picture, replaced when it exists.
        fit: the fit to draw.

    Raises:
        OutputError: the picture cannot be written.
    """
    picture = new_picture(11.0, 4.8)
    left, right = picture.subplots(1, 2)
    values = np.sort(fit.sample.values_s)
    _histogram(left, values, fit.candidates[:_SHOWN])
    _quantiles(right, values, fit.candidates[:_SHOWN])
    labels = fit.sample.labels
    title = ", ".join(labels.values()) if labels else "durations"
    picture.suptitle(
        f"{title}: {len(values)} durations, {_verdict(fit)}", color=INK, fontsize=12
    )
    save_png(picture, path)


def _verdict(fit: Fit) -> str:
    if not fit.candidates:
        return "all the same"
    if fit.best is None:
        return "no distribution fits: use them as they are"
    return f"best fit {fit.best.family.title}"


def _histogram(axes: Axes, values: Array, candidates: tuple[Candidate, ...]) -> None:
    spread = values[-1] - values[0]
    bins = np.histogram_bin_edges(values, "auto" if spread > 0 else 1)
    if len(bins) > 60:
        bins = np.histogram_bin_edges(values, 60)
    axes.hist(values, bins=bins.tolist(), density=True, color=_BARS, label="measured")
    margin = 0.25 * spread
    t = np.linspace(max(values[0] - margin, 0.0), values[-1] + margin, 600)
    tallest = axes.get_ylim()[1]
    for candidate, colour in zip(candidates, _COLOURS, strict=False):
        log = candidate.family.log_density(t[None], candidate.theta[None])[0]
        axes.plot(t, np.exp(log), color=colour, label=_legend(candidate), linewidth=1.8)
        tallest = max(tallest, 1.1 * float(np.exp(np.percentile(log, 99))))
    axes.plot(values, np.zeros_like(values), "|", color=INK, markersize=9, alpha=0.5)
    # A density may rise without bound where its support begins.
    axes.set_ylim(0, min(tallest, 3 * axes.get_ylim()[1]))
    axes.set_xlabel("duration [s]")
    axes.set_ylabel("density [1/s]")
    axes.legend(frameon=False, fontsize=8)
    style_axes(axes)


def _quantiles(axes: Axes, values: Array, candidates: tuple[Candidate, ...]) -> None:
    u = (np.arange(len(values)) + 0.5) / len(values)
    axes.axline((values[0], values[0]), slope=1, color=INK, linewidth=1.0)
    for candidate, colour in zip(candidates, _COLOURS, strict=False):
        axes.plot(
            *(candidate.model.ppf(u), values, "o"),
            color=colour,
            markersize=3.5,
            alpha=0.8,
            label=candidate.family.title,
        )
    axes.set_xlabel("quantile of the distribution [s]")
    axes.set_ylabel("quantile measured [s]")
    if candidates:
        axes.legend(frameon=False, fontsize=8, loc="upper left")
    axes.set_aspect("equal", adjustable="datalim")
    style_axes(axes)


def _legend(candidate: Candidate) -> str:
    verdict = ", rejected" if candidate.rejected else ""
    return f"{candidate.family.title} (p = {candidate.p_value:.2g}{verdict})"

"""Picture of the static equilibrium in a LEGO step from two sides, bricks coloured by the load of their joints."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

from planning.lego.bricks.grid import level_height
from planning.lego.sequencing.explained_step import MOST

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from planning.lego.sequencing.explained_step import ExplainedStep

# Width of a stud [mm], and millimetres per metre.
_STUD_MM, _MM = 8.0, 1000.0
# Colours of the press and of supports, and the hatching of temporary bricks.
_PRESS, _HOLD, _HATCH = "tab:blue", "tab:green", "////"


def draw_step(step: ExplainedStep) -> bytes:
    """Return the picture of a step's equilibrium as PNG."""
    out = io.BytesIO()
    step_figure(step).savefig(out, format="png", dpi=100)
    return out.getvalue()


def step_figure(step: ExplainedStep) -> Figure:
    """Return a picture of a step: bricks coloured by load, press and holds as arrows."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 5.5), layout="constrained")
    FigureCanvasAgg(figure)
    spans = [item.span for item in step.bricks]
    wide = [
        max(s.x1 for s in spans) - min(s.x0 for s in spans),
        max(s.y1 for s in spans) - min(s.y0 for s in spans),
    ]
    sides = figure.subplots(
        1, 2, sharey=True, width_ratios=[max(w, 0.4 * max(wide)) for w in wide]
    )
    for axis, axes in enumerate(sides):
        _draw_side(axes, step, axis)
        axes.locator_params(axis="x", nbins=1 + 6 * wide[axis] // max(wide))
    sides[0].set_ylabel("height [mm]")
    more = " and more" if step.bears >= MOST - 0.05 else ""
    bears = f"{step.bears:.1f} N{more}"
    figure.suptitle(
        f"step {step.number}: takes {step.needed:.1f} N, the structure bears {bears}"
    )
    _draw_legend(figure, step)
    return figure


def _colour(share: float) -> tuple[float, float, float]:
    """Return the colour of a brick by the load ratio of its joints."""
    pale = 1.0 - 0.85 * min(1.0, share)
    return 1.0, pale, pale


def _draw_legend(figure: Figure, step: ExplainedStep) -> None:
    """Draw a legend of the colours, edges and arrows present."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles = [
        Patch(facecolor=_colour(share), edgecolor="0.3", label=words)
        for share, words in (
            (0.0, "no joint is pulled"),
            (0.5, "half of what a knob holds"),
            (1.0, "all of it: gives way"),
        )
    ]
    handles.append(
        Patch(facecolor="white", edgecolor=_PRESS, linewidth=2.0, label="pressed brick")
    )
    if not step.temporary.isdisjoint(item.name for item in step.bricks):
        handles.append(
            Patch(facecolor="white", edgecolor="0.3", hatch=_HATCH, label="temporary")
        )
    arrows = [(_PRESS, "press"), *([(_HOLD, "support")] if step.holds else [])]
    marks = [
        Line2D([], [], color=ink, marker="v", linewidth=1.6, label=words)
        for ink, words in arrows
    ]
    figure.legend(
        handles=[*handles, *marks],
        loc="outside lower center",
        ncols=4,
        frameon=False,
        fontsize=9,
    )


def _draw_side(axes: Axes, step: ExplainedStep, axis: int) -> None:
    """Draw the structure along y (axis 0: x to the right) or along x (axis 1)."""
    from matplotlib.patches import Rectangle

    strain = step.friction_shares

    def depth(name: str) -> int:
        span = spans[name]
        return -span.y0 if axis == 0 else span.x0

    spans = {item.name: item.span for item in step.bricks}
    for name in sorted(spans, key=depth):
        span = spans[name]
        low, high = (span.x0, span.x1) if axis == 0 else (span.y0, span.y1)
        bottom, top = (level_height(v) * _MM for v in (span.bottom, span.top))
        pressed = name == step.load.body
        axes.add_patch(
            Rectangle(
                (low * _STUD_MM, bottom),
                (high - low) * _STUD_MM,
                top - bottom,
                facecolor=_colour(strain[name]),
                edgecolor=_PRESS if pressed else "0.3",
                hatch=_HATCH if name in step.temporary else None,
                linewidth=2.0 if pressed else 0.8,
            )
        )
    points = step.load.points
    middle = [sum(p[k] for p in points) / len(points) * _MM for k in range(3)]
    arrows = [(middle[axis], middle[2], step.load.force[2], _PRESS)]
    for hold in step.holds:
        x, z = hold.point[axis] * _MM, hold.point[2] * _MM
        arrows.append((x, z, float(hold.direction), _HOLD))
    for x, z, sense, ink in arrows:
        tail = z - 14.0 if sense > 0 else z + 14.0
        arrow = {"arrowstyle": "-|>", "color": ink, "linewidth": 1.6}
        axes.annotate("", xy=(x, z), xytext=(x, tail), arrowprops=arrow)
        # What is annotated does not count for the limits of the axes by itself.
        axes.update_datalim([(x, z), (x, tail)])
    axes.axhline(0.0, color="0.2", linewidth=2.0)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.margins(0.1)
    axes.set_xlabel(f"{'xy'[axis]} on the plate [mm]")

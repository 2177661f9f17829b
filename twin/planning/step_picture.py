"""Picture of a LEGO step's equilibrium: the structure from two sides, strained joints in red."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

from planning.lego.bricks.grid import level_height, occupied_span
from planning.lego.sequencing.stable_steps import MOST, strain_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from planning.lego.sequencing.stable_steps import ExplainedStep

_STUD_MM, _MM = 8.0, 1000.0


def draw_step(step: ExplainedStep) -> bytes:
    """Return a PNG of a step: bricks by how strained they are, press and holds as arrows.

    Args:
        step: its equilibrium.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 5.5), layout="constrained")
    FigureCanvasAgg(figure)
    for axis, axes in enumerate(figure.subplots(1, 2)):
        _draw_side(axes, step, axis)
    more = " and more" if step.bears >= MOST - 0.05 else ""
    bears = f"{step.bears:.1f} N{more}"
    figure.suptitle(
        f"step {step.number}: takes {step.needed:.1f} N, the structure bears {bears}"
    )
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=100)
    return out.getvalue()


def _draw_side(axes: Axes, step: ExplainedStep, axis: int) -> None:
    """Draw the structure along y (axis 0: x to the right) or along x (axis 1)."""
    from matplotlib.patches import Rectangle

    strain = strain_of(step.report, step.bricks)

    def depth(name: str) -> int:
        span = spans[name]
        return -span.y0 if axis == 0 else span.x0

    spans = {i.name: occupied_span(i.cell, i.brick) for i in step.bricks}
    for name in sorted(spans, key=depth):
        span = spans[name]
        low, high = (span.x0, span.x1) if axis == 0 else (span.y0, span.y1)
        bottom, top = (level_height(v) * _MM for v in (span.bottom, span.top))
        share = min(1.0, strain[name])
        colour = (1.0, 1.0 - 0.85 * share, 1.0 - 0.85 * share)
        pressed = name == step.load.body
        axes.add_patch(
            Rectangle(
                (low * _STUD_MM, bottom),
                (high - low) * _STUD_MM,
                top - bottom,
                facecolor=colour,
                edgecolor="tab:blue" if pressed else "0.3",
                linewidth=2.0 if pressed else 0.8,
            )
        )
    points = step.load.points
    middle = [sum(p[k] for p in points) / len(points) * _MM for k in range(3)]
    arrows = [(middle[axis], middle[2], step.load.force[2], "tab:blue")]
    for hold in step.holds:
        x, z = hold.point[axis] * _MM, hold.point[2] * _MM
        arrows.append((x, z, float(hold.direction), "tab:green"))
    for x, z, sense, ink in arrows:
        tail = z - 14.0 if sense > 0 else z + 14.0
        arrow = {"arrowstyle": "-|>", "color": ink, "linewidth": 1.6}
        axes.annotate("", xy=(x, z), xytext=(x, tail), arrowprops=arrow)
    axes.axhline(0.0, color="0.2", linewidth=2.0)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.margins(0.1)
    axes.set_xlabel(f"{'xy'[axis]} on the plate [mm]")
    axes.set_ylabel("height [mm]")

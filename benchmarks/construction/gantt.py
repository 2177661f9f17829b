"""Schedules of constructions as Gantt charts: a lane a robot, one time axis."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from benchmarks.construction.schedule import CARRY, DRIVE, HOME
from benchmarks.store import Row
from planning.files import replace_atomically
from twin.drawing.lane_colours import LANE_COLOURS

_INK = "#2b2f36"
_LANE_IN = 0.26
_BACK = "#f1f3f5"
_STYLES = {
    DRIVE: ("#c3ccd8", "drives to a part"),
    "pick": (LANE_COLOURS["pick"], "pick"),
    CARRY: ("#7d90ab", "carries it"),
    "handover": (LANE_COLOURS["handover"], "handover"),
    "place-down": (LANE_COLOURS["place-down"], "place"),
    HOME: ("#e1e5ea", "out of the way"),
}


class Chart(NamedTuple):
    """A row of the benchmark, and what its chart is called."""

    title: str
    row: Row


def draw_schedules(path: Path, charts: Sequence[Chart], title: str) -> None:
    """Draw one chart under the other, with the same time axis, as a PNG picture.

    Args:
        path: of the picture, replaced when it exists.
        charts: what is drawn.
        title: of the picture.

    Raises:
        OutputError: the picture cannot be written.
    """
    lanes = [list(dict.fromkeys(span[0] for span in c.row["schedule"])) for c in charts]
    heights = [_LANE_IN * len(names) + 0.75 for names in lanes]
    height = sum(heights) + 0.55
    picture = Figure(figsize=(12.0, height), dpi=110, facecolor="white")
    FigureCanvasAgg(picture)
    latest = max(span[3] for c in charts for span in c.row["schedule"])
    top = height - 0.55
    for chart, names in zip(charts, lanes, strict=True):
        own = _LANE_IN * len(names)
        bottom = (top - 0.3 - own) / height
        axis = picture.add_axes((0.075, bottom, 0.905, own / height))
        _draw(axis, chart, names, latest)
        top -= own + 0.75
    picture.text(0.012, 1 - 0.3 / height, title, size=12.5, weight="bold", color=_INK)
    kinds = {span[1] for c in charts for span in c.row["schedule"]}
    picture.legend(
        handles=[
            *(Patch(color=c, label=n) for k, (c, n) in _STYLES.items() if k in kinds),
            Patch(facecolor=_BACK, label="waits"),
        ],
        loc="upper right",
        bbox_to_anchor=(0.985, 1 - 0.1 / height),
        ncols=7,
        frameon=False,
        fontsize=8.5,
        labelcolor=_INK,
        handlelength=1.2,
    )
    picture.text(0.98, 0.06 / height, "time [s]", size=8, color=_INK, ha="right")
    with replace_atomically(path) as temporary:
        picture.savefig(temporary, format="png")


def _draw(axis: Axes, chart: Chart, names: Sequence[str], latest: float) -> None:
    for k in range(len(names)):
        axis.barh(k, latest, 0.8, color=_BACK, zorder=1)
    for robot, kind, start, end, _ in chart.row["schedule"]:
        colour = _STYLES[kind][0]
        axis.barh(
            names.index(robot), end - start, 0.8, left=start, color=colour, zorder=2
        )
    makespan = float(chart.row["makespan_s"])
    axis.axvline(makespan, color=_INK, lw=0.9, ls="--", zorder=3)
    axis.set_title(
        f"{chart.title}: last part placed after {makespan:.0f} s",
        loc="left",
        fontsize=9.5,
        color=_INK,
        pad=4,
    )
    axis.set_yticks(range(len(names)), names, fontsize=8, color=_INK)
    axis.invert_yaxis()
    axis.set_xlim(0.0, latest)
    axis.tick_params(axis="both", length=0, labelsize=8, colors=_INK)
    axis.margins(y=0.0)
    for side in ("top", "right", "left", "bottom"):
        axis.spines[side].set_visible(False)

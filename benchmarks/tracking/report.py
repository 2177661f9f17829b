"""Results as Markdown.

Errors over time as a picture: motions within limits, and at full speed at once.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from benchmarks.machine import date_line, machine_line
from benchmarks.tracking.controller import BANDWIDTH, PERIOD_S
from benchmarks.tracking.following import FAR_M, FOLLOWING_ERROR, SETTLING_S
from benchmarks.tracking.plant import STEP_S
from twin.host.guard import replacing

Rows = Mapping[str, Mapping[str, Any]]


def report(rows: Rows) -> str:
    """Return the page of results."""
    lines = [
        "# Controllers that follow exported trajectories",
        "",
        f"Measured {date_line()} on {machine_line()}. Made by `python -m benchmarks.tracking`, which runs for",
        "each scenario `twin run SCENARIO --set planning.speed_model=limits` (and `l1` or `joint`, as its file",
        "says, for motions at full speed at once) and `twin export RUN --format joint-trajectory`.",
        "",
        "PyBullet's dynamics then follow the exported file, in which segments start when the file says. The",
        "plant knows the URDF of each robot with its masses and inertias, where it stands, and what parts weigh and",
        "where the tool holds them; gravity acts, and a part is a mass fixed to the tool while it is carried.",
        f"It is integrated in steps of {1e3 * STEP_S:g} ms. Controllers run at {1 / PERIOD_S:g} Hz; torques stay within effort limits. Between",
        "points they interpolate as those of ROS 2 do: by quintics where there are velocities and accelerations, else",
        "straight. Platforms are driven as their description says, by two joints that slide and one that turns, with forces",
        "on the ground: there are no wheels.",
        "",
        "- *computed torque*: inverse dynamics of commanded accelerations and of a PID of",
        f"  {BANDWIDTH:g} rad/s (three equal poles), with the part in hand. Robots are as described.",
        "- *flawed*: the same controller, but links and parts are 10 % heavier than it believes, and every joint has dry",
        "  friction that it knows nothing of: a tenth of the largest torque that the joint needs within limits.",
        "- *joint by joint*: the same PID, each joint on its own with the inertia and the gravity that it has at the",
        "  start; nothing known of other joints and of parts. Robots are as described.",
        "",
        "An error is the distance of a joint from its reference at the same instant, the largest of all joints and all",
        f"instants after {SETTLING_S:g} s of standing at the start; there is no lag to be taken off. Where a joint is {1e3 * FOLLOWING_ERROR:g} mrad or mm from",
        "its reference, drives stop, and the robots are *lost*.",
        "",
        "## Largest error of a joint",
        "",
        "| scenario | motion | makespan [s] | followed [s] | computed torque [mrad] | torque over limit | flawed [mrad] | joint by joint [mrad] |",
        "|---|---|---:|---:|---:|---:|---:|---:|",
        *_errors(rows),
        "",
        "Of platforms, joints that slide are in mm, after the semicolon. *Torque over limit* is the largest torque that the controller asked for over the effort",
        "limit of its joint: what is beyond 1 was cut off.",
        "",
    ]
    lines += [
        "## Least distance between robots",
        "",
        "By Bullet, from the collision shapes of the URDF files, tools included (but not tools of racks, and no parts);",
        "as commanded, and as the robots moved under computed torque, in what was followed. Robots are looked at every 20 ms,",
        "and every 1 ms where they are nearest.",
        "",
        "| scenario | motion | commanded [mm] | tracked [mm] |",
        "|---|---|---:|---:|",
        *_distances(rows),
        "",
    ]
    return "\n".join(lines)


def _motions(rows: Rows) -> Iterator[tuple[str, str, Mapping[str, Any]]]:
    for name, row in rows.items():
        yield name, "within limits", row["within"]
        yield name, "full speed at once", row["free"]


def _errors(rows: Rows) -> Iterator[str]:
    for name, motion, found in _motions(rows):
        kinds = ("exact", "flawed", "joint_by_joint")
        cells = [_error(found[key]) if key in found else "" for key in kinds]
        share = found["exact"]["torque"]
        torque = f"{share:.2f}" if share > 0.0 else "no limit"
        yield (
            f"| {name} | {motion} | {found['end_s']:.1f} | {found['followed_s']:.1f} | {cells[0]} | {torque} |"
            f" {cells[1]} | {cells[2]} |"
        )


def _error(found: Mapping[str, Any]) -> str:
    if found["lost_s"] is not None:
        return f"lost after {found['lost_s']:.2f} s"
    sliding = found["error_m"]
    text = f"{1e3 * found['error_rad']:.2f}"
    return text if sliding is None else f"{text}; {1e3 * sliding:.2f}"


def _distances(rows: Rows) -> Iterator[str]:
    for name, motion, found in _motions(rows):
        planned, tracked = (_distance(value) for value in found["distances_m"])
        yield f"| {name} | {motion} | {planned} | {tracked} |"


def _distance(value: float) -> str:
    return f"{1e3 * value:.2f}" if value < FAR_M else f"over {1e3 * FAR_M:g}"


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

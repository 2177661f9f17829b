"""Names of what a Rerun recording holds, and its layout: camera, lanes, plots, text."""

from __future__ import annotations

from typing import Literal

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from planning.cell.workcell import Workcell
from planning.transforms import Array
from twin.run.viewer import TIMELINE

WORLD_FRAME = "world"

LANES = "lanes"
PROGRESS = "progress"
WAITING = "waiting"
EVENTS = "events"
OBJECTS = "objects"
FIXTURES = "fixtures"
FORECAST = "forecast"


def entity_path(*parts: str) -> str:
    """Return the path of an entity whose parts may hold any character."""
    return "/" + "/".join(rr.escape_entity_path_part(part) for part in parts)


def robot_part(robot: str) -> str:
    """Return the path part under which a robot is drawn: one part, as the loader needs."""
    return f"robot-{robot}"


def run_layout(cell: Workcell, makespan_s: float) -> rrb.Blueprint:
    """Return the layout of a run: scene and text above, lanes and plots below."""
    whole = rr.TimeRange(
        start=rr.TimeRangeBoundary.absolute(seconds=0.0),
        end=rr.TimeRangeBoundary.absolute(seconds=max(makespan_s, 1e-3)),
    )
    window = rr.TimeRange(
        start=rr.TimeRangeBoundary.cursor_relative(seconds=-30.0),
        end=rr.TimeRangeBoundary.cursor_relative(seconds=30.0),
    )
    lanes = rrb.StateTimelineView(
        origin=f"/{LANES}",
        name="Robots",
        time_view=rrb.TimeAxis(view_range=whole if makespan_s <= 120 else window),
    )
    progress = rrb.TimeSeriesView(
        origin=f"/{PROGRESS}",
        name="Tasks complete",
        axis_x=rrb.TimeAxis(view_range=whole),
        plot_legend=rrb.Corner2D.LeftTop,
    )
    waiting = rrb.TimeSeriesView(
        origin=f"/{WAITING}",
        name="Robots that wait",
        axis_x=rrb.TimeAxis(view_range=whole),
    )
    plots = rrb.Vertical(progress, waiting)
    return _blueprint(cell, lanes, plots, play_state="paused")


def follow_layout(cell: Workcell) -> rrb.Blueprint:
    """Return the layout of a run in progress: the forecast in place of the plots."""
    lanes = rrb.StateTimelineView(origin=f"/{LANES}", name="Robots")
    forecast = rrb.TimeSeriesView(
        origin=f"/{FORECAST}",
        name="Forecast of the end [s]",
        plot_legend=rrb.Corner2D.RightBottom,
    )
    return _blueprint(cell, lanes, forecast, play_state="following")


def _blueprint(
    cell: Workcell,
    lanes: rrb.StateTimelineView,
    plots: rrb.Vertical | rrb.TimeSeriesView,
    *,
    play_state: Literal["paused", "following"],
) -> rrb.Blueprint:
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(_scene(cell), _events(), column_shares=[5, 2]),
            rrb.Horizontal(lanes, plots, column_shares=[5, 2]),
            row_shares=[5, 2],
        ),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state=play_state),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _scene(cell: Workcell) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        origin="/",
        name="Cell",
        contents=[
            *(f"{entity_path(robot_part(robot.name))}/**" for robot in cell.robots),
            f"/{OBJECTS}/**",
            f"/{FIXTURES}/**",
        ],
        background=[247, 248, 250],
        line_grid=False,
        spatial_information=rrb.SpatialInformation(
            target_frame=WORLD_FRAME, show_axes=False, show_bounding_box=False
        ),
        eye_controls=_camera(cell),
    )


def _events() -> rrb.TextLogView:
    return rrb.TextLogView(
        origin=f"/{EVENTS}",
        name="Events",
        columns=rrb.TextLogColumns(
            text_log_columns=[
                rrb.encodings.TextLogColumn("EntityPath", visible=False),
                rrb.encodings.TextLogColumn("LogLevel", visible=True),
                rrb.encodings.TextLogColumn("Body", visible=True),
            ]
        ),
        rows=rrb.TextLogRows(filter_by_log_level=["INFO", "WARN", "ERROR"]),
    )


def _camera(cell: Workcell) -> rrb.EyeControls3D:
    """Look across the line of robots, from slightly above, at what they work on."""
    bases = np.array([robot.base[:3, 3] for robot in cell.robots]).reshape(-1, 3)
    things = np.array([item.start[:3, 3] for item in cell.objects]).reshape(-1, 3)
    points = np.vstack([bases, things])
    if len(points) == 0:
        points = np.zeros((1, 3))
    low, high = points.min(axis=0), points.max(axis=0)
    work = things if len(things) else points
    target: Array = np.append(0.5 * (low + high)[:2], work[:, 2].mean() + 0.1)
    span = float(np.linalg.norm(high[:2] - low[:2]))
    # Robots reach beyond their bases, which matters less the larger the site.
    size = max(min(span, 0.5 + 0.6 * span), 0.8)
    line = bases[-1, :2] - bases[0, :2] if len(bases) > 1 else np.array([1.0, 0.0])
    norm = float(np.linalg.norm(line))
    along = line / norm if norm > 1e-6 else np.array([1.0, 0.0])
    across = np.array([along[1], -along[0]])
    eye = target + size * np.append(1.05 * across + 0.22 * along, 0.66)
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=eye, look_target=target, eye_up=[0, 0, 1]
    )

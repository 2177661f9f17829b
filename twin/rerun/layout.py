"""Layout of the views of a Rerun recording: 3-D scene, a timeline of the tasks of each robot, plots, and text."""

from __future__ import annotations

from typing import Literal

import rerun as rr
import rerun.blueprint as rrb

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.rerun.camera import camera
from twin.rerun.entities import (
    EVENTS,
    FIXTURES,
    FORECAST,
    LANES,
    OBJECTS,
    PROGRESS,
    TRACKING,
    WAITING,
    WORLD_FRAME,
    entity_path,
    robot_part,
)
from twin.rerun.viewer import TIMELINE


def run_layout(
    tpg: TemporalPlanGraph, makespan_s: float, *, measured: bool = False
) -> rrb.Blueprint:
    """Return the layout of a run: scene and text above, lanes and plots below.

    Args:
        tpg: the executed plan.
        makespan_s: how long it took [s].
        measured: whether it was measured how far robots were from their paths.
    """
    whole = rr.TimeRange(
        start=rr.TimeRangeBoundary.absolute(seconds=0.0),
        end=rr.TimeRangeBoundary.absolute(seconds=max(makespan_s, 1e-3)),
    )
    window = rr.TimeRange(
        start=rr.TimeRangeBoundary.cursor_relative(seconds=-30.0),
        end=rr.TimeRangeBoundary.cursor_relative(seconds=30.0),
    )
    near = whole if makespan_s <= 120 else window
    lanes = rrb.StateTimelineView(
        origin=f"/{LANES}",
        name="Robots",
        time_view=rrb.TimeAxis(view_range=near),
    )
    progress = rrb.TimeSeriesView(
        origin=f"/{PROGRESS}",
        name="Tasks complete",
        axis_x=rrb.TimeAxis(view_range=whole),
        plot_legend=rrb.Corner2D.LeftTop,
    )
    origin, name = WAITING, "Robots that wait"
    if measured:
        origin, name = TRACKING, "Joints off their paths [mrad or mm]"
    waiting = rrb.TimeSeriesView(
        origin=f"/{origin}",
        name=name,
        axis_x=rrb.TimeAxis(view_range=near),
    )
    plots = rrb.Vertical(progress, waiting)
    return _blueprint(tpg, lanes, plots, play_state="paused")


def follow_layout(tpg: TemporalPlanGraph) -> rrb.Blueprint:
    """Return the layout of a run in progress: the forecast in place of the plots."""
    lanes = rrb.StateTimelineView(origin=f"/{LANES}", name="Robots")
    forecast = rrb.TimeSeriesView(
        origin=f"/{FORECAST}",
        name="Forecast of the end [s]",
        plot_legend=rrb.Corner2D.RightBottom,
    )
    return _blueprint(tpg, lanes, forecast, play_state="following")


def _blueprint(
    tpg: TemporalPlanGraph,
    lanes: rrb.StateTimelineView,
    plots: rrb.Vertical | rrb.TimeSeriesView,
    *,
    play_state: Literal["paused", "following"],
) -> rrb.Blueprint:
    below = min(max(0.06 + 0.05 * len(tpg.cell.robots), 0.27), 0.42)
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(_scene(tpg), _events(), column_shares=[5, 2]),
            rrb.Horizontal(lanes, plots, column_shares=[5, 2]),
            row_shares=[1.0 - below, below],
        ),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state=play_state),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def _scene(tpg: TemporalPlanGraph) -> rrb.Spatial3DView:
    return rrb.Spatial3DView(
        origin="/",
        name="Cell",
        contents=[
            *(f"{entity_path(robot_part(robot.name))}/**" for robot in tpg.cell.robots),
            f"/{OBJECTS}/**",
            f"/{FIXTURES}/**",
        ],
        background=[247, 248, 250],
        line_grid=False,
        spatial_information=rrb.SpatialInformation(
            target_frame=WORLD_FRAME, show_axes=False, show_bounding_box=False
        ),
        eye_controls=camera(tpg),
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

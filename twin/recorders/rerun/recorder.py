"""The 3-D recording ``run.rrd``: the cell in motion, lanes, plots and the event rows.

It is written in columns after the run, which is some hundred times faster than row by row.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

import numpy as np
import rerun as rr

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.host.atomic import replacing
from twin.recorders.rerun import layout as layout
from twin.recorders.rerun.bodies import (
    draw_fixtures,
    draw_robot,
    log_objects,
    move_robot,
    time_column,
)
from twin.recorders.rerun.layout import entity_path
from twin.run.activities import IDLE, LANE_COLOURS, robot_activities
from twin.run.events import Event
from twin.run.run_record import Run
from twin.run.trajectory import object_placements, robot_trajectories

_LEVELS = {
    "failed": "ERROR",
    "stopped": "ERROR",
    "stalled": "WARN",
    "retried": "WARN",
    "waiting": "WARN",
}
_QUIET = ("released", "started", "completed")


def write_recording(
    path: Path,
    tpg: TemporalPlanGraph,
    run: Run,
    events: Sequence[Event],
    *,
    name: str = "run",
) -> None:
    """Write a run as a Rerun recording with its layout.

    Args:
        path: of the ``.rrd`` file, replaced when it exists.
        tpg: what was executed.
        run: how.
        events: the rows of the event log.
        name: of the recording, such as the scenario's.

    Raises:
        OutputError: the file cannot be written.
    """
    with replacing(path) as temporary:
        rec = rr.RecordingStream(
            "assembly-twin",
            recording_id=f"{name}-{run.seed}-{run.replication}-{run.policy}",
        )
        rec.set_log_time_enabled(False)
        recording = rec.memory_recording()
        rec.send_blueprint(
            layout.run_layout(tpg.cell, run.makespan_s),
            make_active=False,
            make_default=True,
        )
        draw_fixtures(rec, tpg.cell)
        for robot, motion in zip(
            tpg.cell.robots, robot_trajectories(tpg, run), strict=True
        ):
            move_robot(rec, draw_robot(rec, robot), robot, motion)
        log_objects(rec, tpg.cell, object_placements(tpg, run))
        _log_lanes(rec, tpg, run, events)
        _log_progress(rec, tpg, run)
        log_events(rec, tpg, events)
        rec.send_property("makespan_s", rr.AnyValues(value=run.makespan_s))
        rec.flush()
        # Rerun's own file writer tells of a full disk on standard error only, or never ends.
        temporary.write_bytes(recording.drain_as_bytes() or b"")
        rec.disconnect()


def draw_lane(rec: rr.RecordingStream, robot: str) -> str:
    """Say which colours the states of a robot's lane have; return the lane's entity."""
    names = list(LANE_COLOURS)
    opaque = [int(f"{colour[1:]}ff", 16) for colour in LANE_COLOURS.values()]
    entity = entity_path(layout.LANES, robot)
    rec.log(
        entity,
        rr.StateConfiguration(
            values=names, labels=names, colors=np.array(opaque, np.uint32)
        ),
        static=True,
    )
    return entity


def _log_lanes(
    rec: rr.RecordingStream, tpg: TemporalPlanGraph, run: Run, events: Sequence[Event]
) -> None:
    """Show what each robot does as a lane of coloured states, idle when it is done."""
    told = robot_activities(tpg, events)
    for robot in tpg.cell.robots:
        lane = told.get(robot.name, ())
        changes = [
            (next(items).start_ns, state)
            for state, items in groupby(lane, key=lambda item: item.state)
        ]
        end_ns = lane[-1].end_ns if lane else 0
        if end_ns < run.makespan_ns:
            changes.append((end_ns, IDLE))
        changes.append((run.makespan_ns, ""))
        rec.send_columns(
            draw_lane(rec, robot.name),
            indexes=[time_column([t for t, _ in changes])],
            columns=rr.StateChange.columns(state=[state for _, state in changes]),
        )


def _log_progress(rec: rr.RecordingStream, tpg: TemporalPlanGraph, run: Run) -> None:
    """Plot tasks complete per robot, and how many robots wait."""
    for k, chain in enumerate(tpg.chains):
        last = np.flatnonzero(np.append(np.diff(chain.task) != 0, True))
        done = run.end_ns[k][last]
        done = np.append(0, done[done >= 0])
        _log_steps(
            rec,
            entity_path(layout.PROGRESS, chain.robot),
            done,
            np.arange(len(done)),
            chain.robot,
        )
    waits = run.waits()
    times = np.array([0, *(w.start_ns for w in waits), *(w.end_ns for w in waits)])
    change = np.repeat([0, 1, -1], [1, len(waits), len(waits)])
    order = np.argsort(times, kind="stable")
    total = np.cumsum(change[order])
    final = np.append(np.diff(times[order]) > 0, True)
    _log_steps(rec, layout.WAITING, times[order][final], total[final], "waiting")


def _log_steps(
    rec: rr.RecordingStream,
    entity: str,
    t_ns: np.ndarray,
    values: np.ndarray,
    label: str,
) -> None:
    style = rr.SeriesLines(
        names=[label], interpolation_mode="StepAfter", aggregation_policy="Off"
    )
    rec.log(entity, style, static=True)
    rec.send_columns(
        entity,
        indexes=[time_column(t_ns)],
        columns=rr.Scalars.columns(scalars=values.astype(float)),
    )


def log_events(
    rec: rr.RecordingStream, tpg: TemporalPlanGraph, events: Sequence[Event]
) -> None:
    """Keep the event rows, as text for people and as columns for programs."""
    if not events:
        return
    rec.send_columns(
        layout.EVENTS,
        indexes=[time_column([event.t_ns for event in events])],
        columns=[
            *rr.TextLog.columns(
                text=[_sentence(tpg, event) for event in events],
                level=[_level(tpg, event) for event in events],
            ),
            *rr.AnyValues.columns(
                robot=[event.robot for event in events],
                kind=[event.kind for event in events],
                task=np.array([event.task for event in events], dtype=np.int64),
                node=np.array([event.node for event in events], dtype=np.int64),
                object=[event.object for event in events],
                detail=[event.detail for event in events],
            ),
        ],
    )


def _level(tpg: TemporalPlanGraph, event: Event) -> str:
    """Return the level of an event: single nodes of a motion are too many to show."""
    if event.kind in _QUIET:
        skill = event.task >= 0 and tpg.tasks[event.task].kind != "transit"
        return "INFO" if skill and event.kind != "released" else "DEBUG"
    return _LEVELS.get(event.kind, "INFO")


def _sentence(tpg: TemporalPlanGraph, event: Event) -> str:
    if not event.robot:
        return f"run {event.kind}: {event.detail}"
    if event.kind == "waiting":
        return f"{event.robot} {event.detail}"
    label = tpg.tasks[event.task].label if event.task >= 0 else ""
    words = [
        event.robot,
        event.kind,
        event.object,
        label and f"[{label}]",
        event.detail,
    ]
    return " ".join(word for word in words if word)

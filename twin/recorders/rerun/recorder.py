"""The 3-D recording ``run.rrd``: the cell in motion, lanes, plots and the event rows.

It is written in columns after the run, which is some hundred times faster than row by row.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import rerun as rr

from scheduling.graph.task_edges import machine_chains, with_barriers
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.host.guard import replacing
from twin.recorders.rerun import layout as layout
from twin.recorders.rerun.bodies import (
    draw_fixtures,
    draw_robot,
    log_objects,
    move_robot,
)
from twin.recorders.rerun.event_rows import PlanWords, Wait, log_events, long_waits
from twin.recorders.rerun.lanes import RobotNames, log_lanes, waits_for
from twin.recorders.rerun.layout import entity_path
from twin.recorders.rerun.rerun_values import time_column
from twin.run.events import Event, ExecutionRecord
from twin.run.gantt import rgb, team_colours
from twin.run.trajectory import object_placements, robot_trajectories

_WAITING = (120, 128, 138)
"""Colour of the curve of waiting robots."""


def write_recording(
    path: Path,
    tpg: TemporalPlanGraph,
    run: ExecutionRecord,
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
            layout.run_layout(tpg, run.makespan_s),
            make_active=False,
            make_default=True,
        )
        words = PlanWords(with_barriers(tpg) if run.policy == "synchronous" else tpg)
        colours = team_colours([robot.name for robot in tpg.cell.robots])
        draw_fixtures(rec, tpg.cell)
        for robot, motion in zip(
            tpg.cell.robots, robot_trajectories(tpg, run), strict=True
        ):
            tree = draw_robot(rec, robot, colours[robot.name])
            move_robot(rec, tree, robot, motion)
        placements = object_placements(tpg, run)
        log_objects(rec, tpg.cell, placements)
        names = RobotNames(rec, list(colours))
        for placement in placements:
            names.take(placement)
        names.send()
        log_lanes(rec, tpg, run, events, words)
        _log_progress(rec, tpg, run, colours)
        log_events(rec, words, events, _waits(tpg, run, words, events))
        rec.send_property("makespan_s", rr.AnyValues(value=run.makespan_s))
        rec.flush()
        # Rerun's own file writer tells of a full disk on standard error only, or never ends.
        temporary.write_bytes(recording.drain_as_bytes() or b"")
        rec.disconnect()


def _waits(
    tpg: TemporalPlanGraph,
    run: ExecutionRecord,
    words: PlanWords,
    events: Sequence[Event],
) -> dict[int, Wait]:
    """Return what to say of each event that tells of a wait, by its place."""
    index = tpg.chain_index
    found = {}
    for place, long in long_waits(events, run.makespan_ns).items():
        event = events[place]
        chain = index[event.robot]
        known = waits_for(words, run, chain, event.node, event.t_ns)
        found[place] = Wait(known or event.detail, bool(long))
    return found


def _log_progress(
    rec: rr.RecordingStream,
    tpg: TemporalPlanGraph,
    run: ExecutionRecord,
    colours: Mapping[str, str],
) -> None:
    """Plot tasks complete per robot, and how many robots wait."""
    machines = machine_chains(tpg)
    for k, chain in enumerate(tpg.chains):
        if k in machines:
            continue
        last = np.flatnonzero(np.append(np.diff(chain.task) != 0, True))
        done = run.end_ns[k][last]
        done = np.append(0, done[done >= 0])
        _log_steps(
            rec,
            entity_path(layout.PROGRESS, chain.robot),
            done,
            np.arange(len(done)),
            chain.robot,
            rgb(colours[chain.robot]),
        )
    waits = [wait for wait in run.waits() if wait.chain not in machines]
    times = np.array([0, *(w.start_ns for w in waits), *(w.end_ns for w in waits)])
    change = np.repeat([0, 1, -1], [1, len(waits), len(waits)])
    order = np.argsort(times, kind="stable")
    total = np.cumsum(change[order])
    final = np.append(np.diff(times[order]) > 0, True)
    _log_steps(
        rec, layout.WAITING, times[order][final], total[final], "waiting", _WAITING
    )


def _log_steps(
    rec: rr.RecordingStream,
    entity: str,
    t_ns: np.ndarray,
    values: np.ndarray,
    label: str,
    colour: tuple[int, int, int],
) -> None:
    style = rr.SeriesLines(
        names=[label],
        colors=[colour],
        interpolation_mode="StepAfter",
        aggregation_policy="Off",
    )
    rec.log(entity, style, static=True)
    rec.send_columns(
        entity,
        indexes=[time_column(t_ns)],
        columns=rr.Scalars.columns(scalars=values.astype(float)),
    )

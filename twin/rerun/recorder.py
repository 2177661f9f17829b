"""Writer of the 3-D recording ``run.rrd``: moving bodies, task timelines of robots, plots and event rows.

The recording is written in columns after the run, which is about a hundred times faster than row by row.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path

import numpy as np
import rerun as rr

from planning.files import replace_atomically
from scheduling.graph.barriers import with_barriers
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.activities.activities import IDLE, WAITING, Activity, robot_activities
from twin.drawing.lane_colours import plan_colours
from twin.drawing.team_colours import parse_rgb, team_colours
from twin.rerun import entities
from twin.rerun import layout as layout
from twin.rerun.bodies import (
    RobotNames,
    draw_fixtures,
    draw_robot,
    log_objects,
    move_robot,
)
from twin.rerun.entities import entity_path, time_column
from twin.rerun.event_rows import EventBacklog
from twin.rerun.fingers import finger_motions, move_fingers
from twin.rerun.plan_descriptions import PlanDescriptions
from twin.runs.events import Event
from twin.runs.execution_record import ExecutionRecord
from twin.runs.folder import RECORDING
from twin.runs.tracking import nearest_on_path
from twin.runs.trajectory import object_placements, robot_trajectories

_WAITING_COLOUR = (120, 128, 138)
"""Colour of the curve of waiting robots."""


def record_run(
    folder: Path,
    tpg: TemporalPlanGraph,
    record: ExecutionRecord,
    events: Sequence[Event],
    name: str,
) -> None:
    """Write ``run.rrd`` into the folder of a run; see ``write_recording``."""
    write_recording(folder / RECORDING, tpg, record, events, name=name)


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
        tpg: the executed plan.
        run: how.
        events: the rows of the event log.
        name: of the recording, such as the scenario's.

    Raises:
        OutputError: the file cannot be written.
    """
    with replace_atomically(path) as temporary:
        rec = rr.RecordingStream(
            "assembly-twin",
            recording_id=f"{name}-{run.seed}-{run.replication}-{run.policy}",
        )
        rec.set_log_time_enabled(False)
        recording = rec.memory_recording()
        rec.send_blueprint(
            layout.run_layout(tpg, run.makespan_s, measured=bool(run.measured)),
            make_active=False,
            make_default=True,
        )
        words = PlanDescriptions(
            with_barriers(tpg) if run.policy == "synchronous" else tpg
        )
        colours = team_colours([robot.name for robot in tpg.cell.robots])
        draw_fixtures(rec, tpg.cell)
        placements = object_placements(tpg, run)
        for robot, motion in zip(
            tpg.cell.robots, robot_trajectories(tpg, run), strict=True
        ):
            tree = draw_robot(rec, robot, colours[robot.name])
            move_robot(rec, tree, robot, motion)
            moves = list(finger_motions(tpg, run, placements, robot))
            move_fingers(rec, tree, robot, moves)
        log_objects(rec, tpg.cell, placements)
        names = RobotNames(rec, list(colours))
        for placement in placements:
            names.take(placement)
        names.send()
        log_lanes(rec, tpg, run, events, words)
        _log_progress(rec, tpg, run, colours)
        _log_tracking(rec, tpg, run, colours)
        backlog, index = EventBacklog(), tpg.chain_index
        for event in events:
            waits = ""
            if event.kind == "waiting":
                chain = index[event.robot]
                waits = describe_wait(words, run, chain, event.node, event.t_ns)
            backlog.take(event, waits or event.detail)
        backlog.send(rec, words, run.makespan_ns, ended=True)
        rec.send_property("makespan_s", rr.AnyValues(value=run.makespan_s))
        rec.flush()
        # Rerun's own file writer reports a full disk on standard error only, or hangs.
        temporary.write_bytes(recording.drain_as_bytes() or b"")
        rec.disconnect()


def _log_progress(
    rec: rr.RecordingStream,
    tpg: TemporalPlanGraph,
    run: ExecutionRecord,
    colours: Mapping[str, str],
) -> None:
    """Plot completed tasks per robot, and the number of waiting robots."""
    machines = tpg.machine_chains()
    for k, chain in enumerate(tpg.chains):
        if k in machines:
            continue
        last = np.flatnonzero(np.append(np.diff(chain.task) != 0, True))
        done = run.end_ns[k][last]
        done = np.append(0, done[done >= 0])
        _log_steps(
            rec,
            entity_path(entities.PROGRESS, chain.robot),
            done,
            np.arange(len(done)),
            chain.robot,
            parse_rgb(colours[chain.robot]),
        )
    waits = [wait for wait in run.waits() if wait.chain not in machines]
    times = np.array([0, *(w.start_ns for w in waits), *(w.end_ns for w in waits)])
    change = np.repeat([0, 1, -1], [1, len(waits), len(waits)])
    order = np.argsort(times, kind="stable")
    total = np.cumsum(change[order])
    final = np.append(np.diff(times[order]) > 0, True)
    _log_steps(
        rec,
        entities.WAITING,
        times[order][final],
        total[final],
        "waiting",
        _WAITING_COLOUR,
    )


def _log_tracking(
    rec: rr.RecordingStream,
    tpg: TemporalPlanGraph,
    run: ExecutionRecord,
    colours: Mapping[str, str],
) -> None:
    """Plot the tracking error of each measured robot."""
    for name, own in run.measured.items():
        if (k := tpg.chain_index.get(name)) is not None:
            near = nearest_on_path(tpg.chains[k], own.q, own.node)
            off = 1000.0 * np.abs(near - own.q).max(axis=1)
            entity = entity_path(entities.TRACKING, name)
            _log_steps(rec, entity, own.t_ns, off, name, parse_rgb(colours[name]))


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


def draw_lane(
    rec: rr.RecordingStream,
    robot: str,
    states: Mapping[str, str],
    known: Mapping[str, str],
) -> str:
    """Set the colours of a robot's lane; return the lane's entity.

    Args:
        rec: the recording.
        robot: whose lane.
        states: state of each text of the lane.
        known: colour of each state.
    """
    colours = [known[state] for state in states.values()]
    opaque = [int(f"{colour[1:]}ff", 16) for colour in colours]
    entity = entity_path(entities.LANES, robot)
    texts = list(states)
    rec.log(
        entity,
        rr.StateConfiguration(values=texts, colors=np.array(opaque, np.uint32)),
        static=True,
    )
    return entity


def log_lanes(
    rec: rr.RecordingStream,
    tpg: TemporalPlanGraph,
    run: ExecutionRecord,
    events: Sequence[Event],
    words: PlanDescriptions,
) -> None:
    """Show the activities of each robot and processing machine as a lane, idle at the end."""
    activities = robot_activities(tpg, events)
    index = tpg.chain_index
    names = [robot.name for robot in tpg.cell.robots]
    for name in (*names, *(tpg.chains[k].robot for k in tpg.working_machines())):
        lane = activities.get(name, ())
        said = [(item, _text(words, run, index[name], item)) for item in lane]
        changes = []
        states = {IDLE: IDLE}
        for text, same in groupby(said, key=lambda pair: pair[1]):
            first, _ = next(same)
            changes.append((first.start_ns, text))
            states[text] = first.state
        end_ns = lane[-1].end_ns if lane else 0
        if end_ns < run.makespan_ns:
            changes.append((end_ns, IDLE))
        changes.append((run.makespan_ns, ""))
        rec.send_columns(
            draw_lane(rec, name, states, plan_colours(tpg)),
            indexes=[time_column([t for t, _ in changes])],
            columns=rr.StateChange.columns(state=[text for _, text in changes]),
        )


def describe_wait(
    words: PlanDescriptions, run: ExecutionRecord, chain: int, node: int, t_ns: int
) -> str:
    """Return which robots a node waited for at a time [ns], as text; empty for none."""
    if run.policy == "open-loop" or node < 0:
        return ""

    def complete(other: int, source: int) -> bool:
        return 0 <= int(run.end_ns[other][source]) <= t_ns

    return words.wait(chain, node, complete)


def _text(
    words: PlanDescriptions, run: ExecutionRecord, chain: int, item: Activity
) -> str:
    waits = ""
    if item.state == WAITING:
        waits = describe_wait(words, run, chain, item.first, item.start_ns)
    return waits or words.state(item.state, item.task)

"""Lanes of a recording: what each robot does when, with part and step, and whom it waits for.

Names of robots in 3-D, each with that of what it holds; what lies still is named on hovering.

They stand at the robots' feet: a name beside a part would hide it, and where several robots work
at one place the names would hide the work.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby

import numpy as np
import rerun as rr

from scheduling.graph.task_edges import working_machines
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.recorders.rerun import layout as layout
from twin.recorders.rerun.bodies import name_entity
from twin.recorders.rerun.event_rows import PlanWords
from twin.recorders.rerun.layout import entity_path
from twin.recorders.rerun.rerun_values import time_column
from twin.run.activities import (
    IDLE,
    WAITING,
    Activity,
    plan_colours,
    robot_activities,
)
from twin.run.events import Event, ExecutionRecord
from twin.run.trajectory import Placement


def draw_lane(
    rec: rr.RecordingStream,
    robot: str,
    states: Mapping[str, str],
    known: Mapping[str, str],
) -> str:
    """Say which colours the words of a robot's lane have; return the lane's entity.

    Args:
        rec: the recording.
        robot: whose lane.
        states: the state that each text of the lane tells of.
        known: colour of each state.
    """
    colours = [known[state] for state in states.values()]
    opaque = [int(f"{colour[1:]}ff", 16) for colour in colours]
    entity = entity_path(layout.LANES, robot)
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
    words: PlanWords,
) -> None:
    """Show what each robot and each machine that works does as a lane, idle when it is done."""
    told = robot_activities(tpg, events)
    index = tpg.chain_index
    names = [robot.name for robot in tpg.cell.robots]
    for name in (*names, *(tpg.chains[k].robot for k in working_machines(tpg))):
        lane = told.get(name, ())
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


def waits_for(
    words: PlanWords, run: ExecutionRecord, chain: int, node: int, t_ns: int
) -> str:
    """Return whom a node of a run waited for at a time [ns], in words; empty for nobody."""
    if run.policy == "open-loop" or node < 0:
        return ""

    def complete(other: int, source: int) -> bool:
        return 0 <= int(run.end_ns[other][source]) <= t_ns

    return words.wait(chain, node, complete)


def _text(words: PlanWords, run: ExecutionRecord, chain: int, item: Activity) -> str:
    waits = ""
    if item.state == WAITING:
        waits = waits_for(words, run, chain, item.first, item.start_ns)
    return waits or words.state(item.state, item.task)


class RobotNames:
    """Takes placements of objects by time, and writes what each robot's name is from when on."""

    def __init__(self, rec: rr.RecordingStream, robots: Iterable[str]) -> None:
        """Begin with empty hands."""
        self._rec = rec
        self._held: dict[str, list[str]] = {robot: [] for robot in robots}
        self._rows = {robot: [(0, robot)] for robot in self._held}

    def take(self, placement: Placement) -> None:
        """Take note that an object has changed hands."""
        for robot, held in self._held.items():
            had = placement.object in held
            if had:
                held.remove(placement.object)
            if robot == placement.holder:
                held.append(placement.object)
            if had or robot == placement.holder:
                name = f"{robot}: {', '.join(held)}" if held else robot
                self._rows[robot].append((placement.t_ns, name))

    def send(self) -> None:
        """Write what there is since the last time."""
        for robot, rows in self._rows.items():
            if rows:
                self._rec.send_columns(
                    name_entity(robot),
                    indexes=[time_column([t_ns for t_ns, _ in rows])],
                    columns=rr.Points3D.columns(labels=[name for _, name in rows]),
                )
        self._rows = {robot: [] for robot in self._rows}

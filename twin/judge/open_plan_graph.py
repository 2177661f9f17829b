"""Conversion of an open plan (the JSON plan format of ``twin judge``) to a graph for the audit, one node per motion.

Nodes have a robot and a task, but there are no edges. ``twin.judge.judge`` checks waits separately, so that its
messages contain the ids of motions in the file.
"""

from __future__ import annotations

from itertools import groupby

import numpy as np

from planning.cell.workcell import PlacedRobot, Workcell
from planning.tasks.task import Handling, Task, TaskKind
from planning.transforms import Array, identity, read_only_copy
from scheduling.graph.temporal_plan_graph import NodeChain, TemporalPlanGraph
from twin.judge.open_plan import OpenMotion, OpenPlan


def joint_columns(plan: OpenPlan, robot: PlacedRobot) -> list[int]:
    """Return the columns of a plan's rows with a robot's joints, in the robot's order."""
    own = plan.robots[robot.name].joints
    return [own.index(name) for name in robot.model.joint_names]


def build_open_plan_graph(plan: OpenPlan, cell: Workcell) -> TemporalPlanGraph:
    """Return the graph of a plan that fits a cell; contacts and edges are left out."""
    tasks: list[Task] = []
    chains = []
    for robot in (*cell.robots, *cell.machines):
        own = plan.motions.get(robot.name, ())
        if not own:
            continue
        columns = [0] if cell.is_machine(robot.name) else joint_columns(plan, robot)
        of_node = []
        for _, group in groupby(
            enumerate(own), lambda entry: entry[1].task or entry[0]
        ):
            some = [motion for _, motion in group]
            of_node += [len(tasks)] * len(some)
            tasks.append(_task(len(tasks), robot.name, some, columns))
        chains.append(_chain(robot.name, own, columns, of_node))
    none, cause = np.empty((0, 4), dtype=np.int64), np.empty(0, dtype=np.uint8)
    return TemporalPlanGraph(cell, tuple(tasks), tuple(chains), none, cause, (), ())


def motion_configurations(motion: OpenMotion, columns: list[int]) -> Array:
    """Return the joint values of a motion, shape (rows, n); zeros for a machine."""
    if not motion.q:
        return np.zeros((len(motion.t_s), 1))
    return np.asarray(np.array(motion.q)[:, columns])


def _task(index: int, robot: str, some: list[OpenMotion], columns: list[int]) -> Task:
    first, q = (
        some[0],
        np.concatenate([motion_configurations(m, columns) for m in some]),
    )
    handlings = tuple(
        Handling(
            event.object,
            0,
            {"take": robot, "give": event.to}.get(event.verb),
            read_only_copy(identity()),
        )
        for motion in some
        for event in motion.events
    )
    label = first.task or first.id
    kind = first.skill or TaskKind.TRANSIT
    return Task(index, robot, kind, index + 1, label, q, handlings, first.object)


def _chain(
    robot: str, own: tuple[OpenMotion, ...], columns: list[int], of_node: list[int]
) -> NodeChain:
    rows = [motion_configurations(motion, columns) for motion in own]
    spans = np.array([motion.t_s[-1] - motion.t_s[0] for motion in own])
    passed = [
        (np.array(motion.t_s) - motion.t_s[0]) / span if span > 0.0 else np.ones(len(q))
        for motion, span, q in zip(own, spans.tolist(), rows, strict=True)
    ]
    return NodeChain(
        robot,
        rows[0][0],
        np.concatenate(rows),
        np.concatenate(passed),
        np.cumsum([0, *map(len, rows)]),
        np.array(of_node, dtype=np.int64),
        np.array([motion.skill is not None for motion in own]),
        spans,
        np.array([motion.t_s[0] for motion in own]),
    )

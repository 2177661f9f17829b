"""Conversion of an open plan to a graph for the audit: one node per motion.

Nodes have a robot and a task, but no edges: waits are checked by ``twin.judge.judge``, whose messages name
motions by their ids in the file.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import groupby
from pathlib import Path

import numpy as np

from planning.cell.workcell import PlacedRobot, Workcell
from planning.tasks.task import Handling, Task, TaskKind
from planning.transforms import Array, identity, read_only_copy
from scheduling.graph.temporal_plan_graph import NodeChain, TemporalPlanGraph
from twin.document.validation import Found, check_known_name
from twin.document.yaml_text import KeyPath
from twin.judge.open_plan import OpenMotion, OpenPlan, require_no_faults
from twin.scenario.sections.kind import AssemblySection, assembly_kind


def cell_for(
    plan: OpenPlan, path: Path, cell: Workcell, assembly: AssemblySection
) -> Workcell:
    """Return the cell with all objects that a plan names.

    Further bricks of a feeding station, ``<station>.2`` and so on, are only in the cell where a plan
    uses them.

    Args:
        plan: the plan.
        path: its file.
        cell: of its scenario.
        assembly: of its scenario.

    Raises:
        InvalidScenarioError: the plan names unknown robots, joints or objects.
    """
    kind = assembly_kind(assembly)
    known = {item.name: item for item in cell.objects}
    for _, _, motion in plan.placed():
        for name in (motion.object, *(event.object for event in motion.events)):
            if name is None or name in known:
                continue
            if (item := kind.object_named(name, known)) is not None:
                known[item.name] = item
    whole = replace(cell, objects=tuple(known.values()))
    require_no_faults(path, _misfits(plan, whole))
    return whole


def _misfits(plan: OpenPlan, cell: Workcell) -> Found:
    """Yield names of a plan that are not in the cell."""
    robots = {robot.name: robot for robot in cell.robots}
    machines = {item.name for item in cell.machines}
    named = (*(o.name for o in cell.objects), *(f.name for f in cell.fixtures))
    things = sorted(set(named))
    for name, own in plan.robots.items():
        at: KeyPath = ("robots", name)
        yield from check_known_name((*at, "[key]"), "robot", name, robots)
        if name in robots and sorted(own.joints) != sorted(
            robots[name].model.joint_names
        ):
            joints = ", ".join(robots[name].model.joint_names)
            yield (*at, "joints"), f"are not those of {name}, each once: {joints}"
    for name in plan.machines:
        words = "the scenario has no machines"
        yield from check_known_name(
            ("machines", name, "[key]"), "machine", name, machines, words
        )
    objects = sorted(item.name for item in cell.objects)
    for at, name, motion in plan.placed():
        yield from check_known_name((*at, "object"), "object", motion.object, things)
        for k, touched in enumerate(motion.touches):
            yield from check_known_name((*at, "touches", k), "thing", touched, things)
        for k, event in enumerate(motion.events):
            place = (*at, "events", k)
            yield from check_known_name(
                (*place, event.verb), "object", event.object, objects
            )
            if event.to is not None:
                yield from check_known_name((*place, "to"), "robot", event.to, robots)
            if name in machines and event.verb not in ("appear", "leave"):
                yield (
                    (*place, event.verb),
                    "a machine lets objects appear and leave only",
                )


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

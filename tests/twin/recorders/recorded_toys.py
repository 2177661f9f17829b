"""Small runs of real robot models in made-up motion, for recordings."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from rerun.chunk import RrdReader

from planning.cell.robot_model import RobotModel
from planning.cell.workcell import CellObject, PlacedRobot
from planning.robots.registry import robot_model
from planning.transforms import translation
from scheduling.graph.temporal_plan_graph import NodeHandling, TemporalPlanGraph
from tests.twin.drawn_runs import VARIED
from tests.twin.simulated import watched
from tests.twin.twin_toys import random_tpg
from twin.rerun.recorder import write_recording
from twin.runs.events import Event
from twin.runs.execution_record import ExecutionRecord, Policy
from twin.uncertainty.skill_durations import SkillDurations


def toy_of(models: Sequence[str], *, seed: int = 4, idle: int = 0) -> TemporalPlanGraph:
    """Robots of some models in random motion, the last ones idle; one part comes up later.

    The part is picked and put down by whoever does so with ``brick_0``, right after it.
    """
    found = [robot_model(name) for name in models]
    busy = len(found) - idle
    dofs = [model.dof for model in found[:busy]]
    tpg = random_tpg(seed, dofs=dofs, tasks=10, edges=16, idle_robots=idle)
    robots = tuple(
        PlacedRobot(f"robot_{k}", model, translation(1.2 * k, 0, 0), model.home)
        for k, model in enumerate(found)
    )
    brick = tpg.cell.objects[0]
    later = CellObject("later", "2x4", brick.shape, brick.start, later=True)
    first, second = tpg.handlings
    comes = NodeHandling("later", first.robot, first.node, 1, None, brick.start)
    taken = replace(second, object="later", waypoint=0, holder=f"robot_{second.robot}")
    cell = replace(tpg.cell, robots=robots, objects=(brick, later))
    return replace(tpg, cell=cell, handlings=(first, comes, second, taken))


def recorded_run(
    path: Path,
    tpg: TemporalPlanGraph,
    durations: SkillDurations = VARIED,
    *,
    seed: int = 1,
    policy: Policy = "asynchronous",
) -> tuple[ExecutionRecord, list[Event]]:
    """Execute a graph once and write its recording; return the run and its events."""
    run, events = watched(tpg, durations, seed=seed, policy=policy)
    write_recording(path, tpg, run, events)
    return run, events


def moved_by(tpg: TemporalPlanGraph, model: RobotModel) -> TemporalPlanGraph:
    """Return a graph of one robot whose robot is of a model."""
    robot = PlacedRobot("robot_0", model, np.eye(4), model.home)
    return replace(tpg, cell=replace(tpg.cell, robots=(robot,)))


def rows(path: Path, entity: str, column: str) -> list[tuple[int, list[Any]]]:
    """Return (time [ns], cell) of a temporal column of an entity, by time."""
    found: list[tuple[int, list[Any]]] = []
    stream = RrdReader(path).store().stream()
    for chunk in stream.filter(content=entity, has_timeline="sim_time"):
        batch = chunk.to_record_batch()
        if column in batch.schema.names:
            times = batch.column("sim_time").cast(pa.int64()).to_pylist()
            found += zip(times, batch.column(column).to_pylist(), strict=True)
    return sorted(found, key=lambda row: row[0])


def static(path: Path, entity: str, column: str) -> list[Any]:
    """Return the last static cell of a column of an entity."""
    found: list[Any] = []
    for chunk in RrdReader(path).store().stream().filter(content=entity):
        batch = chunk.to_record_batch()
        if chunk.is_static and column in batch.schema.names:
            found = batch.column(column).to_pylist()[-1]
    return found

"""Folders of made-up runs for the tests of exports."""

import json
from pathlib import Path
from typing import Any

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.simulated import simulate
from tests.twin.twin_toys import random_tpg
from twin.durations.bounded import Fixed
from twin.durations.measured import packaged_timings
from twin.durations.nanoseconds import NANOSECONDS
from twin.exports.formats import exported_files
from twin.recorders.observers import JsonlRecorder
from twin.recorders.run_tables import objects_table, trajectory_table, write_table
from twin.runs.execution_record import ExecutionRecord
from twin.runs.trajectory import object_placements, robot_trajectories
from twin.trial.run_result import RunResult
from twin.uncertainty.disturbances import (
    Disturbances,
    EmergencyStop,
    SkillFailure,
    Stalls,
)
from twin.uncertainty.skill_durations import SkillDurations

Toy = tuple[RunResult, ExecutionRecord]
"""A run as it is read back, and as it was."""

DISTURBED = Disturbances(
    stalls=Stalls(count_per_robot=2),
    emergency_stops=(EmergencyStop(robot="robot_1", at_s=7.0, duration_s=4.0),),
    failures={
        "pick": SkillFailure(probability=0.4, retries=5, retry=Fixed(value_s=1.5))
    },
)


def toy_run(
    folder: Path,
    seed: int = 3,
    *,
    disturbances: Disturbances = DISTURBED,
    tpg: TemporalPlanGraph | None = None,
) -> Toy:
    """Write the folder of a run of two robots, one with a joint more than the other.

    Toys cannot be saved as plans: the graph is put into the run by hand.
    """
    tpg = tpg or random_tpg(seed, tasks=24, edges=60)
    run = simulate(
        tpg,
        SkillDurations(packaged_timings()),
        seed=seed,
        disturbances=disturbances,
        recorders=[JsonlRecorder(folder / "events.jsonl")],
    )
    moves = trajectory_table(robot_trajectories(tpg, run))
    write_table(folder / "trajectory.parquet", moves)
    write_table(folder / "objects.parquet", objects_table(object_placements(tpg, run)))
    manifest = {"scenario": {"name": 'toy: "run"'}, "seed": seed}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    summary = {
        **{"scenario": 'toy: "run"', "seed": seed, "policy": run.policy},
        **{"outcome": run.outcome, "makespan_s": run.makespan_s, "audit": None},
        **{"makespan_sequential_s": run.makespan_s, "lower_bound_s": 0.0, "wait_s": {}},
        **{"nodes": 1, "type2_edges": 0, "planning_s": {}, "raised_skills": 0},
    }
    (folder / "summary.json").write_text(json.dumps(summary))
    recorded = RunResult(folder)
    recorded.__dict__["tpg"] = tpg
    return recorded, run


def segments_of(run: RunResult, rate_hz: float | None = None) -> list[dict[str, Any]]:
    """Return the segments of a run as its joint trajectories have them."""
    text = exported(run, "joint-trajectory", rate_hz=rate_hz)["joint_trajectories.json"]
    document = json.loads(text)
    assert document["format"] == "assembly-twin joint trajectories"
    found: list[dict[str, Any]] = document["segments"]
    return found


def stamp_ns(stamp: dict[str, int]) -> int:
    """Return a time or duration of a message [ns]."""
    assert set(stamp) == {"sec", "nanosec"}
    assert 0 <= stamp["nanosec"] < NANOSECONDS
    return stamp["sec"] * NANOSECONDS + stamp["nanosec"]


def exported(
    run: RunResult, name: str, *, nodes: bool = False, rate_hz: float | None = None
) -> dict[str, bytes]:
    """Return the files of a run in a format."""
    return dict(exported_files(run, name, nodes=nodes, rate_hz=rate_hz))

"""What happens without coordination: replications in which nobody waits, checked for collisions."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.host.atomic import write_json
from twin.host.silence import silenced
from twin.recorders.motion_tables import objects_table, trajectory_table, write_table
from twin.run.folder import OBJECTS, TRAJECTORY
from twin.run.trajectory import object_placements, robot_trajectories
from twin.scenario.sections.scenario import Scenario
from twin.scenario.variations import Variant
from twin.study.plans import scenario_workload
from twin.study.replications.workload import Engines

OPEN_LOOP = "open-loop"


def audit_open_loop(
    scenario: Scenario,
    base: Path,
    tpg: TemporalPlanGraph,
    variant: Variant,
    folder: Path,
    count: int,
    progress: Callable[[int, int], None] = lambda done, total: None,
    *,
    antithetic: bool = False,
) -> list[int]:
    """Return how many collisions PyBullet finds in each of the first replications.

    What was found is kept, one small file a replication, so an interrupted study goes on.

    Args:
        scenario: of the study.
        base: where its relative paths start.
        tpg: the plan, with its geometry.
        variant: values of the varied inputs.
        folder: of the results, made where it is missing.
        count: replications that are checked.
        progress: called with replications done and wanted.
        antithetic: draw in mirrored pairs, as the study does.

    Raises:
        OutputError: a file cannot be written.
    """
    with silenced():
        import pybullet  # noqa: F401 - for its greeting
    from scheduling.graph.plan_files import save_plan
    from twin.audit.audit import audit_run

    folder.mkdir(parents=True, exist_ok=True)
    load = scenario_workload(
        scenario, base, tpg, OPEN_LOOP, variant, antithetic=antithetic
    )
    engines = Engines(load)
    found: list[int] = []
    replay = folder / "replay"
    for replication in range(count):
        path = folder / f"{replication}.json"
        if path.exists():
            found.append(int(json.loads(path.read_text())["violations"]))
            progress(replication + 1, count)
            continue
        run = engines.simulator.run(seed=load.seed, replication=replication)
        if run.outcome != "completed":
            continue
        if not replay.exists():
            replay.mkdir()
            save_plan(tpg, replay)
        write_table(replay / TRAJECTORY, trajectory_table(robot_trajectories(tpg, run)))
        write_table(replay / OBJECTS, objects_table(object_placements(tpg, run)))
        report = audit_run(replay, lambda done, total: None)
        least = report.min_distance_m
        write_json(
            path,
            {
                "replication": replication,
                "violations": len(report.violations),
                "min_distance_m": least if abs(least) < float("inf") else None,
            },
        )
        found.append(len(report.violations))
        progress(replication + 1, count)
    shutil.rmtree(replay, ignore_errors=True)
    return found

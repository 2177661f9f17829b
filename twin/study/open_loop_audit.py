"""Collision audit of open-loop replications, in which nobody waits for anybody."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from scheduling.graph.plan_files import save_plan
from twin.audit.audit import audit_run
from twin.host.atomic import write_json
from twin.recorders.motion_tables import write_motion
from twin.study.replications.workload import Engines, Workload

OPEN_LOOP = "open-loop"


def audit_open_loop(load: Workload, folder: Path, count: int) -> Iterator[int]:
    """Yield how many collisions PyBullet finds in each of the first replications.

    What was found is kept, one small file a replication, so an interrupted study goes on.

    Args:
        load: the work of an open-loop cell, with the geometry of its plan.
        folder: of the results, made where it is missing.
        count: replications that are checked; those that come to no end are left out.

    Raises:
        OutputError: a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    engines = Engines(load)
    replay = folder / "replay"
    for replication in range(count):
        path = folder / f"{replication}.json"
        if path.exists():
            yield int(json.loads(path.read_text())["violations"])
            continue
        run = engines.simulator.run(seed=load.seed, replication=replication)
        if run.outcome != "completed":
            continue
        if not replay.exists():
            replay.mkdir()
            save_plan(load.tpg, replay)
        write_motion(replay, load.tpg, run)
        report = audit_run(replay)
        least = report.min_distance_m
        found = {
            "replication": replication,
            "violations": len(report.violations),
            "min_distance_m": least if np.isfinite(least) else None,
        }
        write_json(path, found)
        yield len(report.violations)
    shutil.rmtree(replay, ignore_errors=True)

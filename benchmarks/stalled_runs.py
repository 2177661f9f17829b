"""Many runs of shipped plans with random stalls: none may deadlock, no audit may find anything.

    python -m benchmarks.stalled_runs                # all LEGO structures, all multi-arm scenarios
    python -m benchmarks.stalled_runs scenarios/lego/cliff.yaml --runs 5

Of each scenario: the plan as it is built and the shortened one, both as planned, then the
shortened one with stalls: every robot stands still at ``--stalls`` random nodes for 1 to 20 s each,
every run with a seed of its own. PyBullet audits every run.

Writes benchmarks/results/stalled-runs.json after every run, and stalled-runs.md of that. What is
there already for the same plan is not run again. Exits with 1 on any failure.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.machine import date_line, machine_line
from benchmarks.stalled_runs_report import report
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.audit.audit import Auditor
from twin.audit.motion.executed import read_recording
from twin.host.atomic import write_json
from twin.planning.pipeline import plan_scenario
from twin.recorders.motion_tables import objects_table, trajectory_table, write_table
from twin.run.folder import OBJECTS, TRAJECTORY
from twin.run.trajectory import object_placements, robot_trajectories
from twin.scenario.file import load_scenario
from twin.scenario.sections.scenario import Scenario
from twin.trial.trial import execute
from twin.uncertainty.disturbances import Stalls

ROOT = Path(__file__).parents[1]
RESULTS = Path(__file__).parent / "results"
FOLDERS = ("lego", "multi_arm")
RUNS = 20
FEWER_RUNS = {"chair": 3}
"""Stalled runs by default, and of scenarios that take many times as long to audit."""


@dataclass(frozen=True)
class AuditedRun:
    """One run and what the audit said.

    Attributes:
        plan: ``built`` as the plan was before shortcuts, ``shortened`` after them.
        seed: of durations and stalls.
        stalls: of each robot.
        outcome: completed, failed or aborted.
        makespan_s: with the stalls [s].
        violations: what the audit found, in words.
        configurations: audited.
        least_m: least distance between robots [m], None where they never came close.
        cpu_s: processor seconds of execution and audit.
    """

    plan: str
    seed: int
    stalls: int
    outcome: str
    makespan_s: float
    violations: tuple[str, ...]
    configurations: int
    least_m: float | None
    cpu_s: float


def shipped_scenarios() -> list[Path]:
    """Return the scenario files of this repository that are run by default."""
    found = (ROOT / "scenarios" / folder for folder in FOLDERS)
    return [path for folder in found for path in sorted(folder.glob("*.yaml"))]


def plan_of(path: Path, *, shortened: bool) -> tuple[Scenario, TemporalPlanGraph]:
    """Plan a scenario, with shortcuts as it says, or without."""
    scenario = load_scenario(path)
    if not shortened:
        planning = scenario.planning.model_copy(update={"shortcut_candidates": 0})
        scenario = scenario.model_copy(update={"planning": planning})
    return scenario, plan_scenario(scenario, path.parent).tpg


def fingerprint(tpg: TemporalPlanGraph) -> str:
    """Return a short hash of everything that a run of a plan depends on."""
    digest = hashlib.sha256(np.ascontiguousarray(tpg.edges).tobytes())
    for chain in tpg.chains:
        for array in (chain.waypoints, chain.duration, chain.task):
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:12]


def audited_runs(
    scenario: Scenario,
    tpg: TemporalPlanGraph,
    base: Path,
    plan: str,
    wanted: list[tuple[int, int]],
) -> Iterator[AuditedRun]:
    """Execute a plan several times and audit each run.

    Args:
        scenario: what the plan was made for.
        tpg: the plan.
        base: where relative paths of the scenario start.
        plan: what the rows call it.
        wanted: seed and stalls of each robot, run by run.
    """
    with Auditor(tpg) as auditor, tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        for seed, stalls in wanted:
            start = time.process_time()
            section = Stalls(count_per_robot=stalls, duration_s=(1.0, 20.0))
            execution = scenario.execution.model_copy(update={"stalls": section})
            chosen = scenario.model_copy(update={"seed": seed, "execution": execution})
            run = execute(chosen, tpg, base, "asynchronous")
            motions = robot_trajectories(tpg, run)
            write_table(folder / TRAJECTORY, trajectory_table(motions))
            write_table(folder / OBJECTS, objects_table(object_placements(tpg, run)))
            found = auditor.audit(read_recording(folder, tpg.cell))
            least = found.min_distance_m
            yield AuditedRun(
                plan,
                seed,
                stalls,
                run.outcome,
                run.makespan_s,
                tuple(str(asdict(violation)) for violation in found.violations),
                found.configurations,
                least if math.isfinite(least) else None,
                time.process_time() - start,
            )


def run_with_stalls(
    scenario: Scenario, tpg: TemporalPlanGraph, base: Path, seed: int, stalls: int
) -> AuditedRun:
    """Execute a plan once with random stalls and audit it."""
    (run,) = audited_runs(scenario, tpg, base, "shortened", [(seed, stalls)])
    return run


def main() -> int:
    """Measure what is missing, write the result files, tell whether all runs passed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenarios", type=Path, nargs="*", metavar="SCENARIO")
    parser.add_argument("--runs", type=int, help="stalled runs; default: 20, chair 3")
    parser.add_argument("--stalls", type=int, default=20, help="of each robot in a run")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of results")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    target = options.out / "stalled-runs.json"
    results: dict[str, Any] = {}
    if target.exists():
        results = json.loads(target.read_text(encoding="utf-8"))["scenarios"]
    for path in options.scenarios or shipped_scenarios():
        name = path.stem
        runs = FEWER_RUNS.get(name, RUNS) if options.runs is None else options.runs
        for plan in ("built", "shortened"):
            nominal = [(0, 0)]
            stalled = [(seed, options.stalls) for seed in range(runs)]
            wanted = nominal + (stalled if plan == "shortened" else [])
            sys.stderr.write(f"{name}: planning ({plan})\n")
            scenario, tpg = plan_of(path, shortened=plan == "shortened")
            mark = fingerprint(tpg)
            entry = results.setdefault(name, {}).get(plan)
            if entry is None or entry["fingerprint"] != mark:
                entry = {
                    "fingerprint": mark,
                    "seed": scenario.seed,
                    "robots": [chain.robot for chain in tpg.chains],
                    "nodes": sum(len(chain) for chain in tpg.chains),
                    "type2_edges": len(tpg.edges),
                    "runs": [],
                }
                results[name][plan] = entry
            known = {(row["seed"], row["stalls"]) for row in entry["runs"]}
            missing = [key for key in wanted if key not in known]
            for row in audited_runs(scenario, tpg, path.parent, plan, missing):
                entry["runs"].append(asdict(row))
                entry["date"], entry["machine"] = date_line(), machine_line()
                write_json(target, {"scenarios": results})
                sys.stderr.write(f"{name}: {row}\n")
    rows = [
        row
        for plans in results.values()
        for entry in plans.values()
        for row in entry["runs"]
    ]
    text = report(results)
    (options.out / "stalled-runs.md").write_text(text, encoding="utf-8")
    bad = [r for r in rows if r["outcome"] != "completed" or r["violations"]]
    sys.stderr.write(f"{target}: {len(rows) - len(bad)} of {len(rows)} runs passed\n")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())

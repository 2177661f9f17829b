"""Table of the scenarios in scenarios/assembly: planning, makespans, and runs with random stalls.

    python -m benchmarks.assembly                    # all that are there
    python -m benchmarks.assembly scenarios/assembly/truss.yaml --runs 5

Each is planned in a process of its own once its kernels are compiled, executed with the durations of
its seed one task at a time and as planned, then with ``--stalls`` random standstills of each robot, 1
to 20 s each, every run with a seed of its own. Every run is audited.

Writes benchmarks/results/assembly.json after each scenario, and assembly.md of that. What is there
already for the same plan is not run again. Exits with 1 on any failure.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.machine import date_line, load_line, machine_line
from benchmarks.stalled_runs import audited_runs, fingerprint
from twin.host.atomic import write_json
from twin.planning.pipeline import plan_scenario
from twin.run.summary import lower_bound_s
from twin.scenario.file import load_scenario
from twin.trial.trial import execute

ROOT = Path(__file__).parents[1]
RESULTS = Path(__file__).parent / "results"
SCENARIOS = ROOT / "scenarios" / "assembly"
RUNS = 20


def planning_s(path: Path) -> float:
    """Return the wall-clock seconds of planning a scenario in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.assembly", "--time", str(path)],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    )
    return float(done.stdout.splitlines()[-1])


def measure(path: Path, known: Mapping[str, Any], runs: int, stalls: int) -> Any:
    """Plan a scenario and execute it; runs of the same plan that are known are not repeated.

    Args:
        path: of the scenario.
        known: what was measured before, empty where nothing was.
        runs: with stalls.
        stalls: of each robot in such a run.
    """
    scenario = load_scenario(path)
    planned = plan_scenario(scenario, path.parent)
    mark = fingerprint(planned.tpg)
    rows = list(known["runs"]) if known.get("fingerprint") == mark else []
    there = {(row["seed"], row["stalls"]) for row in rows}
    wanted = [(scenario.seed, 0), *((seed, stalls) for seed in range(runs))]
    missing = [key for key in wanted if key not in there]
    found = audited_runs(scenario, planned.tpg, path.parent, planned.variant, missing)
    for row in found:
        sys.stderr.write(f"{path.stem}: {row}\n")
        rows.append(asdict(row))
    turns = planned.turns or planned.tpg
    as_planned = execute(scenario, planned.tpg, path.parent)
    before = os.getloadavg()[0]
    return {
        "fingerprint": mark,
        "robots": [robot.name for robot in planned.cell.robots],
        "tools": sorted({robot.tool for robot in planned.cell.robots if robot.tool}),
        "steps": len({task.step for task in planned.tpg.tasks if task.step}),
        "nodes": sum(len(chain) for chain in planned.tpg.chains),
        "edges": len(planned.tpg.edges),
        "planning_s": planning_s(path),
        "load": [before, os.getloadavg()[0]],
        "sequential_s": execute(scenario, turns, path.parent, "sequential").makespan_s,
        "load_bound_s": planned.load_bound_s,
        "path_bound_s": lower_bound_s(planned.tpg, as_planned),
        "runs": sorted(rows, key=lambda row: (row["stalls"], row["seed"])),
        "date": date_line(),
        "machine": machine_line(),
    }


def passed(row: Mapping[str, Any]) -> bool:
    """Tell whether a run was completed and the audit found nothing."""
    return row["outcome"] == "completed" and not row["violations"]


def page(results: Mapping[str, Any]) -> str:
    """Return the page of what was measured, by the names of the scenarios."""
    entries = results.values()
    rows = [row for entry in entries for row in entry["runs"]]
    dates = " and ".join(sorted({entry["date"] for entry in entries}))
    machines = "; ".join(sorted({entry["machine"] for entry in entries}))
    busy = load_line([(a, b) for a, b in (entry["load"] for entry in entries)])
    stalls = " or ".join(sorted({str(row["stalls"]) for row in rows if row["stalls"]}))
    lines = [
        "# Assemblies",
        "",
        f"{sum(map(passed, rows))} of {len(rows)} runs were completed without a finding of the audit.",
        "",
        f"Measured {dates} on {machines}, {busy}. Made by `python -m benchmarks.assembly`.",
        "Planning is wall-clock time with compiled kernels, shortcuts included. Makespans have the durations",
        "of the scenario's seed: one task at a time, and as planned; the bound of the paths is what no coordination of",
        "these paths can beat, among them arrivals of parts; the bound of load what no",
        "choice of robots and grips can beat at nominal durations, which those drawn may. In runs with stalls",
        f"every robot stands still at {stalls} random nodes for 1 to 20 s each. Times in seconds.",
        "",
        "| scenario | robots | steps | planning | one task at a time | as planned | below | bound of these paths | bound of load | nodes"
        " | edges | clean runs with stalls | their makespans | configurations audited |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
        *(_line(name, entry) for name, entry in results.items()),
    ]
    bad = [
        f"- {name}, seed {row['seed']}, {row['stalls']} stalls: {row['outcome']};"
        f" {'; '.join(row['violations'][:3])}"
        for name, entry in results.items()
        for row in entry["runs"]
        if not passed(row)
    ]
    return (
        "\n".join([*lines, *(["", "## What failed", "", *bad] if bad else [])]) + "\n"
    )


def _line(name: str, entry: Mapping[str, Any]) -> str:
    (plain,) = (row for row in entry["runs"] if not row["stalls"])
    stalled = [row for row in entry["runs"] if row["stalls"]]
    spans = [row["makespan_s"] for row in stalled]
    below = 1 - plain["makespan_s"] / entry["sequential_s"]
    bound = entry["load_bound_s"]
    cells = (
        name,
        len(entry["robots"]),
        entry["steps"],
        f"{entry['planning_s']:.1f}",
        f"{entry['sequential_s']:.1f}",
        f"{plain['makespan_s']:.1f}",
        f"{100 * below:.0f} %",
        f"{entry['path_bound_s']:.1f}",
        "" if bound is None else f"{bound:.1f}",
        entry["nodes"],
        entry["edges"],
        f"{sum(map(passed, stalled))} of {len(stalled)}",
        f"{min(spans):.1f} to {max(spans):.1f}" if spans else "",
        sum(row["configurations"] for row in entry["runs"]),
    )
    return "| " + " | ".join(map(str, cells)) + " |"


def main() -> int:
    """Measure what is missing, write the result files, tell whether all runs passed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenarios", type=Path, nargs="*", metavar="SCENARIO")
    parser.add_argument("--runs", type=int, default=RUNS, help="with stalls, of each")
    parser.add_argument("--stalls", type=int, default=20, help="of each robot in a run")
    parser.add_argument("--time", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.time is not None:
        made = plan_scenario(load_scenario(options.time), options.time.parent)
        sys.stdout.write(f"{sum(made.planning_s.values())}\n")
        return 0
    target = RESULTS / "assembly.json"
    results: dict[str, Any] = json.loads(target.read_text()) if target.exists() else {}
    for path in options.scenarios or sorted(SCENARIOS.glob("*.yaml")):
        known = results.get(path.stem, {})
        found = measure(path.resolve(), known, options.runs, options.stalls)
        results = dict(sorted({**results, path.stem: found}.items()))
        write_json(target, results)
        (RESULTS / "assembly.md").write_text(page(results), encoding="utf-8")
    rows = [row for entry in results.values() for row in entry["runs"]]
    sys.stderr.write(f"{sum(map(passed, rows))} of {len(rows)} runs passed\n")
    return 0 if all(map(passed, rows)) else 1


if __name__ == "__main__":
    sys.exit(main())

"""Ablations of the construction planner: each part is left out, and plans are compared.

    python -m benchmarks.construction.ablations                    # all of it, an hour of one core
    python -m benchmarks.construction.ablations --models tower wall
    python -m benchmarks.construction.ablations --report           # of what was measured so far

A part is left out by settings of the planner alone. What was measured is kept in
benchmarks/.measured/construction_ablations/, so that an interrupted run goes on where it was.
Writes construction_ablations.md to benchmarks/results/.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from statistics import mean
from typing import Any

from benchmarks.construction.case import (
    OutOfTimeError,
    case_problem,
    case_scenario,
    warm_up,
)
from benchmarks.machine import date_line, machine_line
from planning.construction.planner import plan_construction
from planning.construction.problem.settings import PlannerSettings
from planning.errors import ConstructionError

ROOT = Path(__file__).parents[2]
KEPT = ROOT / "benchmarks" / ".measured" / "construction_ablations"
RESULT = ROOT / "benchmarks" / "results" / "construction_ablations.md"

MODELS = ("tower", "wall", "well", "pavilion")
SEEDS = (0, 1, 2)
ROBOTS = 5
LIMIT = 900.0
"""Processor time after which a plan is given up [s]."""

PARTS = {
    "no lattice for the base": "paths/base_paths.py",
    "straight ways only": "all but straight ways in paths/direct_paths.py",
    "rounds planned once": "Rounds in planner.py",
    "no easy placement": "EasyPlacement in candidates.py",
}
"""Part of planning/construction/ left out by each variant."""

Row = dict[str, Any]


def variants() -> dict[str, PlannerSettings]:
    """Return the planner as it is, and with each part left out."""
    full = PlannerSettings()
    search, sub = full.search, full.subproblem
    return {
        "all": full,
        "no lattice for the base": replace(
            full, subproblem=replace(sub, rrt=sub.rrt._replace(drives=0))
        ),
        "straight ways only": replace(
            full, subproblem=replace(sub, rrt=sub.rrt._replace(stands=0))
        ),
        "rounds planned once": replace(full, search=replace(search, tries=1)),
        "no easy placement": replace(full, search=replace(search, parts=0, asked=0)),
    }


def measure(model: str, seed: int, settings: PlannerSettings) -> Row:
    """Plan a construction; return its makespan and the processor time that it took."""
    problem = case_problem(case_scenario(model, ROBOTS, seed))
    start = time.process_time()

    def watch(done: int, total: int) -> None:
        if time.process_time() > start + LIMIT and done < total:
            raise OutOfTimeError(f"{done} of {total} parts placed in {LIMIT:.0f} s")

    try:
        plan = plan_construction(problem, settings, watch)
    except (ConstructionError, OutOfTimeError) as error:
        return {"ok": False, "reason": str(error), "cpu_s": time.process_time() - start}
    return {
        "ok": True,
        "makespan_s": plan.makespan,
        "cpu_s": time.process_time() - start,
        "rewound": plan.rewound,
    }


def report(rows: dict[tuple[str, str, int], Row]) -> str:
    """Return the tables: means over the seeds that could be planned, and against the planner as it is."""
    lines = [
        "# Ablations of the construction planner",
        "",
        f"{machine_line()}; {date_line()}; {ROBOTS} robots; seeds "
        f"{', '.join(map(str, SEEDS))}; at most {LIMIT:.0f} s of processor time a plan. Made by "
        "`python -m benchmarks.construction.ablations`.",
        "",
        "Makespan and processor time are means over the seeds that were planned; changes are "
        "means of the ratios to the whole planner, seed by seed.",
        "",
        *(f"- {name}: without {part}" for name, part in PARTS.items()),
        "",
        "| model | variant | planned | makespan [s] | change | CPU [s] | change |",
        "|---|---|---|---|---|---|---|",
    ]
    for model, name in product(MODELS, variants()):
        own = {s: rows[model, name, s] for s in SEEDS if (model, name, s) in rows}
        good = {s: row for s, row in own.items() if row["ok"]}
        if not own:
            continue
        cells = [model, name, f"{len(good)} of {len(own)}"]
        for key in ("makespan_s", "cpu_s"):
            if not good:
                cells += ["", ""]
                continue
            ratios = [
                row[key] / rows[model, "all", s][key]
                for s, row in good.items()
                if rows.get((model, "all", s), {}).get("ok")
            ]
            cells += [f"{mean(row[key] for row in good.values()):.1f}"]
            cells += [f"{mean(ratios) - 1.0:+.1%}" if ratios else ""]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what has not been measured yet, and write the report."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", nargs="+", choices=MODELS, default=MODELS)
    parser.add_argument("--report", action="store_true", help="measure nothing")
    given = parser.parse_args(arguments)
    KEPT.mkdir(parents=True, exist_ok=True)
    warm = False
    rows: dict[tuple[str, str, int], Row] = {}
    for seed, model, (name, settings) in product(SEEDS, MODELS, variants().items()):
        kept = KEPT / f"{model}-{name.replace(' ', '-')}-{seed}.json"
        if not kept.exists() and not given.report and model in given.models:
            if not warm:
                warm_up()
                warm = True
            kept.write_text(json.dumps(measure(model, seed, settings)))
        if kept.exists():
            rows[model, name, seed] = json.loads(kept.read_text())
    RESULT.write_text(report(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())

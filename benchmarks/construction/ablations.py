"""Ablations of the search for paths: what finds them is left out, and plans are compared.

    python -m benchmarks.construction.ablations                    # all of it, an hour of one core
    python -m benchmarks.construction.ablations --models tower wall --seeds 2
    python -m benchmarks.construction.ablations --report           # of what was measured so far

Something is left out by settings of the planner alone. What was measured is kept in
benchmarks/.measured/construction_ablations/, so that an interrupted run goes on where it was.
Writes construction_ablations.md to benchmarks/results/.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from statistics import mean
from typing import Any
from unittest.mock import patch

from benchmarks.construction.case import (
    OutOfTimeError,
    case_problem,
    case_scenario,
    warm_up,
)
from benchmarks.machine import load_line
from benchmarks.store import Row, RowStore
from planning.construction.paths import rrt
from planning.construction.paths.bidirectional_search import grow_forests
from planning.construction.planner import plan_construction
from planning.construction.problem.settings import PlannerSettings, RrtSettings
from planning.errors import ConstructionError

ROOT = Path(__file__).parents[2]
KEPT = ROOT / "benchmarks" / ".measured" / "construction_ablations"
RESULT = ROOT / "benchmarks" / "results" / "construction_ablations.md"

TEAMS = {"tower": 5, "wall": 5, "well": 6, "pavilion": 8}
"""Robots that build each model."""

SEEDS = 5
"""Seeds of each, from 0 on."""

LIMIT = 600.0
"""Processor time after which a plan is given up [s]."""


def variants() -> Mapping[str, RrtSettings]:
    """Return the search for paths as it is shipped, and with something left out."""
    full = RrtSettings()
    return {
        "shipped": full,
        "RRT alone": full.rrt_alone(),
        "without RRT": full._replace(iterations=0, patience=0),
        "without roadmap": full._replace(drives=0, checks=0),
    }


def measure(model: str, seed: int, settings: RrtSettings) -> Row:
    """Plan a construction; return its makespan, the processor time, and who found the paths."""
    problem = case_problem(case_scenario(model, TEAMS[model], seed))
    full = PlannerSettings()
    effort = replace(full, subproblem=replace(full.subproblem, rrt=settings))
    start, load = time.process_time(), os.getloadavg()[0]
    row: Row = {"model": model, "seed": seed, "grown": 0, "load": load}

    def watch(done: float, total: float) -> None:
        if time.process_time() > start + LIMIT and done < total:
            raise OutOfTimeError(f"{done} of {total} parts placed in {LIMIT:.0f} s")

    def grow(*args: Any) -> Any:
        found = grow_forests(*args)
        row["grown"] += int(found[2] >= 0)
        return found

    try:
        with patch.object(rrt, "grow_forests", grow):
            plan = plan_construction(problem, effort, watch)
    except (ConstructionError, OutOfTimeError) as error:
        spent = time.process_time() - start
        return row | {"ok": False, "reason": str(error), "cpu_s": spent}
    spent = time.process_time() - start
    return row | {"ok": True, "makespan_s": plan.makespan, "cpu_s": spent}


def report(rows: Mapping[tuple[str, str, int], Row]) -> str:
    """Return the table: means over the seeds that every variant has planned."""
    first = next(iter(rows.values()))
    commits = ", ".join(sorted({row["commit"] for row in rows.values()}))
    names = tuple(variants())
    lines = [
        "# Who finds the paths of constructions",
        "",
        f"{first['machine']}; {first['date']}; program {commits}; "
        f"{load_line([(row['load'], row['load']) for row in rows.values()])}. Written by "
        "`python -m benchmarks.construction.ablations`.",
        "",
        "*Shipped*: straight ways first, then a roadmap with safe intervals (both ours), then the",
        "bi-directional space-time RRT of Hartmann et al. (IV-C) where these fail. *RRT alone*: the",
        "paper's search for every path, `planning.paths: rrt`. *Without RRT*, *without roadmap*: shipped,",
        "but for that. Shortcuts, retiming, choice of parts and robots are the same for all.",
        "",
        f"Means over the same seeds of all that planned them; at most {LIMIT:.0f} processor seconds a plan.",
        "**Grown**: searches in which the RRT found a path, also of placements that were dropped.",
        "",
        "| model | *m* | seeds | | " + " | ".join(names) + " |",
        "|---|---:|---:|---|" + "---:|" * len(names),
    ]
    for model, team in TEAMS.items():
        own = {
            name: {
                s: rows[model, name, s]
                for s in range(SEEDS)
                if (model, name, s) in rows
            }
            for name in names
        }
        good = {n: {s for s, r in own[n].items() if r["ok"]} for n in names}
        some = [good[n] for n in names if good[n]]
        if not some:
            continue
        same = sorted(set.intersection(*some))
        seeds = ", ".join(map(str, same))
        for what, key, digits in (
            ("makespan [s]", "makespan_s", 1),
            ("CPU [s]", "cpu_s", 1),
            ("grown", "grown", 1),
        ):
            cells = [
                f"{mean(own[n][s][key] for s in same):.{digits}f}" if good[n] else "-"
                for n in names
            ]
            lines.append(
                f"| {model} | {team} | {seeds} | {what} | {' | '.join(cells)} |"
            )
        cells = [f"{len(good[n])} of {len(own[n])}" for n in names]
        lines.append(f"| {model} | {team} | all | planned | {' | '.join(cells)} |")
    missing = [model for model in TEAMS if not any(k[0] == model for k in rows)]
    lines += ["", f"Not measured: {', '.join(missing)}."] if missing else []
    bad = [(k, row["reason"]) for k, row in rows.items() if not row["ok"]]
    lines += [""] if bad else []
    lines += [f"- {m}, {n}, seed {s}: {reason}" for (m, n, s), reason in bad]
    return "\n".join(lines) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what has not been measured yet, and write the report."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--models", nargs="+", choices=tuple(TEAMS), default=(*TEAMS,))
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--any-version", action="store_true")
    parser.add_argument("--report", action="store_true", help="measure nothing")
    given = parser.parse_args(arguments)
    store = RowStore(KEPT, ROOT, any_version=given.any_version)
    warm = False
    rows: dict[tuple[str, str, int], Row] = {}
    cases = product(range(SEEDS), TEAMS, variants().items())
    for seed, model, (name, settings) in cases:
        key = f"{model}-{name.replace(' ', '-')}-{seed}"
        row = store.load(key)
        wanted = model in given.models and seed < given.seeds and not given.report
        if row is None and wanted:
            if not warm:
                warm_up()
                warm = True
            sys.stderr.write(f"{key} ...\n")
            row = store.save(key, measure(model, seed, settings))
        if row is not None:
            rows[model, name, seed] = row
    if rows:
        # What was left out before stands below, with the commit that it was measured of.
        _, mark, before = RESULT.read_text(encoding="utf-8").partition("\n## ")
        RESULT.write_text(report(rows) + mark + before, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())

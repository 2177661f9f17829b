"""What the search for better choices brings, and how far plans are from the bound of load.

    python -m benchmarks.improvement [--seconds 60] [--seeds 0 1] [STRUCTURE ...]

Each LEGO structure is planned, improved for so many processor seconds, and both plans are ordered
and shortened as a run does. Writes benchmarks/results/improvement.json and .md; rows of earlier
runs stay where they are not measured again. Exits with 1 when a plan came out worse.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.machine import date_line, machine_line
from planning.errors import PlanInvariantError
from planning.motion.load_bound import load_bound_s
from scheduling.improvement.rated_plans import PlanRater
from scheduling.improvement.search import improve_plan
from twin.host.progress import StageWatch
from twin.planning.pipeline import (
    nominal_s,
    order_motions,
    plan_motions,
    planned_shortcuts,
    shorten,
)
from twin.scenario.file import load_scenario

RESULTS = Path(__file__).parent / "results" / "improvement.json"
FOLDER = Path("scenarios/lego")
STRUCTURES = (
    "cliff",
    "faucet",
    "stairs",
    "guitar",
    "vessel",
    "fish",
    "bridge",
    "rss",
    "chair",
)


def measure(structure: str, seed: int, seconds: float) -> dict[str, Any]:
    """Return the makespans of a structure without and with the search [s]."""
    file = FOLDER / f"{structure}.yaml"
    scenario = load_scenario(file).model_copy(update={"seed": seed})
    watch = StageWatch()
    first = plan_motions(scenario, file.parent, watch)
    work = first.work
    assert work is not None
    bound = load_bound_s(first.cell, work, first.task_plan, first.settings)
    rater = PlanRater(first.cell, work, first.settings)
    start = rater.rate_motions(first.task_plan, first.motion_plan)
    begin = time.process_time()
    tried = 0

    def count(done: float, total: float) -> None:
        nonlocal tried
        tried += done < total

    best = improve_plan(
        rater,
        work.problem,
        start,
        seconds=seconds,
        tries=0,
        seed=seed,
        clock=time.process_time,
        progress=count,
    )
    spent = time.process_time() - begin

    def final(plan: Any) -> float:
        tpg = order_motions(plan.motion_plan, watch)
        candidates = planned_shortcuts(scenario)
        shorter = shorten(tpg, first.settings, watch, candidates=candidates, seed=seed)
        return nominal_s(shorter)

    without = final(start)
    try:
        with_search = min(without, final(best)) if best is not start else without
    except PlanInvariantError:
        with_search = without
    return {
        "structure": structure,
        "seed": seed,
        "cpu_s": spent,
        "tries": tried,
        "rated_before_s": start.makespan_s,
        "rated_after_s": best.makespan_s,
        "before_s": without,
        "after_s": with_search,
        "load_bound_s": bound,
    }


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Return the rows as text for readers."""
    out = [
        "# A better choice of robots, objects, grips and supports",
        "",
        f"{machine_line()} {date_line()}",
        "",
        "Makespans at nominal durations, ordered and shortened; CPU: of the search. Gap: how far the makespan is",
        "above the bound of load.",
        "",
        "| structure | seed | CPU [s] | tries | before [s] | after [s] | gain [%] | bound [s] | gap before [%] | gap after [%] |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        before, after, bound = row["before_s"], row["after_s"], row["load_bound_s"]
        gaps = ["", ""]
        if bound:
            gaps = [f"{100 * (value / bound - 1):.0f}" for value in (before, after)]
        out.append(
            f"| {row['structure']} | {row['seed']} | {row['cpu_s']:.0f} | {row['tries']}"
            f" | {before:.2f} | {after:.2f} | {100 * (1 - after / before):.1f}"
            f" | {f'{bound:.1f}' if bound else ''} | {gaps[0]} | {gaps[1]} |"
        )
    gains = [100 * (1 - row["after_s"] / row["before_s"]) for row in rows]
    out += ["", f"Mean gain: {sum(gains) / len(gains):.1f} % of {len(gains)} plans."]
    return "\n".join(out) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure structures with seeds, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("structures", nargs="*", default=list(STRUCTURES))
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--results", type=Path, default=RESULTS)
    wanted = parser.parse_args(arguments)
    known: dict[tuple[str, int], dict[str, Any]] = {}
    if wanted.results.exists():
        for row in json.loads(wanted.results.read_text(encoding="utf-8")):
            known[row["structure"], row["seed"]] = row
    worse = False
    for seed in wanted.seeds:
        for structure in wanted.structures:
            row = measure(structure, seed, wanted.seconds)
            known[structure, seed] = row
            worse |= row["after_s"] > row["before_s"]
            rows = [known[key] for key in sorted(known, key=_place)]
            text = json.dumps(rows, indent=1) + "\n"
            wanted.results.write_text(text, encoding="utf-8")
            wanted.results.with_suffix(".md").write_text(table(rows), encoding="utf-8")
            sys.stdout.write(f"{row}\n")
            sys.stdout.flush()
    return 1 if worse else 0


def _place(key: tuple[str, int]) -> tuple[int, int]:
    return STRUCTURES.index(key[0]), key[1]


if __name__ == "__main__":
    sys.exit(main())

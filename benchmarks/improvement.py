"""What the search for better choices brings, and how far plans are from the bound of load.

    python -m benchmarks.improvement [--seconds 60] [--seeds 0 1 2 3] [STRUCTURE ...]

Each LEGO structure is planned, improved for so many processor seconds, and both plans are ordered
and shortened as a run does. Writes benchmarks/results/improvement.json and .md; rows of earlier
runs stay where they are not measured again. Exits with 1 when a plan came out worse.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterable, Sequence
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
    rater = PlanRater(first.cell, first.settings)
    start = rater.rate_motions(work, first.task_plan, first.motion_plan)
    begin = time.process_time()
    tried = 0

    def count(done: float, total: float) -> None:
        nonlocal tried
        tried += done < total

    best = improve_plan(
        rater,
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
    kept = best if with_search < without else start
    plan, settings = kept.task_plan, first.settings
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
        "load_bound_after_s": load_bound_s(first.cell, kept.work, plan, settings),
        "steps_moved": sum(a != b for a, b in enumerate(kept.work.order, start=1)),
    }


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Return the rows as text for readers."""
    out = [
        "# A better choice of robots, objects, grips, supports and the order of steps",
        "",
        f"{machine_line()} {date_line()}",
        "",
        "Makespans at nominal durations, ordered and shortened as a run does it. CPU: of the search, in seconds of the",
        "process, so that other work on the machine counts for little. Moved: steps that are not where they were. Gap: how far the",
        "makespan is above the bound of load, after the search that of the order of steps which was found.",
        "",
        "| structure | seed | CPU [s] | tries | before [s] | after [s] | gain [%] | moved | gap before [%] | gap after [%] |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        gaps = [f"{gap:.0f}" for gap in _gaps(row)] or ["", ""]
        out.append(
            f"| {row['structure']} | {row['seed']} | {row['cpu_s']:.0f} | {row['tries']}"
            f" | {row['before_s']:.2f} | {row['after_s']:.2f} | {_gain(row):.1f}"
            f" | {row['steps_moved']} | {gaps[0]} | {gaps[1]} |"
        )
    out += [
        "",
        "| structure | plans | mean gain [%] | CPU a try [s] |",
        "|---|---|---|---|",
    ]
    for structure in dict.fromkeys(row["structure"] for row in rows):
        own = [row for row in rows if row["structure"] == structure]
        a_try = sum(r["cpu_s"] for r in own) / sum(r["tries"] for r in own)
        gain = _mean(map(_gain, own))
        out.append(f"| {structure} | {len(own)} | {gain:.1f} | {a_try:.2f} |")
    worse = sum(row["after_s"] > row["before_s"] for row in rows)
    before, after = (_mean(_gaps(r)[k] for r in rows if _gaps(r)) for k in range(2))
    out += [
        "",
        f"Mean gain of {len(rows)} plans: {_mean(map(_gain, rows)):.1f} %; the gap to the bound of load"
        f" goes from {before:.0f} to {after:.0f} % in the mean. Worse than without: {worse}.",
    ]
    return "\n".join(out) + "\n"


def _gain(row: dict[str, Any]) -> float:
    """Return by how much a makespan became shorter [%]."""
    return float(100 * (1 - row["after_s"] / row["before_s"]))


def _gaps(row: dict[str, Any]) -> tuple[float, ...]:
    """Return how far a makespan is above the bound, before and after [%]; none without a bound."""
    bounds = row["load_bound_s"], row["load_bound_after_s"]
    if None in bounds:
        return ()
    makespans = row["before_s"], row["after_s"]
    return tuple(100 * (m / b - 1) for m, b in zip(makespans, bounds, strict=True))


def _mean(values: Iterable[float]) -> float:
    some = list(values)
    return sum(some) / len(some) if some else 0.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure structures with seeds, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("structures", nargs="*", default=list(STRUCTURES))
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2, 3])
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

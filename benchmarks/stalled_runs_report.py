"""The page about stalled runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


def report(results: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the page.

    Args:
        results: what was measured: scenario, plan (``built``, ``shortened``), entry.
    """
    entries = [entry for plans in results.values() for entry in plans.values()]
    runs = [row for entry in entries for row in entry["runs"]]
    passed = sum(
        row["outcome"] == "completed" and not row["violations"] for row in runs
    )
    stalls = sorted({row["stalls"] for row in runs if row["stalls"]})
    dates = sorted({entry["date"] for entry in entries if "date" in entry})
    machines = sorted({entry["machine"] for entry in entries if "machine" in entry})
    lines = [
        "# Runs with random stalls",
        "",
        f"{passed} of {len(runs)} runs were completed without a finding of the PyBullet audit.",
        "",
        f"Measured {' and '.join(dates)} on {'; '.join(machines)}.",
        "Plans are those of the scenario files, with the seeds below: as built, and after the",
        "search for an order and shortcuts. Runs without stalls have seed 0. In runs with stalls",
        f"every robot stands still at {' or '.join(map(str, stalls))} random nodes for 1 to 20 s"
        " each; seeds of",
        "durations and stalls are 0, 1, 2 and so on. Makespans are seconds, distances millimetres",
        "between robots: the clearance asked for is 1 mm. Made by"
        " `python -m benchmarks.stalled_runs`.",
        "",
        "| scenario | plan | seed of plan | robots | nodes | edges | runs without, with stalls"
        " | makespan without | with stalls, shortest to longest | violations | configurations"
        " audited | least distance |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for name, plans in results.items():
        lines += [_line(name, plan, entry) for plan, entry in plans.items()]
    bad = [
        f"- {name}, {row['plan']}, seed {row['seed']}, {row['stalls']} stalls:"
        f" {row['outcome']}; {'; '.join(row['violations'][:3])}"
        for name, plans in results.items()
        for entry in plans.values()
        for row in entry["runs"]
        if row["outcome"] != "completed" or row["violations"]
    ]
    if bad:
        lines += ["", "## What failed", "", *bad]
    return "\n".join(lines) + "\n"


def _line(name: str, plan: str, entry: Mapping[str, Any]) -> str:
    rows: Sequence[Mapping[str, Any]] = entry["runs"]
    plain = [row for row in rows if not row["stalls"]]
    stalled = [row["makespan_s"] for row in rows if row["stalls"]]
    least = [row["least_m"] for row in rows if row["least_m"] is not None]
    cells = [
        name,
        plan,
        entry["seed"],
        len(entry["robots"]),
        entry["nodes"],
        entry["type2_edges"],
        f"{len(plain)}, {len(stalled)}",
        f"{plain[0]['makespan_s']:.1f}" if plain else "",
        f"{min(stalled):.1f} to {max(stalled):.1f}" if stalled else "",
        sum(len(row["violations"]) for row in rows),
        sum(row["configurations"] for row in rows),
        f"{1e3 * min(least):.2f}" if least else "not close",
    ]
    return "| " + " | ".join(str(cell) for cell in cells) + " |"

"""Summary at the head of construction.md: aims of the method, and whether they are met."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.construction.rows import (
    Spread,
    compared,
    computing,
    methods,
    models_of,
    planned,
    spread,
)
from benchmarks.construction.tables import paper_total
from benchmarks.store import Row

_TENTH = 0.1
_EFFICIENCY = 0.8
_QUICKER = 3.0
_SEVERAL = 5
"""One robot is in nobody's way; growth from so many on is that of the search."""


def summary(rows: Sequence[Row]) -> list[str]:
    """Return a list of aims with what was measured, as lines of Markdown."""
    out = ["## In short", ""]
    out += [*_computation(rows), *_growth(rows), *_baseline(rows), *_wall(rows)]
    return [*out, *_safety(rows)]


def _computation(rows: Sequence[Row]) -> list[str]:
    """Say how many rows take at most a tenth of the paper's computation time."""
    shares = {}
    for model, robots, found in planned(rows):
        paper = paper_total(model, robots)
        if paper is not None:
            total = spread(found, "cpu_s", "total").mean
            shares[f"{model} with {robots}"] = total / paper
    if not shares:
        return []
    met = sum(share <= _TENTH for share in shares.values())
    worst = max(shares, key=lambda case: shares[case])
    return [
        f"- Computation at most a tenth of the paper's: {met} of {len(shares)} rows; the most is"
        f" {100 * shares[worst]:.1f} % ({worst})."
    ]


def _growth(rows: Sequence[Row]) -> list[str]:
    """Say how computation grows with the size of the team."""
    grown = []
    for model in models_of(rows):
        times = {
            m: spread(found, "cpu_s", "total").mean
            for name, m, found in planned(rows)
            if name == model
        }
        if len(times) > 1:
            high = max(times)
            by = [
                f"{times[high] / times[low]:.1f} times from {low} to {high} robots"
                for low in sorted({min(times), _SEVERAL} & times.keys())
                if low < high
            ]
            grown.append(f"{model} {', '.join(by)}")
    return [f"- Growth of computation: {'; '.join(grown)}."] if grown else []


def _baseline(rows: Sequence[Row]) -> list[str]:
    """Say how the method does against its own fixed-time baseline."""
    longer, cells, tower = [], 0, None
    for model, robots, _, fixed, own in compared(rows):
        cells += 1
        if spread(own, "makespan_s").mean > spread(fixed, "makespan_s").mean:
            longer.append(f"{model} with {robots}")
        if (model, robots) == ("tower", 10):
            times = [Spread(tuple(map(computing, each))).mean for each in (fixed, own)]
            tower = times[0] / times[1]
    if not cells:
        return []
    words = f"except {', '.join(longer)}" if longer else "in every case"
    out = [
        f"- Plans are no longer than those with actions of a fixed duration, {words}"
        f" ({cells} cases)."
    ]
    if tower is not None:
        out.append(
            f"- Tower with 10 robots: {tower:.1f} times as quick to compute as the baseline"
            f" (aim: {_QUICKER:g})."
        )
    return out


def _wall(rows: Sequence[Row]) -> list[str]:
    """Say what more robots bring at the wall."""
    alone = methods(rows, "wall", 1)
    if not alone:
        return []
    cells = []
    for model, robots, found in planned(rows):
        if model == "wall" and 1 < robots <= 5:
            own = spread(found, "makespan_s").mean
            rate = spread(alone, "makespan_s").mean / own
            cells.append(f"{rate:.2f} with {robots} ({rate / robots:.2f} each)")
    if not cells:
        return []
    return [
        f"- Wall, speed-up: {', '.join(cells)}; the aim is {_EFFICIENCY:g} for each robot of up"
        " to five."
    ]


def _safety(rows: Sequence[Row]) -> list[str]:
    """Say what the checks made of the plans and runs."""
    plans = [row for row in rows if row["ok"]]
    passed = sum(not row["fine"]["faults"] for row in plans)
    runs = [run for row in plans for run in row.get("runs", [])]
    clean = sum(run["outcome"] == "completed" and not run["violations"] for run in runs)
    failed = sum(not row["ok"] for row in rows if row["what"] == "method")
    out = [
        f"- Fine check: {passed} of {len(plans)} plans passed, those of the baseline included;"
        f" {clean} of {len(runs)} audited runs were clean."
    ]
    if failed:
        out.append(f"- **Not planned**: {failed}; the reasons are at the end.")
    return out

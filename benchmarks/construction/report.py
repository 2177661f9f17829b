"""construction.md, construction.json and the charts: our figures beside those of the paper.

Summary at the head of construction.md: aims of the method, and whether they are met.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from benchmarks.construction import tables
from benchmarks.construction.charts import draw_speed_ups, draw_times
from benchmarks.construction.gantt import Chart, draw_schedules
from benchmarks.construction.paper import SEEDS
from benchmarks.construction.rows import (
    Spread,
    best_baseline,
    compared,
    computing,
    methods,
    models_of,
    planned,
    spread,
    teams_of,
)
from benchmarks.construction.tables import paper_total
from benchmarks.store import Row
from planning.files import replace_atomically
from twin.host.atomic_files import write_json

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


NAME = "construction"

SCHEDULES = {
    "tower": 7,
    "wall": 5,
    "well": 6,
    "pavilion": 8,
    "handover": 4,
    "gatehouse": 12,
}
"""Teams whose schedules are drawn (Figs. 8 to 11), where they were measured."""


def write_report(folder: Path, rows: Sequence[Row]) -> Path:
    """Write text, rows and charts, and return the path of the text.

    Args:
        folder: of the files, which are replaced.
        rows: everything that was measured.

    Raises:
        OutputError: a file cannot be written.
    """
    kept = [row if row["seed"] == 0 else _without_schedule(row) for row in rows]
    write_json(folder / f"{NAME}.json", {"cases": kept})
    parts = [_head(rows)]
    if any(row["what"] == "method" and row["ok"] for row in rows):
        draw_speed_ups(folder / f"{NAME}-speed-up.png", rows)
        draw_times(folder / f"{NAME}-time.png", rows)
        parts.append(summary(rows))
        parts += [
            [*tables.speed_ups(rows), "", _picture("speed-up", "Speed-up against m")],
            [*tables.computation(rows), "", _picture("time", "Computation time")],
        ]
        if any(row["what"] == "baseline" for row in rows):
            parts += [tables.against_fixed(rows), tables.durations(rows)]
        parts += [tables.checks(rows), list(_schedules(folder, rows))]
    parts.append(tables.not_planned(rows))
    target = folder / f"{NAME}.md"
    with replace_atomically(target) as temporary:
        text = "\n\n".join("\n".join(part) for part in parts if part)
        temporary.write_text(text + "\n", encoding="utf-8")
    return target


def _head(rows: Sequence[Row]) -> list[str]:
    dates = sorted({row["date"] for row in rows})
    loads = [float(row["load"]) for row in rows]
    found = {
        model: {
            r["seed"] for r in rows if r["model"] == model and r["what"] == "method"
        }
        for model in models_of(rows)
    }
    seeds = "; ".join(
        f"{model}: {min(s)} to {max(s)} of {SEEDS} planned"
        for model, s in found.items()
        if s
    )
    return [
        "# The experiments of Hartmann et al.",
        "",
        f"Measured {' to '.join(dict.fromkeys([dates[0], dates[-1]]))} on"
        f" {' and '.join(sorted({row['machine'] for row in rows}))}; program"
        f" {', '.join(sorted({row['commit'] for row in rows}))}; load of the machine"
        f" {min(loads):.1f} to {max(loads):.1f}. Written by `make paper`.",
        f"Seeds: {seeds}. Figures are mean ± sample standard deviation over the seeds that each row says",
        "it has.",
        "",
        "**Not the paper's models.** They are not public: these are designs of our own of the same classes",
        "with as many parts, robots of primitives, and speeds of our own. Seconds of makespan can",
        "therefore not be compared, shares with care. The paper computed on one core of an i7-8565U.",
        "",
        "One plan was made after another in one process; kernels were compiled and loaded before.",
    ]


def _schedules(folder: Path, rows: Sequence[Row]) -> Iterator[str]:
    yield from ["## Schedules (Figs. 8 to 11)", ""]
    yield "Plans of the first seed, up to the end of the last skill of each robot and its way out."
    for model in models_of(rows):
        first = {
            m: r
            for m in teams_of(rows, model)
            for r in methods(rows, model, m)
            if r["seed"] == 0
        }
        if not first:
            continue
        robots = SCHEDULES[model] if SCHEDULES[model] in first else max(first)
        charts = [Chart("the method", first[robots])]
        best = best_baseline(rows, model, robots)
        if best is not None:
            row = next(r for r in best[1] if r["seed"] == 0)
            charts.append(Chart(f"actions of a fixed duration, T = {best[0]:g} s", row))
        title = f"{model}, {robots} robots"
        draw_schedules(folder / f"{NAME}-{model}.png", charts, title)
        yield from ["", f"![Schedule: {title}]({NAME}-{model}.png)"]


def _without_schedule(row: Row) -> Row:
    return {key: value for key, value in row.items() if key != "schedule"}


def _picture(name: str, words: str) -> str:
    return f"![{words}]({NAME}-{name}.png)"

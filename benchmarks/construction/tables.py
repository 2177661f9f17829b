"""The tables of construction.md, as lines of Markdown."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.construction.paper import CASE_STUDIES, DURATIONS, TABLE_I, TABLE_II
from benchmarks.construction.rows import (
    Spread,
    baselines,
    cases,
    compared,
    computing,
    methods,
    planned,
    spread,
)
from benchmarks.store import Row

Lines = list[str]


def speed_ups(rows: Sequence[Row]) -> Lines:
    """Return makespans against the size of the team, and what the longest pile allows."""
    out = [
        "## Speed-up (Figs. 6 and 13)",
        "",
        "Makespan of one robot over that of *m*, means over the seeds. The paper shows its speed-ups as",
        "pictures only. **Limit**: parts of the longest pile are placed one after another, however many",
        "robots there are; their placings alone, at nominal duration, bound the speed-up.",
        "",
        "| model | parts | longest pile | *m* | seeds | makespan [s] | speed-up | a robot | limit | taken back |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for model, robots, found in planned(rows):
        alone = spread(methods(rows, model, 1), "makespan_s")
        own = spread(found, "makespan_s")
        limit = alone.mean / float(found[0]["chain_s"])
        rate = alone.mean / own.mean
        out.append(
            f"| {model} | {found[0]['parts']} | {found[0]['longest_chain']} | {robots} "
            f"| {len(found)} | {own.text()} | **{_number(rate, 2)}** "
            f"| {_number(rate / robots, 2)} | {_number(limit, 1)} "
            f"| {spread(found, 'rewound').mean:.1f} |"
        )
    return out


def computation(rows: Sequence[Row]) -> Lines:
    """Return computation times by component beside those of the paper."""
    out = [
        "## Computation time (Tables I and II, Figs. 7 and 12)",
        "",
        "Processor seconds in all threads, from the scenario to the plan; post-processing is shortcuts and",
        "retiming of paths. The paper's were measured on another machine.",
        "",
        "| model | *m* | seeds | checks | keyframes | paths | post-processing | other | **total** | wall clock "
        "| of *m* = 1 | paper: of *m* = 1 | a part | paper | of the paper's |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for model, robots, found in planned(rows):
        alone = spread(methods(rows, model, 1), "cpu_s", "total").mean
        total = spread(found, "cpu_s", "total")
        parts = [
            spread(found, "cpu_s", name).text(2)
            for name in ("checks", "keyframes", "path", "postprocessing", "other")
        ]
        paper = paper_total(model, robots)
        share = "-" if paper is None else f"{100 * total.mean / paper:.1f} %"
        first = paper_total(model, 1)
        growth = "-" if paper is None or first is None else f"{paper / first:.1f}"
        out.append(
            f"| {model} | {robots} | {len(found)} | {' | '.join(parts)} "
            f"| **{total.text()}** | {spread(found, 'wall_s', 'total').text()} "
            f"| {_number(total.mean / alone, 1)} | {growth} "
            f"| {total.mean / float(found[0]['parts']):.2f} "
            f"| {'-' if paper is None else f'{paper:.0f}'} | {share} |"
        )
    return out


def against_fixed(rows: Sequence[Row]) -> Lines:
    """Return the method beside the baseline with the best T, on the same seeds."""
    out = [
        "## Against actions of a fixed duration (V-B5, Table II, Fig. 11)",
        "",
        "The same decomposition, keyframes and paths, but every skill begins a multiple of T after the",
        "one before. T is the one of five whose plan was the shortest for the first seed. Processor",
        "seconds without the checks, which are the same for both.",
        "",
        "| model | *m* | seeds | T [s] | makespan, fixed [s] | here [s] | fixed / here | computing, fixed [s] "
        "| here [s] | **fixed / here** | paper |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for model, robots, duration, fixed, own in compared(rows):
        spans = spread(fixed, "makespan_s"), spread(own, "makespan_s")
        times = (
            Spread(tuple(map(computing, fixed))),
            Spread(tuple(map(computing, own))),
        )
        key = (model, robots)
        paper = "-"
        if key in TABLE_II:
            paper = f"{TABLE_II[key].total / TABLE_I[key].total:.2f}"
        out.append(
            f"| {model} | {robots} | {len(own)} | {duration:g} | {spans[0].text()} "
            f"| {spans[1].text()} | **{spans[0].mean / spans[1].mean:.2f}** "
            f"| {times[0].text()} | {times[1].text()} "
            f"| **{times[0].mean / times[1].mean:.2f}** | {paper} |"
        )
    return out


def durations(rows: Sequence[Row]) -> Lines:
    """Return the baseline's plans with each of the five T, for the first seed."""
    out = [
        "### The five values of T, first seed",
        "",
        "Makespan [s] and, in parentheses, processor seconds.",
        "",
        "| model | *m* | here | "
        + " | ".join(f"T = {t:g} s" for t in DURATIONS)
        + " |",
        "|---|---:|---:|" + "---:|" * len(DURATIONS),
    ]
    for model, robots in cases(rows):
        tried = baselines(rows, model, robots)
        if not tried:
            continue
        own = [r for r in methods(rows, model, robots) if r["seed"] == 0]
        cells = [_first(own)]
        cells += [
            _first([r for r in tried.get(t, []) if r["seed"] == 0]) for t in DURATIONS
        ]
        out.append(f"| {model} | {robots} | {' | '.join(cells)} |")
    return out


def checks(rows: Sequence[Row]) -> Lines:
    """Return the results of checks, graphs and runs of the plans."""
    out = [
        "## Checks and execution",
        "",
        "Every plan, and every plan of the baseline, goes through the fine check: motions, modes, poses and",
        "order worked out anew, distances at every moment, by pinocchio",
        "and coal. The plan of the first seed is executed under its temporal plan graph with random",
        "durations of skills, once as it is and then with five stalls of 1 to 20 s for every robot, and",
        "audited. Makespans here include the last way HOME.",
        "",
        "| model | *m* | fine check passed | least distance: robots [mm] | others [mm] | planned [s] "
        "| under its graph [s] | nodes | edges | graph [s] | runs clean | stalled runs clean |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for model, robots, found in planned(rows):
        good = sum(not r["fine"]["faults"] for r in found)
        least = [
            min(float(r["fine"][key]) for r in found)
            for key in ("least_robots_m", "least_others_m")
        ]
        runs = [run for r in found for run in r["runs"]]
        clean = [
            [
                run["outcome"] == "completed" and not run["violations"]
                for run in runs
                if bool(run["stalls"]) == stalled
            ]
            for stalled in (False, True)
        ]
        robots_mm = "-" if least[0] > 100 else f"{least[0] * 1e3:.1f}"
        out.append(
            f"| {model} | {robots} | {good} of {len(found)} | {robots_mm} "
            f"| {least[1] * 1e3:.1f} | {spread(found, 'tpg', 'planned_s').text()} "
            f"| {spread(found, 'tpg', 'executed_s').text()} "
            f"| {spread(found, 'tpg', 'nodes').mean:.0f} "
            f"| {spread(found, 'tpg', 'edges').mean:.0f} "
            f"| {spread(found, 'tpg', 'cpu_s').text()} "
            f"| {_passed(clean[0])} | {_passed(clean[1])} |"
        )
    fixed = [r for r in rows if r["what"] == "baseline" and r["ok"] and "fine" in r]
    if fixed:
        good = sum(not r["fine"]["faults"] for r in fixed)
        out += ["", f"Of the baseline's plans {good} of {len(fixed)} passed."]
    return out


def not_planned(rows: Sequence[Row]) -> Lines:
    """Return the cases that were not planned, with reasons, and the faults that were found."""
    out = []
    for row in rows:
        what = f"{row['model']}, {row['robots']} robots, seed {row['seed']}"
        if row["what"] == "baseline":
            what += f", fixed T = {row['duration_s']:g} s"
        if not row["ok"]:
            spent = row["cpu_s"]["total"]
            out.append(f"- {what}: {row['reason']} ({spent:.0f} s of computing)")
            continue
        out += [f"- {what}: fine check: {f}" for f in row["fine"]["faults"][:3]]
        for run in row.get("runs", []):
            if run["outcome"] != "completed" or run["violations"]:
                bad = "; ".join(run["violations"][:2])
                out.append(f"- {what}: run {run['outcome']}: {bad}")
    if not out:
        return []
    return ["## Not planned, or not clean", "", "Left out of all tables:", "", *out]


def paper_total(model: str, robots: int) -> float | None:
    """Return the paper's computation time, None where it has none [s]."""
    known = TABLE_I.get((model, robots))
    return known.total if known else CASE_STUDIES.get((model, robots))


def _first(rows: Sequence[Row]) -> str:
    if not rows:
        return "-"
    row = rows[0]
    if not row["ok"]:
        return f"none ({row['cpu_s']['total']:.0f})"
    return f"{row['makespan_s']:.1f} ({computing(row):.1f})"


def _passed(runs: Sequence[bool]) -> str:
    return f"{sum(runs)} of {len(runs)}" if runs else "-"


def _number(value: float, digits: int) -> str:
    return "-" if value != value else f"{value:.{digits}f}"

"""The tables of apex-mr.md, as lines of Markdown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks import apex_mr_paper as paper
from twin.comparison.chart import mean, percent, spread
from twin.comparison.comparison import BASELINES, TOTAL
from twin.run.policies import (
    ASYNCHRONOUS,
    ASYNCHRONOUS_SHORTCUTS,
    SEQUENTIAL,
    SYNCHRONOUS,
    SYNCHRONOUS_SHORTCUTS,
    SYNCHRONOUS_TPG,
)


@dataclass(frozen=True)
class Measured:
    """One scenario.

    Attributes:
        figures: the content of ``compare.json``.
        robots: their number.
        candidates: shortcuts tried on each plan.
        date: of the last measurement.
    """

    figures: Mapping[str, Mapping[str, Any]]
    robots: int
    candidates: int
    date: str


def averages(lego: Mapping[str, Measured]) -> list[str]:
    """Return the averages of Section V-A, ours beside the paper's."""

    def below(key: str, policy: str, other: str) -> list[float]:
        """Return by how many percent a policy is below another one, structure by structure."""
        return [
            100 * (1 - _ratio(one.figures[policy][key], one.figures[other][key]))
            for one in lego.values()
        ]

    def planned(policy: str, other: str) -> list[float]:
        return [
            100
            * (
                1
                - _ratio(
                    one.figures[policy]["planning_s"][TOTAL],
                    one.figures[other]["planning_s"][TOTAL],
                )
            )
            for one in lego.values()
        ]

    best, slots = ASYNCHRONOUS_SHORTCUTS, SYNCHRONOUS_SHORTCUTS
    rows = [
        (
            f"{best}: makespan below {SEQUENTIAL}",
            paper.MAKESPAN_BELOW_SEQUENTIAL,
            below("makespan_s", best, SEQUENTIAL),
        ),
        (
            f"{best}: wait below {SEQUENTIAL}",
            paper.WAIT_BELOW_SEQUENTIAL,
            below("wait_s", best, SEQUENTIAL),
        ),
        (
            f"{slots}: makespan below {SYNCHRONOUS}",
            paper.SYNCHRONOUS_MAKESPAN_SAVED,
            below("makespan_s", slots, SYNCHRONOUS),
        ),
        (
            f"{slots}: wait below {SYNCHRONOUS}",
            paper.SYNCHRONOUS_WAIT_SAVED,
            below("wait_s", slots, SYNCHRONOUS),
        ),
        (
            f"{best}: makespan below {slots}",
            paper.MAKESPAN_BELOW_SYNCHRONOUS_TPG,
            below("makespan_s", best, slots),
        ),
        (
            f"{ASYNCHRONOUS}: planning below {SYNCHRONOUS} (without its TPG)",
            paper.PLANNING_BELOW_SYNCHRONOUS,
            planned(ASYNCHRONOUS, SYNCHRONOUS),
        ),
    ]
    counted = f"{len(lego)} of {len(paper.STRUCTURES)} structures"
    out = [
        f"## Averages over {counted} (Section V-A)",
        "",
        "| | paper [%] | here [%] | least | most |",
        "|---|---:|---:|---:|---:|",
    ]
    for what, theirs, ours in rows:
        out.append(
            f"| {what} | {theirs:.0f} | **{np.mean(ours):.1f}** "
            f"| {min(ours):.1f} | {max(ours):.1f} |"
        )
    return [
        *out,
        "",
        "Each structure counts as much as any other; within one, means over the seeds are compared.",
        "Our synchronous plan reuses the paths of the sequential one wherever nobody is in the way,",
        "the paper's is planned anew: so there is less planning to save here.",
    ]


def quality(measured: Mapping[str, Measured]) -> list[str]:
    """Return makespan and wait of every policy, with their bounds."""
    head = "Cells with more robots" if set(measured) <= set(paper.TABLE_I) else "Plans"
    out = [
        f"## {head}: makespan and wait (Fig. 7)",
        "",
        "| | policy | makespan [s] | of sequential | bound: straight [s] | bound: tasks [s]"
        " | wait [s] | of sequential |",
        "|---|---|---:|---:|---:|---:|---:|---:|",
    ]
    for name, one in measured.items():
        for policy, row in one.figures.items():
            cells = (
                name if policy == SEQUENTIAL else "",
                policy,
                spread(row["makespan_s"]),
                percent(row["relative_makespan"]),
                mean(row["straight_line_s"]),
                mean(row["critical_path_s"]),
                spread(row["wait_s"]),
                percent(row["relative_wait"]),
            )
            out.append(f"| {' | '.join(cells)} |")
    return [
        *out,
        "",
        "Bounds: what the robot with most to do would need on straight joint lines without ever",
        "waiting (with shortcuts: past HOME), and the longest path through the nodes and the",
        "dependencies of tasks alone. Wait is summed over robots, each until its own last node.",
    ]


def planning(lego: Mapping[str, Measured]) -> list[str]:
    """Return the planning times of Table II, ours beside the paper's."""
    out = [
        "## Planning time (Table II, Fig. 8)",
        "",
        "| structure | | task [s] | motion [s] | TPG [s] | total [s] | of the paper's | shortcut [s] |",
        "|---|---|---:|---:|---:|---:|---:|---:|",
    ]
    for name, one in lego.items():
        theirs = paper.TABLE_II[name]
        out.append(
            f"| {name}, {theirs.bricks} | paper, APEX-MR | {theirs.task:.1f} "
            f"| {theirs.motion:.1f} | {theirs.tpg:.1f} | {theirs.total:.1f} | "
            f"| {theirs.shortcut:.0f} |"
        )
        out.append(
            _ours(one, ASYNCHRONOUS_SHORTCUTS, "here, asynchronous", theirs.total)
        )
        out.append(
            f"| | paper, synchronous | {theirs.synchronous_task:.1f} "
            f"| {theirs.synchronous_motion:.1f} | {theirs.synchronous_tpg:.1f} "
            f"| {theirs.synchronous_total:.1f} | | {theirs.shortcut:.0f} |"
        )
        total = theirs.synchronous_total
        out.append(_ours(one, SYNCHRONOUS_SHORTCUTS, "here, synchronous", total))
    return [
        *out,
        "",
        "Task planning is the assembly sequence (where the scenario gives only the finished structure)",
        "and who does what; motion planning of the synchronous plan includes the slots. Total is without",
        "shortcuts, as in the paper, whose shortcut column is a budget of time. The paper prints 9.2 s",
        "as the total of the guitar; its parts add up to 39.2 s.",
    ]


def _ours(one: Measured, policy: str, label: str, theirs_s: float) -> str:
    spent = one.figures[policy]["planning_s"]
    task = _sum_of(spent, "sequence", "assignment")
    motion = _sum_of(spent, "motion", "synchronous")
    tpg = _sum_of(spent, "tpg")
    total = _sum_of(spent, "sequence", "assignment", "motion", "synchronous", "tpg")
    share = f"{100 * total['mean'] / theirs_s:.1f} %"
    cells = [spread(value, 2) for value in (task, motion, tpg, total)]
    shortcut = spread(_sum_of(spent, "shortcut"), 2)
    return f"| | {label} | {' | '.join(cells)} | {share} | {shortcut} |"


def baselines(lego: Mapping[str, Measured]) -> list[str]:
    """Return how near the baselines are to straight lines."""
    out = [
        "## Baselines against straight lines",
        "",
        "| structure | sequential | synchronous |",
        "|---|---:|---:|",
    ]
    for name, one in lego.items():
        cells = [
            f"{max(one.figures[policy]['straight_line_ratio']['per_seed']):.3f}"
            for policy in BASELINES
        ]
        out.append(f"| {name} | {' | '.join(cells)} |")
    return [
        *out,
        "",
        "Makespan over that of the same plan with every transit a straight joint line, the greatest of",
        "all seeds: no policy wins against detours of another.",
    ]


def cells(cells: Mapping[str, Measured]) -> list[str]:
    """Return the rows of Table I, ours beside the paper's."""
    out = [
        "## TPG construction with more than two robots (Table I, Appendix D)",
        "",
        "| cell | | robots | duration of the motion plan [s] | TPG construction [s] |",
        "|---|---|---|---:|---:|",
    ]
    for name, one in cells.items():
        theirs = paper.TABLE_I[name]
        base, built = (
            (SEQUENTIAL, ASYNCHRONOUS)
            if name == "assembly"
            else (SYNCHRONOUS, SYNCHRONOUS_TPG)
        )
        ours = one.figures
        out += [
            f"| {name} | paper | {theirs.robots} | {theirs.duration_s:.0f} "
            f"| {theirs.tpg_s:.0f} |",
            f"| | here | {one.robots} | {spread(ours[base]['makespan_s'])} "
            f"| {spread(ours[built]['planning_s']['tpg'], 2)} |",
        ]
    return [
        *out,
        "",
        "The assembly is planned in turns, the others in slots, as in the paper. Cells and parts are",
        "designs of our own.",
    ]


def _ratio(value: Mapping[str, Any], other: Mapping[str, Any]) -> float:
    return float(value["mean"]) / float(other["mean"]) if other["mean"] > 0 else 1.0


def _sum_of(spent: Mapping[str, Any], *stages: str) -> dict[str, Any]:
    """Return mean and spread of the sum of some stages."""
    rows = [spent[stage]["per_seed"] for stage in stages if stage in spent]
    sums = np.sum(rows, axis=0)
    return {
        "mean": float(np.mean(sums)),
        "std": float(np.std(sums, ddof=1)) if len(sums) > 1 else None,
    }

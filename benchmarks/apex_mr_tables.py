"""The tables of apex-mr.md, as lines of Markdown."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks import apex_mr_paper as paper
from twin.runs.policies import (
    ASYNCHRONOUS,
    ASYNCHRONOUS_SHORTCUTS,
    SEQUENTIAL,
    SYNCHRONOUS,
    SYNCHRONOUS_SHORTCUTS,
    SYNCHRONOUS_TPG,
)
from twin.studies.comparison import BASELINES
from twin.studies.report.comparison_chart import mean, percent, spread

JOINTLY = {
    SYNCHRONOUS: "synchronous, joint",
    SYNCHRONOUS_TPG: "synchronous, joint + TPG",
    SYNCHRONOUS_SHORTCUTS: "synchronous, joint + TPG + shortcuts",
}
"""What policies of plans in slots are called here where all transits of a slot are planned as one
robot, as the paper does."""

PUBLISHED = "published/"
"""What names of published tasks begin with here."""


@dataclass(frozen=True)
class Measured:
    """One scenario.

    Attributes:
        figures: the content of ``compare.json``, with the policies of ``JOINTLY``.
        robots: their number.
        candidates: shortcuts tried on each plan.
        date: of the last measurement.
        commits: of the program, of all measurements.
        loads: of the machine, before and after each measurement.
        slots: slots of the first seed's plan and those that are planned jointly, first as the
            paper does, then by default; empty where that was not counted.
    """

    figures: Mapping[str, Mapping[str, Any]]
    robots: int
    candidates: int
    date: str
    commits: tuple[str, ...] = ()
    loads: tuple[tuple[float, float], ...] = ()
    slots: tuple[int, ...] = ()


_TASK, _SLOTS = ("sequence", "assignment"), ("synchronous",)
_TURNS = ("motion", "tpg")


def averages(measured: Mapping[str, Measured], what: str) -> list[str]:
    """Return the averages of Section V-A, ours beside the paper's.

    Args:
        measured: over which they are.
        what: they are.
    """

    def below(key: str, policy: str, other: str) -> list[float]:
        """Return by how many percent a policy is below another one, structure by structure."""
        return [
            100 * (1 - _ratio(one.figures[policy][key], one.figures[other][key]))
            for one in measured.values()
        ]

    def planned(other: str, own: Sequence[str], theirs: Sequence[str]) -> list[float]:
        """Return by how much stages of the asynchronous plan are below those of another one."""
        shares = [
            _ratio(
                _sum_of(one.figures[ASYNCHRONOUS]["planning_s"], *own),
                _sum_of(one.figures[other]["planning_s"], *theirs),
            )
            for one in measured.values()
        ]
        return [100 * (1 - share) for share in shares]

    def both(key: str, policy: str, other: str) -> list[list[float]]:
        """Return the same for slots as in the paper, and for those of ours."""
        return [
            below(key, names.get(policy, policy), names.get(other, other))
            for names in (JOINTLY, {})
        ]

    best, slots = ASYNCHRONOUS_SHORTCUTS, SYNCHRONOUS_SHORTCUTS
    joint, ours = JOINTLY[SYNCHRONOUS], (*_TASK, "motion", *_SLOTS)
    rows = [
        (
            f"{best}: makespan below {SEQUENTIAL}",
            paper.MAKESPAN_BELOW_SEQUENTIAL,
            [below("makespan_s", best, SEQUENTIAL)],
        ),
        (
            f"{best}: wait below {SEQUENTIAL}",
            paper.WAIT_BELOW_SEQUENTIAL,
            [below("wait_s", best, SEQUENTIAL)],
        ),
        (
            f"{best}: makespan below {SYNCHRONOUS}",
            paper.MAKESPAN_BELOW_SYNCHRONOUS,
            both("makespan_s", best, SYNCHRONOUS),
        ),
        (
            f"{slots}: makespan below {SYNCHRONOUS}",
            paper.SYNCHRONOUS_MAKESPAN_SAVED,
            both("makespan_s", slots, SYNCHRONOUS),
        ),
        (
            f"{slots}: wait below {SYNCHRONOUS}",
            paper.SYNCHRONOUS_WAIT_SAVED,
            both("wait_s", slots, SYNCHRONOUS),
        ),
        (
            f"{best}: makespan below {slots}",
            paper.MAKESPAN_BELOW_SYNCHRONOUS_TPG,
            both("makespan_s", best, slots),
        ),
        (
            f"{ASYNCHRONOUS}: planning below {SYNCHRONOUS} (without its TPG)",
            paper.PLANNING_BELOW_SYNCHRONOUS,
            [
                planned(joint, (*_TASK, *_TURNS), (*_TASK, *_SLOTS)),
                planned(SYNCHRONOUS, (*_TASK, *_TURNS), ours),
            ],
        ),
        (
            f"{ASYNCHRONOUS}: motions and TPG below motions of {SYNCHRONOUS}",
            paper.motions_below_synchronous(),
            [
                planned(joint, _TURNS, _SLOTS),
                planned(SYNCHRONOUS, _TURNS, ("motion", *_SLOTS)),
            ],
        ),
    ]
    counted = f"{len(measured)} of {len(paper.STRUCTURES)} {what}"
    out = [
        f"## Averages over {counted} (Section V-A)",
        "",
        "| | paper [%] | here [%] | least | most | slots that reuse paths [%] | least | most |",
        "|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for text, theirs, columns in rows:
        cells = [
            f"**{np.mean(values):.1f}** | {min(values):.1f} | {max(values):.1f}"
            for values in columns
        ]
        cells += [" | | "] * (2 - len(cells))
        out.append(f"| {text} | {theirs:.0f} | {' | '.join(cells)} |")
    return [
        *out,
        "",
        "Each structure counts as much as any other; within one, means over the seeds are compared.",
        "*Here*, plans in slots are planned as the paper's: all transits of a slot as one robot",
        "(`joint_planning: always`). The last columns compare with our default, which keeps the paths",
        "of the sequential plan wherever nobody is in the way. Planning of the paper's kind of slots is",
        "counted without the sequential motions, which only ours starts from.",
    ]


def quality(measured: Mapping[str, Measured], what: str = "Plans") -> list[str]:
    """Return makespan and wait of every policy, with their bounds.

    Args:
        measured: what is told of.
        what: it is, at the beginning of a heading.
    """
    out = [
        f"## {what}: makespan and wait (Fig. 7)",
        "",
        "| | policy | makespan [s] | of sequential | bound: straight [s] | bound: tasks [s]"
        " | wait [s] | of sequential |",
        "|---|---|---:|---:|---:|---:|---:|---:|",
    ]
    for name, one in measured.items():
        seeds = len(one.figures[SEQUENTIAL]["seeds"])
        head = f"{name.removeprefix(PUBLISHED)}, {seeds} seed{'s' * (seeds > 1)}"
        for policy, row in one.figures.items():
            cells = (
                head if policy == SEQUENTIAL else "",
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
        "*Joint*: all transits of a slot are planned as one robot, as in the paper.",
        "Assemblies are shortened without sidesteps here, as is the default.",
    ]


def planning(measured: Mapping[str, Measured], what: str = "") -> list[str]:
    """Return the planning times of Table II, ours beside the paper's.

    Args:
        measured: what is told of.
        what: it is, at the end of a heading.
    """
    out = [
        f"## Planning time{what} (Table II, Fig. 8)",
        "",
        "| structure | | task [s] | motion [s] | TPG [s] | total [s] | of the paper's | shortcut [s] | joint slots |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for name, one in measured.items():
        name = name.removeprefix(PUBLISHED)
        theirs = paper.TABLE_II.get(name)
        total = synchronous = None
        if theirs is not None:
            total, synchronous = theirs.total, theirs.synchronous_total
            out.append(
                f"| {name}, {theirs.bricks} | paper, APEX-MR | {theirs.task:.1f} "
                f"| {theirs.motion:.1f} | {theirs.tpg:.1f} | {total:.1f} | "
                f"| {theirs.shortcut:.0f} | |"
            )
            name = ""
        own = _ours(one, ASYNCHRONOUS_SHORTCUTS, "here, asynchronous", total)
        out.append(f"| {name} {own} |")
        if theirs is not None:
            out.append(
                f"| | paper, synchronous | {theirs.synchronous_task:.1f} "
                f"| {theirs.synchronous_motion:.1f} | {theirs.synchronous_tpg:.1f} "
                f"| {synchronous:.1f} | | {theirs.shortcut:.0f} | |"
            )
        joint = JOINTLY[SYNCHRONOUS_SHORTCUTS]
        counts = [f"{k} of {n}" for n, k in zip(*[iter(one.slots)] * 2, strict=True)]
        counts = counts or ["", ""]
        own = _ours(one, joint, "here, synchronous, joint", synchronous)
        out.append(f"| {own} {counts[0]} |")
        own = _ours(one, SYNCHRONOUS_SHORTCUTS, "here, synchronous", synchronous)
        out.append(f"| {own} {counts[1]} |")
    return [
        *out,
        "",
        "Task planning is the assembly sequence (where the scenario gives only the finished structure)",
        "and who does what; motion planning of synchronous plans is that of the sequential motions and",
        "of the slots. Total is without shortcuts, as in the paper, whose shortcut column is a budget of",
        "time. Joint slots: slots with motions planned as one robot, of all, with the first seed. The paper",
        "prints 9.2 s as the total of the guitar; its parts add up to 39.2 s.",
    ]


def _ours(one: Measured, policy: str, label: str, theirs_s: float | None) -> str:
    """Return the cells of a row, but for the first and the last one."""
    spent = one.figures[policy]["planning_s"]
    task, motion = _sum_of(spent, *_TASK), _sum_of(spent, "motion", *_SLOTS)
    tpg = _sum_of(spent, "tpg")
    total = _sum_of(spent, *_TASK, "motion", *_SLOTS, "tpg")
    share = "" if theirs_s is None else f"{100 * total['mean'] / theirs_s:.1f} %"
    cells = [spread(value, 2) for value in (task, motion, tpg, total)]
    shortcut = spread(_sum_of(spent, "shortcut"), 2)
    return f"| {label} | {' | '.join(cells)} | {share} | {shortcut} |"


def baselines(measured: Mapping[str, Measured]) -> list[str]:
    """Return how near the baselines are to straight lines."""
    policies = (*BASELINES, JOINTLY[SYNCHRONOUS])
    out = [
        "## Baselines against straight lines",
        "",
        f"| structure | {' | '.join(policies)} |",
        "|---|---:|---:|---:|",
    ]
    for name, one in measured.items():
        cells = [
            f"{max(one.figures[policy]['straight_line_ratio']['per_seed']):.3f}"
            for policy in policies
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

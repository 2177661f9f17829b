"""apex-mr.md, .json and .png, and apex-mr-drawn: our figures beside those of the paper."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks import apex_mr_paper as paper
from benchmarks.apex_mr_tables import (
    PUBLISHED,
    Measured,
    averages,
    baselines,
    cells,
    planning,
    quality,
)
from benchmarks.machine import load_line
from planning.files import replace_atomically
from twin.host.atomic_files import write_json
from twin.runs.policies import SEQUENTIAL
from twin.studies.report.comparison_chart import draw_comparison


@dataclass(frozen=True)
class SkillTimes:
    """Source of skill durations in a report.

    Attributes:
        name: short.
        file: of the report, without its ending.
        title: of the report.
        about: what to know about it.
    """

    name: str
    file: str
    title: str
    about: tuple[str, ...]


REFERENCE = SkillTimes(
    "reference",
    "apex-mr",
    "The experiments of the APEX-MR paper",
    (
        "Skills follow their reference paths at the speed of everything else, without force control and",
        "the same each time, as in the simulations of the paper (Section V-A). What becomes of it when",
        "force control makes skills long and uncertain is in [apex-mr-drawn.md](apex-mr-drawn.md).",
    ),
)
DRAWN = SkillTimes(
    "drawn",
    "apex-mr-drawn",
    "The experiments of the APEX-MR paper with force-controlled skills",
    (
        "Skills take random times, the same ones under every policy, from the packaged timings: 4 to 9 s",
        "each, several times as long as their reference paths. The paper reports no such simulation, its",
        "figures stand here for orientation. Nothing shortens a skill, so all shares are smaller than",
        "those in [apex-mr.md](apex-mr.md), which repeats the paper's way of measuring.",
    ),
)


def write_report(
    folder: Path,
    measured: Mapping[str, Measured],
    failures: Mapping[str, str],
    machine: str,
    skills: SkillTimes,
) -> Path:
    """Write the three files and return the path of the text.

    Args:
        folder: of the files, which are replaced.
        measured: of each scenario; the JSON file holds the published tasks and the structures.
        failures: what could not be planned, and why.
        machine: what it was measured on.
        skills: what decided how long skills took.

    Raises:
        OutputError: a file cannot be written.
    """
    tasks = {name: one for name, one in measured.items() if name.startswith(PUBLISHED)}
    lego = {name: measured[name] for name in paper.STRUCTURES if name in measured}
    more = {name: measured[name] for name in paper.TABLE_I if name in measured}
    about = {name: _about(one, machine) for name, one in measured.items()}
    write_json(
        folder / f"{skills.file}.json",
        {
            name: {
                policy: {**row, **about[name]} for policy, row in one.figures.items()
            }
            for name, one in (tasks | lego).items()
        },
    )
    if measured:
        first = tasks or lego or more
        drawn = {name: one.figures for name, one in first.items()}
        title = "Cells with more robots"
        if tasks or lego:
            title = f"The {'published tasks' if tasks else 'structures'} of APEX-MR"
        picture = folder / f"{skills.file}.png"
        draw_comparison(picture, drawn, f"{title}, planned here", "processor time")
    parts = [_head(measured, machine, skills), _failed(failures)]
    if tasks:
        parts += [
            ["# The published tasks", "", *_TASKS],
            averages(tasks, "published tasks"),
            quality(tasks, "Published tasks"),
            planning(tasks, " of the published tasks"),
        ]
    if lego:
        parts += [
            ["# Structures of our own", "", *_OWN],
            averages(lego, "structures of our own"),
            quality(lego),
            planning(lego),
            baselines(tasks | lego),
        ]
    if more:
        parts += [cells(more), quality(more, "Cells with more robots")]
    target = folder / f"{skills.file}.md"
    with replace_atomically(target) as temporary:
        text = "\n\n".join("\n".join(part) for part in parts if part)
        temporary.write_text(text + "\n", encoding="utf-8")
    return target


_TASKS = (
    "Steps, stock, calibration and arms as the paper's authors publish them, read by",
    "`twin import apex-mr`; the files are no part of this project. Who does what is chosen here, not",
    "taken from their assignment; tools are modelled after the published meshes.",
)
_OWN = (
    "Designs of our own with as many bricks of the same kinds of steps as the paper's nine, in a cell of",
    "our own: seconds of makespan cannot be compared with the paper's, shares with care.",
)


def _about(one: Measured, machine: str) -> dict[str, Any]:
    return {
        "shortcut_candidates": one.candidates,
        "date": one.date,
        "machine": machine,
        "commits": list(one.commits),
    }


def _head(
    measured: Mapping[str, Measured], machine: str, skills: SkillTimes
) -> list[str]:
    dates = sorted({one.date for one in measured.values()})
    when = " to ".join(dict.fromkeys([*dates[:1], *dates[-1:]]))
    seeds = sorted(
        {tuple(one.figures[SEQUENTIAL]["seeds"]) for one in measured.values()}
    )
    budgets = sorted({one.candidates for one in measured.values()})
    commits = sorted({commit for one in measured.values() for commit in one.commits})
    loads = [pair for one in measured.values() for pair in one.loads]
    busy = load_line(loads) if loads else "load unknown"
    tasks = any(name.startswith(PUBLISHED) for name in measured)
    published = " --published ROOT" if tasks else ""
    return [
        f"# {skills.title}",
        "",
        f"Measured {when or 'never'} on {machine}, commit {_list(commits)}; {busy};",
        f"written by `python -m benchmarks.apex_mr{published}`.",
        f"Seeds {_list(', '.join(map(str, s)) for s in seeds)};"
        f" {_span(budgets)} shortcut candidates a plan, by the size of the structure.",
        "Figures are mean ± sample standard deviation over the seeds.",
        "",
        *skills.about,
        "",
        "Planning times here are seconds of the processor, all threads together, in one process, one plan after",
        "another; what else the machine did counts as far as it slows memory and shared cores down. Kernels",
        "were compiled and loaded before, and what inverse kinematics remembers was forgotten before each",
        "seed. Those of the paper are of the wall clock, on an AMD 7840HS laptop with 16 threads.",
        "[planning-times.md](planning-times.md) has both clocks from a machine with nothing else to do.",
        "",
        f"![Makespan, wait and planning time of every policy]({skills.file}.png)",
    ]


def _failed(failures: Mapping[str, str]) -> list[str]:
    if not failures:
        return []
    rows = [f"- {what}: {why}" for what, why in failures.items()]
    return ["## Not planned", "", "Left out of all tables and averages:", "", *rows]


def _span(numbers: Sequence[int]) -> str:
    """Return sorted numbers in words: the least to the greatest."""
    return " to ".join(dict.fromkeys(f"{n}" for n in (*numbers[:1], *numbers[-1:])))


def _list(texts: Iterable[str]) -> str:
    return " and ".join(texts)

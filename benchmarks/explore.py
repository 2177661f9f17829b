"""What learning from designs is worth: TPE against random designs with the same budget, and what rungs cost.

    python -m benchmarks.explore [CELL ...] [--seeds 2]

Of each cell the bases of both arms are moved along x and y; as many designs are tried by either sampler, one
worker, by the mean makespan of 50 replications with the same draws. Seeds are those of the sampler: plan and
draws of a design are the same for all. Writes benchmarks/results/explore.md; what was measured is kept in
benchmarks/.measured/.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.machine import date_line, load_line, machine_line
from benchmarks.store import Row, RowStore
from twin.explore.crew import Crew
from twin.explore.dimensions import dimensions_of
from twin.explore.exploration import Exploration
from twin.explore.rungs import CONSTRAINT, RUNGS, Setting
from twin.host.progress import report_nothing
from twin.scenario.sections.exploration import ExploreSection, SamplerName, VarySection
from twin.trial.loaded_scenario import load

ROOT = Path(__file__).parents[1]
SAMPLERS: tuple[SamplerName, ...] = ("tpe", "random")


@dataclass(frozen=True)
class Case:
    """A cell, how far its bases may move along each axis [m], and how many designs are tried."""

    reach: float
    designs: int


CASES: Mapping[str, Case] = {
    "tray": Case(0.2, 20),
    "cliff": Case(0.1, 16),
    "gearbox": Case(0.08, 8),
}


def main() -> int:
    """Measure what is not in the store, and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cells", nargs="*", help=f"of {', '.join(CASES)}; all of them")
    parser.add_argument("--seeds", type=int, default=2, metavar="N")
    options = parser.parse_args()
    store = RowStore(ROOT / "benchmarks" / ".measured" / "explore", ROOT)
    measured: dict[str, list[Row]] = {}
    for cell in options.cells or CASES:
        for seed in range(options.seeds):
            for sampler in SAMPLERS:
                key = f"{cell}-{CASES[cell].designs}-{sampler}-{seed}"
                row = store.load(key) or store.save(key, measure(cell, sampler, seed))
                measured.setdefault(cell, []).append(row)
                sys.stderr.write(f"{key}: {row['best_s']}\n")
                target = ROOT / "benchmarks" / "results" / "explore.md"
                target.write_text("\n".join(report(measured)) + "\n", "utf-8")
    return 0


def measure(cell: str, sampler: SamplerName, seed: int) -> Row:
    """Return what one search found, and what it cost."""
    case, loaded, before = CASES[cell], load(cell), os.getloadavg()[0]
    content = loaded.resolved()
    vary = []
    for robot in content["cell"]["robots"]:
        for axis in (0, 1):
            at = robot["base"]["xyz_m"][axis]
            key = f"cell.robots.{robot['name']}.base.xyz_m.{axis}"
            low, high = round(at - case.reach, 6), round(at + case.reach, 6)
            vary.append(VarySection(key=key, low=low, high=high))
    section = ExploreSection(vary=tuple(vary), sampler=sampler, designs=case.designs)
    scenario = loaded.sections.changed(explore=None)
    dimensions = dimensions_of(scenario, section, loaded.document)
    with TemporaryDirectory() as name:
        exploration = Exploration(Path(name), section, dimensions, seed, report_nothing)
        setting = Setting(scenario, loaded.folder, section)
        with Crew(setting, 1, section.design_limit_s) as crew:
            exploration.search(crew, case.designs, None)
        rows = exploration.journal.searched
    done = [row for row in rows if row.done]
    base = rows[0].evaluation
    return {
        "sampler": sampler,
        "seed": seed,
        "load": [before, os.getloadavg()[0]],
        "designs": len(rows),
        "base_s": base.goals[0] if base.goals else None,
        "best_s": min((row.evaluation.goals[0] for row in done), default=None),
        "median_s": float(np.median([r.evaluation.goals[0] for r in done])),
        "done": len(done),
        "behind": sum(row.evaluation.outcome == "behind" for row in rows),
        "refused": {
            rung: sum(
                row.evaluation.outcome == "refused" and row.evaluation.rung == rung
                for row in rows
            )
            for rung in (*RUNGS, CONSTRAINT)
        },
        "cpu_s": {
            rung: [
                row.evaluation.cpu_s[rung]
                for row in rows[1:]  # the first one loads kernels
                if rung in row.evaluation.cpu_s
            ]
            for rung in RUNGS
        },
    }


def report(measured: Mapping[str, Sequence[Row]]) -> list[str]:
    """Return the page."""
    loads = [(row["load"][0], row["load"][1]) for r in measured.values() for row in r]
    out = [
        "# Exploring designs",
        "",
        "`python -m benchmarks.explore`: the bases of both arms are moved along x and y, the goal is the mean makespan of 50"
        " replications with the same draws. Design 0 is the scenario as it is. Few designs and few seeds: what is"
        " here tells what a design costs and where designs are refused; it ranks no samplers.",
        "",
        f"{machine_line()} {date_line()} {load_line(loads)}",
        "",
        "| cell | sampler | seed | designs | as it is [s] | best found [s] | median [s] | possible | behind |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for cell, rows in measured.items():
        for row in rows:
            base = "refused" if row["base_s"] is None else f"{row['base_s']:.2f}"
            out.append(
                f"| {cell} | {row['sampler']} | {row['seed']} | {row['designs']} | {base} |"
                f" {row['best_s']:.2f} | {row['median_s']:.2f} | {row['done']} | {row['behind']} |"
            )
    out += [
        "",
        "Processor seconds of a design at each rung, warm (median over all designs that came to it), and the share of all"
        " designs that was refused there:",
        "",
        f"| cell | {' | '.join(RUNGS)} | first three |",
        f"|---|{'---:|' * (len(RUNGS) + 1)}",
    ]
    for cell, rows in measured.items():
        total = sum(row["designs"] for row in rows)
        cells, first = [], 0.0
        for rung in RUNGS:
            spent = [v for row in rows for v in row["cpu_s"][rung]]
            typical = float(np.median(spent)) if spent else 0.0
            first += typical if rung in RUNGS[:3] else 0.0
            refused = sum(row["refused"][rung] for row in rows) / total
            cells.append(f"{typical:.2f} s, {100 * refused:.0f} %")
        out.append(f"| {cell} | {' | '.join(cells)} | {first:.2f} s |")
    return out


if __name__ == "__main__":
    sys.exit(main())

"""The figures of the APEX-MR paper, measured here: nine LEGO structures and three cells.

    python -m benchmarks.apex_mr                        # all of it, as `make paper` does
    python -m benchmarks.apex_mr --only cliff faucet --seeds 1

Writes apex-mr.md, apex-mr.json and apex-mr.png to benchmarks/results/, or with ``--only`` to
logs/apex-mr/. Everything runs in one process, one plan after another: planning times are not
those of programs that compete for the processor. What was measured is kept in
benchmarks/.measured/, so that an interrupted run goes on where it was.
"""

from __future__ import annotations

import argparse
import gc
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.apex_mr_paper import STRUCTURES, TABLE_I
from benchmarks.apex_mr_report import write_report
from benchmarks.apex_mr_tables import Measured
from benchmarks.machine import date_line, machine_line
from benchmarks.measured_store import MeasuredStore
from planning.errors import TwinError
from twin.comparison import (
    Measurement,
    collect,
    measure_policies,
    shortcut_budget,
)
from twin.comparison_figures import comparison_figures
from twin.progress import Report, StageDisplay
from twin.scenario import Scenario
from twin.scenario_file import load_scenario

ROOT = Path(__file__).parents[1]
SCENARIOS = {
    **{name: ROOT / "scenarios" / "lego" / f"{name}.yaml" for name in STRUCTURES},
    **{name: ROOT / "scenarios" / "multi_arm" / f"{name}.yaml" for name in TABLE_I},
}
WARM_UP = ("cliff", "faucet", "rearrangement")
"""Planned once before anything is measured, so that all kernels are loaded."""

ALL = "structures and cells"


@dataclass(frozen=True)
class Options:
    """What is asked for.

    Attributes:
        only: names of scenarios, in the order of the report.
        seeds: how many, counted from the seed of each scenario.
        shortcuts: tried on each plan, None for what the scenario or the program says.
        out: folder of the report.
        fresh: measure again what was measured before.
        quiet: show no progress.
    """

    only: tuple[str, ...]
    seeds: int
    shortcuts: int | None
    out: Path
    fresh: bool
    quiet: bool


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and write the report; 1 if something could not be planned."""
    options = _options(arguments)
    store = MeasuredStore(ROOT / "benchmarks" / ".measured", ROOT, machine_line())
    measured, failures = {}, {}
    with StageDisplay(enabled=not options.quiet) as progress:
        warm = False
        for number, name in enumerate(options.only):
            progress(ALL, number, len(options.only))
            scenario = load_scenario(SCENARIOS[name])
            candidates = options.shortcuts
            if candidates is None:
                candidates = shortcut_budget(scenario)
            rows, dates = [], set()
            seeds = range(scenario.seed, scenario.seed + options.seeds)
            for seed in seeds:
                found = None if options.fresh else store.load(name, seed, candidates)
                if found is None:
                    if not warm:
                        _warm_up(progress)
                        warm = True
                    try:
                        row = _measure(name, scenario, seed, candidates, progress)
                    except TwinError as error:
                        failures[f"{name}, seed {seed}"] = str(error)
                        sys.stderr.write(f"{name}, seed {seed}: {error}\n")
                        break
                    store.save(name, seed, candidates, row, date_line())
                    found = row, date_line()
                rows.append(found[0])
                dates.add(found[1])
            if len(rows) == options.seeds:
                comparison = collect(scenario, seeds, candidates, rows)
                figures = comparison_figures(comparison)
                robots = len(comparison.robots)
                measured[name] = Measured(figures, robots, candidates, max(dates))
        progress(ALL, len(options.only), len(options.only))
    options.out.mkdir(parents=True, exist_ok=True)
    written = write_report(options.out, measured, failures, machine_line())
    sys.stderr.write(f"{written}\n")
    return 1 if failures else 0


def _measure(
    name: str, scenario: Scenario, seed: int, candidates: int, progress: Report
) -> dict[str, Measurement]:
    sys.stderr.write("" if sys.stderr.isatty() else f"{name}, seed {seed} ...\n")
    gc.collect()
    return measure_policies(
        scenario,
        seed,
        candidates=candidates,
        base=SCENARIOS[name].parent,
        progress=progress,
    )


def _warm_up(progress: Report) -> None:
    for number, name in enumerate(WARM_UP):
        progress("warm-up", number, len(WARM_UP))
        scenario, base = load_scenario(SCENARIOS[name]), SCENARIOS[name].parent
        measure_policies(scenario, scenario.seed, candidates=100, base=base)
    progress("warm-up", len(WARM_UP), len(WARM_UP))


def _options(arguments: Sequence[str] | None) -> Options:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.apex_mr", description=__doc__.splitlines()[0]
    )
    parser.add_argument(
        "--only", nargs="+", choices=tuple(SCENARIOS), metavar="NAME", default=()
    )
    parser.add_argument(
        "--seeds", type=int, choices=range(1, 100), default=4, metavar="N"
    )
    parser.add_argument("--shortcuts", type=int, help="candidates tried on each plan")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--fresh", action="store_true", help="measure all again")
    parser.add_argument("--quiet", action="store_true", help="show no progress")
    given = parser.parse_args(arguments)
    chosen = tuple(name for name in SCENARIOS if not given.only or name in given.only)
    everything = ROOT / "benchmarks" / "results"
    out = given.out or (ROOT / "logs" / "apex-mr" if given.only else everything)
    return Options(chosen, given.seeds, given.shortcuts, out, given.fresh, given.quiet)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.stderr.write("interrupted; the same command goes on from here\n")
        sys.exit(130)

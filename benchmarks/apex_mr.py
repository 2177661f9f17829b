"""The figures of the APEX-MR paper, measured here: nine LEGO structures and three cells.

    python -m benchmarks.apex_mr                        # all of it, as `make paper` does
    python -m benchmarks.apex_mr --only cliff faucet --seeds 1

All of it twice: with skills that take as long as their reference paths, as in the simulations of
the paper (apex-mr.md, .json and .png), and with force-controlled skills, whose durations are drawn
(apex-mr-drawn.md, .json and .png). The files go to benchmarks/results/, with ``--only`` to
logs/apex-mr/. Everything runs in one process, one plan after another: planning times are not
those of programs that compete for the processor. What was measured is kept in
benchmarks/.measured/, so that an interrupted run goes on where it was.
"""

from __future__ import annotations

import argparse
import gc
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from benchmarks.apex_mr_paper import STRUCTURES, TABLE_I
from benchmarks.apex_mr_report import DRAWN, REFERENCE, SkillTimes, write_report
from benchmarks.apex_mr_tables import Measured
from benchmarks.machine import machine_line
from benchmarks.store import RowStore
from planning.errors import TwinError
from twin.comparison.comparison import (
    Measurement,
    comparison_figures,
    measure_policies,
    shortcut_budget,
)
from twin.host.progress import Report, StageDisplay
from twin.scenario.manifest import load_scenario
from twin.scenario.sections.scenario import Scenario, follow_references

ROOT = Path(__file__).parents[1]
SCENARIOS = {
    **{name: ROOT / "scenarios" / "lego" / f"{name}.yaml" for name in STRUCTURES},
    **{name: ROOT / "scenarios" / "multi_arm" / f"{name}.yaml" for name in TABLE_I},
}
WARM_UP = ("cliff", "faucet", "rearrangement")
"""Planned once before anything is measured, so that all kernels are loaded."""

ALL = "structures and cells"


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and write the reports; 1 if something could not be planned."""
    options = _options(arguments)
    bench = _Bench(
        options, RowStore(ROOT / "benchmarks" / ".measured" / "apex_mr", ROOT)
    )
    options.out.mkdir(parents=True, exist_ok=True)
    failed = False
    with StageDisplay(enabled=not options.quiet) as progress:
        for skills in options.skills:
            measured, failures = {}, {}
            for number, name in enumerate(options.only):
                progress(f"{ALL}, {skills.name}", number, len(options.only))
                try:
                    measured[name] = bench.measured(name, skills, progress)
                except TwinError as error:
                    failures[name] = str(error)
                    sys.stderr.write(f"{name}: {error}\n")
            progress(f"{ALL}, {skills.name}", len(options.only), len(options.only))
            written = write_report(
                options.out, measured, failures, machine_line(), skills
            )
            sys.stderr.write(f"{written}\n")
            failed |= bool(failures)
    return 1 if failed else 0


class _Bench:
    """Measures what is not in the store."""

    def __init__(self, options: argparse.Namespace, store: RowStore) -> None:
        self._options = options
        self._store = store
        self._warm = False

    def measured(self, name: str, skills: SkillTimes, progress: Report) -> Measured:
        """Return the figures of a scenario over all seeds.

        Raises:
            TwinError: a seed cannot be planned; the message names it.
        """
        scenario = load_scenario(SCENARIOS[name])
        if skills is REFERENCE:
            scenario = follow_references(scenario)
        candidates = self._options.shortcuts
        if candidates is None:
            candidates = shortcut_budget(scenario)
        rows, dates = {}, set()
        seeds = range(scenario.seed, scenario.seed + self._options.seeds)
        for seed in seeds:
            key = f"{name}-{skills.name}-{seed}-{candidates}"
            found = None if self._options.fresh else self._store.load(key)
            if found is None:
                self._warm_up(progress)
                try:
                    row = _measure(name, scenario, seed, candidates, progress)
                except TwinError as error:
                    raise TwinError(f"seed {seed}: {error}") from error
                policies = {policy: asdict(one) for policy, one in row.items()}
                found = self._store.save(key, {"policies": policies})
            rows[seed] = {
                policy: Measurement(**one) for policy, one in found["policies"].items()
            }
            dates.add(found["date"])
        robots = len(scenario.cell.robots)
        return Measured(comparison_figures(rows), robots, candidates, max(dates))

    def _warm_up(self, progress: Report) -> None:
        """Load all kernels, before anything is measured."""
        if not self._warm:
            _warm_up(progress)
        self._warm = True


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


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.apex_mr", description=__doc__.splitlines()[0]
    )
    parser.add_argument(
        "--only", nargs="+", choices=tuple(SCENARIOS), metavar="NAME", default=()
    )
    parser.add_argument(
        "--skills",
        nargs="+",
        choices=("reference", "drawn"),
        default=("reference", "drawn"),
        help="what decides how long skills take",
    )
    parser.add_argument(
        "--seeds", type=int, choices=range(1, 100), default=4, metavar="N"
    )
    parser.add_argument("--shortcuts", type=int, help="candidates tried on each plan")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--fresh", action="store_true", help="measure all again")
    parser.add_argument("--quiet", action="store_true", help="show no progress")
    given = parser.parse_args(arguments)
    everything = ROOT / "benchmarks" / "results"
    given.out = given.out or (ROOT / "logs" / "apex-mr" if given.only else everything)
    # In the order of the reports.
    given.only = [n for n in SCENARIOS if not given.only or n in given.only]
    given.skills = [s for s in (REFERENCE, DRAWN) if s.name in given.skills]
    return given


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.stderr.write("interrupted; the same command goes on from here\n")
        sys.exit(130)

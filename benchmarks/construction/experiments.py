"""The experiments of Hartmann et al., measured here: four models, teams of 1 to 12 robots, a handover.

    python -m benchmarks.construction                          # all of it, as `make paper` does
    python -m benchmarks.construction --models tower --robots 1 5 --seeds 2
    python -m benchmarks.construction --report                 # of what was measured so far

Writes construction.md, construction.json and charts to benchmarks/results/, or, where only a part
was asked for, to logs/construction/. The first seed of everything comes before the second, and
every row says how many it has. What was measured is kept in benchmarks/.measured/construction/, so
that an interrupted run goes on where it was. One plan is made after another, in one process.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.construction.case import measure_baseline, measure_method, warm_up
from benchmarks.construction.paper import DURATIONS, SEEDS, TEAMS, WITH_BASELINE
from benchmarks.construction.report import write_report
from benchmarks.store import Row, RowStore
from twin.host.progress import Report, StageDisplay

ROOT = Path(__file__).parents[2]
CASES = "cases"


@dataclass(frozen=True)
class Case:
    """One row to measure.

    Attributes:
        model: what is built.
        robots: by how many.
        seed: of everything that is drawn.
        duration: T of the baseline [s]; None for the method itself, ``best`` for the T that
            was best with the first seed.
    """

    model: str
    robots: int
    seed: int
    duration: float | str | None = None

    @property
    def key(self) -> str:
        """Its name in the store."""
        what = "method" if self.duration is None else f"fixed-{self.duration}"
        return f"{self.model}-{self.robots}-{self.seed}-{what}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and write the report; 1 if a plan is not safe.

    What could not be planned is in the report, with the reason.
    """
    options = _options(arguments)
    folder = ROOT / "benchmarks" / ".measured" / "construction"
    store = RowStore(folder, ROOT, any_version=options.any_version)
    rows: list[Row] = []
    try:
        with StageDisplay(enabled=not options.quiet) as progress:
            # What is there when it is interrupted counts, too.
            _collect(rows, options, store, progress)
    finally:
        if rows:
            options.out.mkdir(parents=True, exist_ok=True)
            sys.stderr.write(f"{write_report(options.out, rows)}\n")
    bad = [row for row in rows if row["ok"] and not _safe(row)]
    return 1 if bad else 0


def _collect(
    rows: list[Row], options: argparse.Namespace, store: RowStore, progress: Report
) -> None:
    """Add the rows of all cases, measured now or before."""
    warm = False
    for number, case in enumerate(options.cases):
        progress(CASES, number, len(options.cases))
        chosen = _with_best(case, store)
        if chosen is None:
            continue
        row = None if options.fresh else store.load(chosen.key)
        if row is None:
            if options.report:
                continue
            if not warm:
                warm_up()
                warm = True
            if not sys.stderr.isatty() and not options.quiet:
                sys.stderr.write(f"{chosen.key} ...\n")
            row = store.save(chosen.key, _measure(chosen, options, progress))
        rows.append(row)
    progress(CASES, len(options.cases), len(options.cases))


def _with_best(case: Case, store: RowStore) -> Case | None:
    """Return a case with the T that was best with the first seed, None where none worked."""
    if case.duration != "best":
        return case
    tried = [
        row
        for duration in DURATIONS
        if (row := store.load(Case(case.model, case.robots, 0, duration).key))
        and row["ok"]
    ]
    if not tried:
        return None
    best = min(tried, key=lambda row: float(row["makespan_s"]))
    return Case(case.model, case.robots, case.seed, best["duration_s"])


def _measure(case: Case, options: argparse.Namespace, progress: Report) -> Row:
    if isinstance(case.duration, float):
        return measure_baseline(
            case.model,
            case.robots,
            case.seed,
            case.duration,
            limit=options.limit,
            progress=progress,
        )
    return measure_method(
        case.model,
        case.robots,
        case.seed,
        limit=options.limit,
        stalled=options.stalled if case.seed == 0 else -1,
        progress=progress,
    )


def _safe(row: Row) -> bool:
    """Tell whether everything that looked at a plan is content."""
    return not row["fine"]["faults"] and all(
        run["outcome"] == "completed" and not run["violations"]
        for run in row.get("runs", [])
    )


def all_cases(
    models: Sequence[str], robots: Sequence[int], seeds: int | None
) -> tuple[Case, ...]:
    """Return what is measured, the first seed of everything before the second.

    Args:
        models: names of models.
        robots: sizes of teams, of those that the model has; all where empty.
        seeds: how many; ten where not given.
    """
    out = []
    for seed in range(seeds or SEEDS):
        for model in models:
            for team in robots or TEAMS[model]:
                out.append(Case(model, team, seed))
                if team in WITH_BASELINE.get(model, ()):
                    trials = DURATIONS if seed == 0 else ("best",)
                    out += [Case(model, team, seed, trial) for trial in trials]
    return tuple(out)


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.construction", description=__doc__.splitlines()[0]
    )
    parser.add_argument(
        "--models", nargs="+", choices=tuple(TEAMS), metavar="NAME", default=()
    )
    parser.add_argument(
        "--robots", nargs="+", type=int, metavar="M", default=(), help="sizes of teams"
    )
    parser.add_argument("--seeds", type=int, choices=range(1, 100), metavar="N")
    parser.add_argument(
        "--limit", type=float, default=900.0, help="processor time for a plan [s]"
    )
    parser.add_argument(
        "--stalled", type=int, default=2, help="audited runs with stalls of each case"
    )
    parser.add_argument("--out", type=Path)
    parser.add_argument("--fresh", action="store_true", help="measure all again")
    parser.add_argument(
        "--any-version",
        action="store_true",
        help="take what other versions of the program measured; the report says which",
    )
    parser.add_argument(
        "--report", action="store_true", help="measure nothing, write the report"
    )
    parser.add_argument("--quiet", action="store_true", help="show no progress")
    given = parser.parse_args(arguments)
    part = given.models or given.robots or given.seeds
    everything = ROOT / "benchmarks" / "results"
    given.out = given.out or (ROOT / "logs" / "construction" if part else everything)
    models = tuple(name for name in TEAMS if not given.models or name in given.models)
    given.cases = all_cases(models, given.robots, given.seeds)
    return given

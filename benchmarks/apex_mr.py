"""The figures of the APEX-MR paper, measured here: published tasks, nine structures, three cells.

    python -m benchmarks.apex_mr                        # all but published tasks, as `make paper` does
    python -m benchmarks.apex_mr --published ROOT       # and every task of a folder as published
    python -m benchmarks.apex_mr --only cliff faucet --seeds 1

ROOT is a copy of what the paper's authors publish (see docs/guides/apex-mr.md), which is no part
of this project; its tasks are named published/cliff and so on. All of it is measured twice: with
skills that take as long as their reference paths, as in the simulations of the paper (apex-mr.md,
.json and .png), and with force-controlled skills, whose durations are drawn (apex-mr-drawn.md,
.json and .png). The files go to benchmarks/results/, with ``--only`` to logs/apex-mr/. Planning is
measured in seconds of the processor, all threads together, so that what else runs on the machine
counts little. What was measured is kept in benchmarks/.measured/, so that an interrupted run goes
on where it was; ``--stored`` writes the files of what is there.
"""

import argparse
import gc
import os
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.apex_mr_paper import STRUCTURES, TABLE_I
from benchmarks.apex_mr_report import DRAWN, REFERENCE, SkillTimes, write_report
from benchmarks.apex_mr_tables import JOINTLY, PUBLISHED, Measured
from benchmarks.machine import forget_answers, machine_line
from benchmarks.store import Row, RowStore
from planning.errors import TwinError
from planning.lego.importers.apex_mr.importer import available_tasks
from scheduling.planned_motions import PlannedMotions
from twin.host.progress import Report, StageDisplay, StageWatch, report_nothing
from twin.kinds.lego.imports import import_task
from twin.planning.pipeline import plan_motions, plan_synchronously
from twin.reading.scenario_file import load_scenario
from twin.scenario.sections.scenario import Scenario
from twin.studies.compare import follow_references
from twin.studies.comparison import (
    Measurement,
    comparison_figures,
    measure_policies,
    require_comparable,
)
from twin.studies.plans import shortcut_budget

ROOT = Path(__file__).parents[1]
KEPT = ROOT / "benchmarks" / ".measured" / "apex_mr"
OWN = {
    **{name: ROOT / "scenarios" / "lego" / f"{name}.yaml" for name in STRUCTURES},
    **{name: ROOT / "scenarios" / "multi_arm" / f"{name}.yaml" for name in TABLE_I},
}
WARM_UP = ("cliff", "faucet", "rearrangement")
"""Planned once before anything is measured, so that all kernels are loaded."""

ALL = "structures and cells"


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and write the reports; 1 if something could not be planned."""
    options = _options(arguments)
    store = RowStore(KEPT, ROOT, any_version=options.stored)
    bench = _Bench(options, store)
    options.out.mkdir(parents=True, exist_ok=True)
    failed = False
    with StageDisplay(enabled=not options.quiet) as progress:
        for skills in options.skills:
            measured, failures = {}, {}
            for number, name in enumerate(options.only):
                progress(f"{ALL}, {skills.name}", number, len(options.only))
                try:
                    found = bench.measured(name, skills, progress)
                except TwinError as error:
                    failures[name] = str(error)
                    sys.stderr.write(f"{name}: {error}\n")
                    continue
                if found is not None:
                    measured[name] = found
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

    def measured(
        self, name: str, skills: SkillTimes, progress: Report
    ) -> Measured | None:
        """Return the figures of a scenario over all seeds, None where there are none.

        Raises:
            TwinError: a seed cannot be planned; the message names it.
        """
        options, file = self._options, OWN.get(name)
        if file is None:
            file = import_published(
                self._options.published, name.removeprefix(PUBLISHED), self._store
            )
        scenario = load_scenario(file)
        if skills is REFERENCE:
            scenario = follow_references(scenario)
        candidates = options.shortcuts
        if candidates is None:
            candidates = shortcut_budget(scenario)
        own = sha256(file.read_bytes()).hexdigest()[:8]
        rows: dict[int, Row] = {}
        for seed in range(scenario.seed, scenario.seed + options.seeds):
            key = f"{name}-{own}-{skills.name}-{seed}-{candidates}".replace("/", "-")
            found = None if options.fresh else self._store.load(key)
            if found is None and not options.stored:
                self._warm_up(progress)
                sys.stderr.write(f"{name}, {skills.name}, seed {seed} ...\n")
                case = _Case(scenario, file.parent, candidates)
                try:
                    found = self._store.save(key, case.measure(seed, progress))
                except TwinError as error:
                    raise TwinError(f"seed {seed}: {error}") from error
            if found is not None:
                rows[seed] = found
        if not rows:
            return None
        figures = comparison_figures(
            {
                seed: {
                    name: Measurement(**one) for name, one in row["policies"].items()
                }
                for seed, row in rows.items()
            }
        )
        return Measured(
            figures,
            len(scenario.cell.robots),
            candidates,
            max(row["date"] for row in rows.values()),
            tuple(sorted({row["commit"] for row in rows.values()})),
            tuple((row["load"][0], row["load"][1]) for row in rows.values()),
            next(iter(rows.values()))["slots"],
        )

    def _warm_up(self, progress: Report) -> None:
        """Load all kernels, before anything is measured."""
        if self._warm:
            return
        for number, name in enumerate(WARM_UP):
            progress("warm-up", number, len(WARM_UP))
            scenario, base = load_scenario(OWN[name]), OWN[name].parent
            _Case(scenario, base, 100).measure(scenario.seed, report_nothing)
        progress("warm-up", len(WARM_UP), len(WARM_UP))
        self._warm = True


def import_published(root: Path, task: str, store: RowStore) -> Path:
    """Return the scenario file of a published task, imported where the store does not hold it.

    Args:
        root: folder of the published files.
        task: name of the task.
        store: where the scenario is kept.
    """
    digest = sha256()
    for path in sorted(p for p in root.rglob("*") if p.is_file()):
        digest.update(str(path.relative_to(root)).encode() + path.read_bytes())
    key = f"import-{task}-{digest.hexdigest()[:8]}"
    file = KEPT / "scenarios" / f"{task}.yaml"
    file.parent.mkdir(parents=True, exist_ok=True)
    found = store.load(key)
    if found is None:
        import_task(root, task=task, output=file)
        store.save(key, {"scenario": file.read_text(encoding="utf-8")})
    else:
        file.write_text(found["scenario"], encoding="utf-8")
    return file


@dataclass(frozen=True)
class _Case:
    """A scenario to measure.

    Attributes:
        scenario: with the durations of skills that are wanted.
        base: where its relative paths start.
        candidates: shortcuts tried on each plan.
    """

    scenario: Scenario
    base: Path
    candidates: int

    def measure(self, seed: int, progress: Report) -> dict[str, Any]:
        """Return what all policies come to, as a row for the store.

        Raises:
            TwinError: it cannot be planned.
        """
        gc.collect()
        forget_answers()
        before = os.getloadavg()[0]
        scenario = self.scenario.model_copy(update={"seed": seed})
        watch = StageWatch(progress, clock=time.process_time)
        require_comparable(scenario)
        turns = plan_motions(scenario, self.base, watch)
        found = measure_policies(
            turns, scenario, watch, candidates=self.candidates, base=self.base
        )
        always = {"joint_planning": "always"}
        planning = scenario.planning.model_copy(update=always)
        joint = measure_policies(
            turns,
            scenario.model_copy(update={"planning": planning}),
            watch,
            candidates=self.candidates,
            base=self.base,
            policies=tuple(JOINTLY),
        )
        policies = {}
        for name, one in found.items():
            if name in JOINTLY:
                policies[JOINTLY[name]] = asdict(joint[name])
            policies[name] = asdict(one)
        first = seed == self.scenario.seed
        slots = tuple(_slots(turns)) if first else ()
        return {
            "policies": policies,
            "load": (before, os.getloadavg()[0]),
            "slots": slots,
        }


def _slots(turns: PlannedMotions) -> Iterator[int]:
    """Yield the slots of a plan and those that are planned jointly, always jointly and not."""
    for always in (True, False):
        found = plan_synchronously(turns, StageWatch(), always_jointly=always)
        yield int(np.max(found.slot_of_task, initial=-1)) + 1
        yield len(found.jointly_planned)


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.apex_mr", description=__doc__.splitlines()[0]
    )
    parser.add_argument(
        "--published", type=Path, metavar="ROOT", help="folder of published tasks"
    )
    parser.add_argument("--only", nargs="+", metavar="NAME", default=())
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
    parser.add_argument(
        "--stored",
        action="store_true",
        help="measure nothing, report what is there, of whichever version",
    )
    parser.add_argument("--quiet", action="store_true", help="show no progress")
    given = parser.parse_args(arguments)
    everything = ROOT / "benchmarks" / "results"
    given.out = given.out or (ROOT / "logs" / "apex-mr" if given.only else everything)
    tasks = () if given.published is None else available_tasks(given.published)
    if given.published is not None and not tasks:
        parser.error(f"--published {given.published}: no assembly_tasks/*.json there")
    names = [*(f"{PUBLISHED}{task}" for task in tasks), *OWN]
    for name in given.only:
        if name not in names:
            parser.error(
                f"--only {name}: no such name (choose from {', '.join(names)})"
            )
    # In the order of the reports.
    given.only = [n for n in names if not given.only or n in given.only]
    given.skills = [s for s in (REFERENCE, DRAWN) if s.name in given.skills]
    return given


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.stderr.write("interrupted; the same command goes on from here\n")
        sys.exit(130)

"""Growth of planning and of what comes after it with the number of bricks.

    python -m benchmarks.scaling [--label after] [--shortcuts] [BRICKS ...]

Builds a field of towers, twenty bricks a tower, of as many bricks as asked for (by default 25, 50,
100, 200, 400 and 800) with two robots and four feeding stations, layer by layer over all towers.
Each size is planned, executed, audited and written in a process of its own, after a small one has
been there so that all kernels are compiled and loaded. Measured are processor seconds, all threads
together, of every stage. Shortcuts are left out, or, with ``--shortcuts``, taken with the budget that
is the default of so many bricks, and nothing is executed: then 96, 192, 384 and 768 bricks are planned.
Exponents are fitted to the sizes from 100 on: a stage with exponent p takes 2^p times as long for
twice the bricks. Writes benchmarks/results/scaling.md and .json, in which other labels stay.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import yaml

from benchmarks.machine import date_line, forget_answers, load_line, machine_line
from planning.lego.sequencing.stable_steps import stable_steps
from planning.lego.sequencing.step_reach import check_reach
from planning.lego.skills.candidates import find_candidates
from planning.lego.skills.expansion import lego_work
from planning.motion.sequential import plan_motions_sequentially
from planning.tasks.highs_solver import assign_steps
from scheduling.build_tpg import build_tpg
from scheduling.graph.rollout import earliest_times
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.ordering.reordering import reorder_tasks
from scheduling.shortcuts.shortcutting import shorten_tpg
from twin.audits import run_auditor
from twin.kinds.lego.kind import build_lego, sequencing_rules
from twin.kinds.lego.section import LegoSection
from twin.planning.build_workcell import build_workcell
from twin.planning.pipeline import default_shortcuts, motion_settings
from twin.reading.scenario_file import load_scenario
from twin.trial import executor, simulation
from twin.trial.loaded_scenario import LoadedScenario
from twin.trial.plan_result import given_plan
from twin.trial.run_plan import run_plan_to_folder
from twin.trial.run_result import RunResult

RESULTS = Path(__file__).parent / "results"
SIZES = (25, 50, 100, 200, 400, 800)
SHORTCUT_SIZES = (96, 192, 384, 768)
FITTED_FROM = 100
"""Exponents are fitted to structures of so many bricks and more."""

PLANNING = (
    *("stability", "reach", "candidates", "assignment", "motion", "graph"),
    *("order", "shortcuts"),
)
AFTERWARDS = ("execution", "files", "audit")
STAGES = ("reading", *PLANNING, *AFTERWARDS)

_TOWERS, _LAYERS = (5, 8), 10
"""Towers along x and y, and layers of two bricks."""

_PLATE = (48, 48)


@dataclass
class Clock:
    """Processor seconds by stage.

    Attributes:
        seconds: of each stage, all threads together.
    """

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure a stage; one entered again adds up."""
        start = time.process_time()
        try:
            yield
        finally:
            spent = time.process_time() - start
            self.seconds[name] = self.seconds.get(name, 0.0) + spent

    def timed(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function whose calls are measured as a stage."""

        def call(*args: Any, **more: Any) -> Any:
            with self.stage(name):
                return function(*args, **more)

        return call


@dataclass(frozen=True)
class Measurement:
    """What one structure took.

    Attributes:
        bricks: how many.
        cpu_s: processor seconds of each stage.
        memory_mib: largest resident memory of the process.
        memory_before_mib: the same before shortcuts, None where none are taken.
        cost: of the assignment, joint distance [rad].
        makespan_s: of the plan executed.
        violations: found by the audit, None where nothing is executed.
        load: of the machine in the last minute, before and after.
    """

    bricks: int
    cpu_s: dict[str, float]
    memory_mib: int
    memory_before_mib: int | None
    cost: float
    makespan_s: float
    violations: int | None
    load: tuple[float, float]


def tower_field(bricks: int) -> dict[str, Any]:
    """Return the content of a scenario: a field of towers with so many bricks.

    Every layer of a tower is two bricks 2x4 side by side, turned against those below. Towers
    stand wall to wall about the middle of the plate. Layers are laid one after another over all
    towers.
    """
    columns, rows = _TOWERS
    left, low = (_PLATE[0] - 4 * columns) // 2, (_PLATE[1] - 4 * rows) // 2
    corners = [(left + 4 * i, low + 4 * k) for i in range(columns) for k in range(rows)]
    corners.sort(key=lambda c: (abs(c[0] + 2 - 24) + abs(c[1] + 2 - 24), c))
    towers = -(-bricks // (2 * _LAYERS))
    if towers > len(corners):
        raise ValueError(f"at most {2 * _LAYERS * len(corners)} bricks fit")
    steps: list[dict[str, Any]] = []
    for layer in range(1, _LAYERS + 1):
        for x, y in corners[:towers]:
            for k in (0, 2):
                at = [x + k, y, layer] if layer % 2 else [x, y + k, layer]
                steps.append({"brick": "2x4", "at": at, "turned": layer % 2 == 0})
    stations = {
        "left_a": [3, 12, 1],
        "left_b": [3, 32, 1],
        "right_a": [43, 12, 1],
        "right_b": [43, 32, 1],
    }
    return {
        "version": 1,
        "name": f"towers-{bricks}",
        "cell": {
            "robots": [
                _robot("left", 0.0, 0.0),
                _robot("right", 0.88, 180.0),
            ],
            "fixtures": [
                {
                    "name": "table",
                    "size_m": [0.6, 1.2, 0.02],
                    "pose": {"xyz_m": [0.44, 0, 1.1045]},
                }
            ],
        },
        "assembly": {
            "kind": "lego",
            "plate": {"pose": {"xyz_m": [0.44, 0, 1.1145]}, "studs": list(_PLATE)},
            "stock": [
                {"name": name, "brick": "2x4", "at": at, "station": True}
                for name, at in stations.items()
            ],
            "steps": steps[:bricks],
        },
        "planning": {"shortcut_candidates": 0},
    }


def _robot(name: str, x: float, yaw: float) -> dict[str, Any]:
    base = {"xyz_m": [x, 0, 0.9246], "rpy_deg": [0, 0, yaw]}
    return {"name": name, "model": "gp4", "base": base}


def measure(bricks: int, *, shortcuts: bool) -> Measurement:
    """Plan a structure in this process, after a small one, and shorten it or execute and audit it."""
    before = os.getloadavg()[0]
    _go_through(4, Clock(), shortcuts=shortcuts)
    forget_answers()
    clock = Clock()
    found = _go_through(bricks, clock, shortcuts=shortcuts)
    return replace(
        found,
        memory_mib=_peak_mib(),
        load=(before, os.getloadavg()[0]),
    )


def _peak_mib() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024


def _go_through(bricks: int, clock: Clock, *, shortcuts: bool) -> Measurement:
    with tempfile.TemporaryDirectory() as name:
        file = Path(name) / "towers.yaml"
        file.write_text(yaml.safe_dump(tower_field(bricks)))
        with clock.stage("reading"):
            scenario = load_scenario(file)
            cell = build_workcell(scenario, file.parent)
            settings = motion_settings(scenario, cell, file.parent)
            assert isinstance(scenario.assembly, LegoSection)
            assembly = build_lego(scenario.assembly)
        with clock.stage("stability"):
            rules = sequencing_rules(scenario.assembly, robots=len(cell.robots))
            assembly = stable_steps(assembly, rules)
        with clock.stage("reach"):
            check_reach(cell, assembly)
        with clock.stage("candidates"):
            work = lego_work(find_candidates(cell, assembly))
        with clock.stage("assignment"):
            choices = assign_steps(work.problem)
        with clock.stage("motion"):
            choices, motions = plan_motions_sequentially(cell, work, choices, settings)
        with clock.stage("graph"):
            tpg = build_tpg(motions)
        cost, memory, violations = sum(c.cost for c in choices.choices), None, None
        if shortcuts:
            memory = _peak_mib()
            with clock.stage("order"):
                tpg = reorder_tasks(tpg)
            budget = default_shortcuts(scenario)
            with clock.stage("shortcuts"):
                tpg = shorten_tpg(
                    tpg, settings.speeds, step=settings.step, candidates=budget
                )
            makespan = float(earliest_times(tpg).makespan)
        else:
            loaded = LoadedScenario(scenario, file.parent)
            done = _executed(loaded, tpg, clock, Path(name))
            assert done.record is not None
            makespan = float(done.record.makespan_s)
            violations = len(done.summary["audit"]["violations"])
    seconds, load = clock.seconds, (0.0, 0.0)
    return Measurement(bricks, seconds, 0, memory, cost, makespan, violations, load)


def _executed(
    scenario: LoadedScenario, tpg: TemporalPlanGraph, clock: Clock, folder: Path
) -> RunResult:
    """Execute, write and audit a plan."""
    executing = clock.timed("execution", simulation.execute)
    auditing = clock.timed("audit", run_auditor.audit_execution)
    (folder / "run").mkdir()
    with (
        patch.object(executor, "execute", executing),
        patch.object(run_auditor, "audit_execution", auditing),
        clock.stage("files"),
    ):
        done = run_plan_to_folder(given_plan(scenario, tpg), folder / "run")
    clock.seconds["files"] -= clock.seconds["execution"] + clock.seconds["audit"]
    return done


def exponent(sizes: Sequence[int], seconds: Sequence[float]) -> float:
    """Return the slope of a line through the logarithms."""
    return float(np.polyfit(np.log(sizes), np.log(np.maximum(seconds, 1e-3)), 1)[0])


def _in_process_of_its_own(bricks: int, *, shortcuts: bool) -> dict[str, Any]:
    more = ["--shortcuts"] if shortcuts else []
    run = subprocess.run(
        [sys.executable, "-m", "benchmarks.scaling", "--one", str(bricks), *more],
        check=True,
        stdout=subprocess.PIPE,
        text=True,
    )
    found: dict[str, Any] = json.loads(run.stdout.splitlines()[-1])
    return found


def report(sets: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the tables of all labels."""
    lines = [
        "# Growth with the number of bricks",
        "",
        "Processor seconds, all threads together, of a field of towers; made by "
        "`python -m benchmarks.scaling`. Exponents are fitted to the sizes from "
        f"{FITTED_FROM} on. Where there is no row of shortcuts, they are left out.",
    ]
    for label, found in sets.items():
        rows = found["structures"]
        loads = load_line([tuple(row["load"]) for row in rows])
        head = " | ".join(str(row["bricks"]) for row in rows)
        lines += [
            "",
            f"## {label.capitalize()}",
            "",
            f"{found['date']}, {found['machine']}; {loads}. {found.get('note', '')}".strip(),
            "",
            f"| stage | {head} | exponent |",
            "|---|" + "---:|" * (len(rows) + 1),
        ]
        whole = {"planning": PLANNING, "after planning": AFTERWARDS}
        for name, stages in {**{s: (s,) for s in STAGES}, **whole}.items():
            measured = [s for s in stages if all(s in row["cpu_s"] for row in rows)]
            if not measured:
                continue
            values = [sum(row["cpu_s"][s] for s in measured) for row in rows]
            cells = " | ".join(f"{value:.2f}" for value in values)
            bold = "**" if name in whole else ""
            power = _power([row["bricks"] for row in rows], values)
            lines.append(f"| {bold}{name}{bold} | {cells} | {power} |")
        for key, name, form in (
            ("memory_before_mib", "memory before shortcuts [MiB]", "{:.0f}"),
            ("memory_mib", "memory [MiB]", "{:.0f}"),
            ("cost", "cost [rad]", "{:.1f}"),
            ("makespan_s", "makespan [s]", "{:.0f}"),
            ("violations", "violations", "{:.0f}"),
        ):
            if any(row.get(key) is None for row in rows):
                continue
            cells = " | ".join(form.format(row[key]) for row in rows)
            lines.append(f"| {name} | {cells} | |")
    return "\n".join(lines) + "\n"


def _power(sizes: Sequence[int], seconds: Sequence[float]) -> str:
    large = [(n, s) for n, s in zip(sizes, seconds, strict=True) if n >= FITTED_FROM]
    if len(large) < 2:
        return ""
    return f"{exponent(*zip(*large, strict=True)):.2f}"


def main() -> int:
    """Measure and write the result files, or print the table of some sizes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bricks", nargs="*", type=int, metavar="BRICKS")
    parser.add_argument("--label", default="after", help="of the set of results")
    parser.add_argument("--shortcuts", action="store_true", help="take shortcuts too")
    parser.add_argument("--one", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        one = measure(options.one, shortcuts=options.shortcuts)
        sys.stdout.write(json.dumps(asdict(one)) + "\n")
        return 0
    rows: list[dict[str, Any]] = []
    found = {"date": date_line(), "machine": machine_line(), "structures": rows}
    for bricks in options.bricks or (SHORTCUT_SIZES if options.shortcuts else SIZES):
        rows.append(_in_process_of_its_own(bricks, shortcuts=options.shortcuts))
        spent = {k: round(v, 2) for k, v in rows[-1]["cpu_s"].items()}
        sys.stderr.write(f"{bricks}: {spent}, {rows[-1]['memory_mib']} MiB\n")
        if not options.bricks:
            _write(options.label, found)
    if options.bricks:
        sys.stdout.write(report({options.label: found}))
    return 0


def _write(label: str, found: dict[str, Any]) -> None:
    """Write the result files with one label anew, as far as it has come."""
    RESULTS.mkdir(exist_ok=True)
    file = RESULTS / "scaling.json"
    sets = json.loads(file.read_text()) if file.exists() else {}
    sets[label] = found
    file.write_text(json.dumps(sets, indent=1) + "\n")
    (RESULTS / "scaling.md").write_text(report(sets))


if __name__ == "__main__":
    sys.exit(main())

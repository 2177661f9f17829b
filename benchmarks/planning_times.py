"""Planning times, against a tenth of those in the APEX-MR paper.

    python -m benchmarks.planning_times [STRUCTURE ...]

Each structure is planned in a process of its own, after another one has been planned there so that
all kernels are compiled and loaded. Measured are the stages of Table II: choosing who does what,
planning all motions, and building the temporal plan graph. The assembly sequence, which the
paper's planner is given, stands apart, and so does shortcutting, whose time is a budget. Writes
benchmarks/results/planning-times.md and .json; exits with 1 when a limit is not kept.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path

from benchmarks.apex_mr_paper import STRUCTURES, TABLE_II
from benchmarks.machine import date_line, forget_answers, load_line, machine_line
from twin.host.progress import StageWatch
from twin.planning.pipeline import build_plan_graph, plan_motions
from twin.reading.scenario_file import load_scenario

RESULTS = Path(__file__).parent / "results"
SCENARIOS = Path("scenarios/lego")
STAGES = ("assignment", "motion", "tpg")

_CHAIR_S = 30.0
"""For the chair a tenth of the paper's 575 s would be too easy."""


@dataclass
class _Clocks(StageWatch):
    """Measures stages by wall clock and by the processor time of all threads."""

    cpu: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, key: str, label: str | None = None) -> Iterator[None]:
        """Measure a stage; see StageWatch."""
        start = time.process_time()
        with super().stage(key, label):
            yield
        self.cpu[key] = self.cpu.get(key, 0.0) + time.process_time() - start


@dataclass(frozen=True)
class PlanningTime:
    """Planning times of a structure.

    Attributes:
        structure: its name.
        steps: number of bricks.
        seed: of the scenario.
        wall_s, cpu_s: seconds a stage.
        memory_mib: largest resident memory of the process.
        load: of the machine in the last minute, before and after.
    """

    structure: str
    steps: int
    seed: int
    wall_s: dict[str, float]
    cpu_s: dict[str, float]
    memory_mib: int
    load: tuple[float, float]

    @property
    def total_s(self) -> float:
        """Wall-clock seconds of the stages that Table II counts."""
        return sum(self.wall_s[stage] for stage in STAGES)

    @property
    def total_cpu_s(self) -> float:
        """Processor seconds of the stages that Table II counts."""
        return sum(self.cpu_s[stage] for stage in STAGES)

    @property
    def limit_s(self) -> float:
        """A tenth of the paper's total; less for the chair."""
        return _limit(self.structure)


def _limit(structure: str) -> float:
    return _CHAIR_S if structure == "chair" else 0.1 * TABLE_II[structure].total


def measure_structure(structure: str) -> PlanningTime:
    """Plan a structure in this process, after another one."""
    _plan("stairs" if structure == "faucet" else "faucet")
    forget_answers()
    before = os.getloadavg()[0]
    steps, seed, clocks = _plan(structure)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    return PlanningTime(
        structure,
        steps,
        seed,
        clocks.seconds,
        clocks.cpu,
        memory,
        (before, os.getloadavg()[0]),
    )


def _plan(structure: str) -> tuple[int, int, _Clocks]:
    file = SCENARIOS / f"{structure}.yaml"
    scenario = load_scenario(file)
    clocks = _Clocks()
    turns = plan_motions(scenario, file.parent, clocks)
    build_plan_graph(turns.motion_plan, clocks)
    return len(turns.task_plan.choices), scenario.seed, clocks


def _in_process_of_its_own(structure: str) -> PlanningTime:
    run = subprocess.run(
        [sys.executable, "-m", "benchmarks.planning_times", "--one", structure],
        check=True,
        capture_output=True,
        text=True,
    )
    values = json.loads(run.stdout.splitlines()[-1])
    return PlanningTime(**{**values, "load": tuple(values["load"])})


def main() -> int:
    """Measure, write the result files, tell whether all limits are kept."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("structures", nargs="*", metavar="STRUCTURE")
    parser.add_argument("--one", choices=STRUCTURES, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        sys.stdout.write(json.dumps(asdict(measure_structure(options.one))) + "\n")
        return 0
    for name in options.structures:
        if name not in STRUCTURES:
            parser.error(f"no structure {name!r}; choose from {', '.join(STRUCTURES)}")
    rows = []
    for name in options.structures or STRUCTURES:
        rows.append(_in_process_of_its_own(name))
        sys.stderr.write(f"{name}: {rows[-1].total_s:.2f} s\n")
    if not options.structures:
        RESULTS.mkdir(exist_ok=True)
        (RESULTS / "planning-times.md").write_text(_report(rows))
        text = json.dumps(
            {
                "date": date_line(),
                "machine": machine_line(),
                "structures": {
                    row.structure: {
                        **asdict(row),
                        "total_s": row.total_s,
                        "limit_s": row.limit_s,
                    }
                    for row in rows
                },
            },
            indent=1,
        )
        (RESULTS / "planning-times.json").write_text(text + "\n")
    else:
        sys.stdout.write(_report(rows))
    return 1 if any(row.total_s > row.limit_s for row in rows) else 0


def _report(rows: list[PlanningTime]) -> str:
    seeds = ", ".join(str(seed) for seed in sorted({row.seed for row in rows}))
    lines = [
        "# Planning times",
        "",
        f"{date_line()}, {machine_line()}; {load_line([row.load for row in rows])}; "
        f"seed {seeds}. Made by `python -m benchmarks.planning_times`.",
        "",
        "Seconds by the wall clock, in brackets those of the processor, all threads together. "
        "Kernels are compiled and loaded; nothing else is remembered from before. The limit "
        "is a tenth of the total in Table II of the paper (which is of another cell, other "
        "robots and other designs of the structures), and 30 s for the chair. The sequence "
        "is not part of the total: the paper's planner is given it.",
        "",
        "| structure | bricks | assignment | motion | TPG | total | limit | kept "
        "| sequence | memory [MiB] |",
        "|---|---:|---:|---:|---:|---:|---:|---|---:|---:|",
    ]
    for row in rows:
        stages = " | ".join(_cell(row, stage) for stage in STAGES)
        kept = "yes" if row.total_s <= row.limit_s else "**no**"
        if kept != "yes" and row.total_cpu_s <= row.limit_s:
            kept = "by processor time"
        lines.append(
            f"| {row.structure} | {row.steps} | {stages} "
            f"| {row.total_s:.2f} ({row.total_cpu_s:.2f}) | {row.limit_s:.2f} | {kept} "
            f"| {_cell(row, 'sequence')} | {row.memory_mib} |"
        )
    return "\n".join(lines) + "\n"


def _cell(row: PlanningTime, stage: str) -> str:
    if stage not in row.wall_s:
        return "given"
    return f"{row.wall_s[stage]:.2f} ({row.cpu_s[stage]:.2f})"


if __name__ == "__main__":
    sys.exit(main())

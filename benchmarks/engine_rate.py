"""Rate of the event engine: full runs a second in one process.

    python -m benchmarks.engine_rate scenarios/lego/cliff.yaml --runs 300

Plans the scenario (or takes ``--plan DIR``), then executes that plan again and again with durations
drawn anew: undisturbed with chains contracted, node by node, with messages that take time, and
with everything that can be disturbed. Counts the process's own CPU time. Writes
benchmarks/results/engine_rate_<scenario>.md.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from benchmarks.machine import date_line, machine_line
from scheduling.graph.plan_files import load_plan
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations import Uniform, packaged_timings
from twin.engine.engine import Simulator
from twin.engine.execution_model import ExecutionModel, Messages
from twin.recorders.observers import MemoryRecorder
from twin.run.run_record import ExecutionRecord
from twin.scenario.file import load_scenario
from twin.uncertainty.contraction import contract
from twin.uncertainty.disturbances import (
    Breakdowns,
    Disturbances,
    EmergencyStop,
    SkillFailure,
    Stalls,
)
from twin.uncertainty.skill_durations import SkillDurations

RESULTS = Path(__file__).parent / "results"
DISTURBED = Disturbances(
    jitter=Uniform(low_s=0.0, high_s=0.01),
    stalls=Stalls(rate_per_h=60.0, duration=Uniform(low_s=1.0, high_s=20.0)),
    breakdowns=Breakdowns(mtbf_s=600.0, mttr_s=30.0),
    failures={"pick": SkillFailure(probability=0.1, retries=5)},
    emergency_stops=(EmergencyStop(robot=None, at_s=60.0, duration_s=15.0),),
)


@dataclass(frozen=True)
class Rate:
    """Rate of one kind of run.

    Attributes:
        what: kind of run.
        runs: how many were measured.
        cpu_s: CPU seconds that they took.
        makespan_s: mean makespan [s].
    """

    what: str
    runs: int
    cpu_s: float
    makespan_s: float


def measure(what: str, runs: int, execute: Callable[[int], ExecutionRecord]) -> Rate:
    """Execute replications 1 to ``runs``, after one that warms up."""
    execute(0)
    begin = time.process_time()
    total = sum(execute(replication).makespan_s for replication in range(1, runs + 1))
    return Rate(what, runs, time.process_time() - begin, total / runs)


def rates(tpg: TemporalPlanGraph, runs: int) -> list[Rate]:
    """Measure every kind of run of a plan."""
    durations = SkillDurations(packaged_timings())
    plain = Simulator(tpg, ExecutionModel(durations))
    messages = Messages.of_seconds(3, 0.005, 0.005)
    late = Simulator(tpg, ExecutionModel(durations, messages=messages))
    disturbed = Simulator(tpg, ExecutionModel(durations, disturbances=DISTURBED))
    few = max(runs // 10, 1)
    return [
        measure("chains contracted", runs, lambda r: plain.run(seed=0, replication=r)),
        measure(
            "disturbed, chains contracted",
            runs,
            lambda r: disturbed.run(seed=0, replication=r),
        ),
        measure(
            "5 ms latency, 3 nodes ahead",
            few,
            lambda r: late.run(seed=0, replication=r),
        ),
        measure(
            "every event recorded",
            few,
            lambda r: plain.run(seed=0, replication=r, recorders=[MemoryRecorder()]),
        ),
    ]


def main() -> int:
    """Measure and write the result file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenario", type=Path)
    parser.add_argument("--plan", type=Path, help="folder of an earlier run")
    parser.add_argument("--runs", type=int, default=300)
    options = parser.parse_args()
    scenario = load_scenario(options.scenario)
    if options.plan is None:
        from twin.trial.planning import plan_scenario

        tpg = plan_scenario(scenario, options.scenario.parent).tpg
    else:
        tpg = load_plan(options.plan)
    rows = rates(tpg, options.runs)
    RESULTS.mkdir(exist_ok=True)
    target = RESULTS / f"engine_rate_{scenario.name}.md"
    target.write_text(_report(scenario.name, tpg, rows))
    sys.stdout.write(target.read_text())
    return 0


def _report(name: str, tpg: TemporalPlanGraph, rows: list[Rate]) -> str:
    nodes = sum(len(chain) for chain in tpg.chains)
    segments = sum(len(chain) for chain in contract(tpg).tpg.chains)
    lines = [
        f"# {name}: rate of the event engine",
        "",
        f"{date_line()}, {machine_line()}. One process, its CPU time. The plan has {nodes} nodes "
        f"and {len(tpg.edges)} type-2 edges; contracted, {segments} segments.",
        "",
        "| run | runs | CPU [s] | runs/s | mean makespan [s] |",
        "|---|---:|---:|---:|---:|",
    ]
    lines += [
        f"| {r.what} | {r.runs} | {r.cpu_s:.2f} | {r.runs / r.cpu_s:.0f} | {r.makespan_s:.1f} |"
        for r in rows
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())

"""Many runs of one plan with random stalls: none may deadlock, no audit may find anything.

    python -m benchmarks.stalled_runs scenarios/lego/cliff.yaml --runs 20

Every robot stands still at ``--stalls`` random nodes for 1 to 20 s each; each run has a seed of
its own. Writes benchmarks/results/stalled_runs_<scenario>.md and exits with 1 on any failure.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from benchmarks.machine import date_line, machine_line
from scheduling.temporal_plan_graph import TemporalPlanGraph
from twin.pipeline import plan_scenario
from twin.run_folder import prepare_run_folder
from twin.scenario import Scenario
from twin.scenario_disturbances import StallsSection
from twin.scenario_file import load_scenario
from twin.trial import Keep, try_plan

RESULTS = Path(__file__).parent / "results"


@dataclass(frozen=True)
class StalledRun:
    """One run with stalls.

    Attributes:
        seed: of durations and stalls.
        outcome: completed, failed or aborted.
        makespan_s: with the stalls [s].
        violations: what the audit found.
        configurations: configurations audited.
        least_m: least distance between robots [m].
    """

    seed: int
    outcome: str
    makespan_s: float
    violations: int
    configurations: int
    least_m: float


def run_with_stalls(
    scenario: Scenario, tpg: TemporalPlanGraph, base: Path, seed: int, stalls: int
) -> StalledRun:
    """Execute a plan once with random stalls and audit it.

    Args:
        scenario: what the plan was made for.
        tpg: the plan.
        base: where relative paths of the scenario start.
        seed: of durations and stalls.
        stalls: nodes of each robot that stall, for 1 to 20 s each.
    """
    section = StallsSection(count_per_robot=stalls, duration_s=(1.0, 20.0))
    execution = scenario.execution.model_copy(update={"stalls": section})
    chosen = scenario.model_copy(update={"seed": seed, "execution": execution})
    with tempfile.TemporaryDirectory() as scratch:
        folder = prepare_run_folder(Path(scratch) / "run", chosen.name)
        trial = try_plan(chosen, tpg, folder, base=base, keep=Keep(recording=False))
    audit = trial.summary["audit"]
    return StalledRun(
        seed,
        trial.run.outcome,
        trial.run.makespan_s,
        len(audit["violations"]),
        audit["configurations"],
        audit["min_distance_m"],
    )


def main() -> int:
    """Measure, write the result file, tell whether all runs passed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenario", type=Path)
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--stalls", type=int, default=20)
    options = parser.parse_args()
    scenario = load_scenario(options.scenario)
    base = options.scenario.parent
    tpg = plan_scenario(scenario, base).tpg
    rows = []
    for seed in range(options.runs):
        row = run_with_stalls(scenario, tpg, base, seed, options.stalls)
        rows.append(row)
        sys.stderr.write(f"{row}\n")
    RESULTS.mkdir(exist_ok=True)
    target = RESULTS / f"stalled_runs_{scenario.name}.md"
    target.write_text(_report(scenario, rows, options.stalls))
    bad = [r for r in rows if r.outcome != "completed" or r.violations]
    sys.stderr.write(f"{target}: {len(rows) - len(bad)} of {len(rows)} runs passed\n")
    return 1 if bad else 0


def _report(scenario: Scenario, rows: list[StalledRun], stalls: int) -> str:
    lines = [
        f"# {scenario.name}: {len(rows)} runs with stalls",
        "",
        f"{date_line()}, {machine_line()}. Plan of seed {scenario.seed}; every robot stands "
        f"still at {stalls} random nodes for 1 to 20 s each.",
        "",
        "| seed | outcome | makespan [s] | audit violations | configurations audited "
        "| least distance of robots [mm] |",
        "|---:|---|---:|---:|---:|---:|",
    ]
    lines += [
        f"| {r.seed} | {r.outcome} | {r.makespan_s:.1f} | {r.violations} "
        f"| {r.configurations} | {r.least_m * 1e3:.2f} |"
        for r in rows
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())

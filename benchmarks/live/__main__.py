"""Two Franka arms in franky-sim stack cubes by a plan: where cubes end, tracking, forecast and latency.

    python -m benchmarks.live [--runs 10] [--fit 3] [--stop-and-go 3] [--out FOLDER]

The scenario is planned once, and driven again and again by ``twin operate``'s session in MuJoCo's world. The
first runs are what durations are taken from; the runs after them are held against the forecast that the twin
makes with these. The last ones are driven as by a client that sends one trajectory after another. The
simulator needs a core for itself: times are given by its own clock, latencies by that on the wall.
Needs the packages franky-control and franky-sim. Figures are kept as they come; runs that are there are not
driven again.
"""

import argparse
import json
import sys
from collections import defaultdict
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.live.driven import Driven, drive, latencies_s
from benchmarks.machine import machine_line
from planning.tasks.task import TaskKind
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.engine.engine import Simulator
from twin.trial.loaded_scenario import load
from twin.trial.plan_result import PlanResult
from twin.trial.planning import plan_scenario
from twin.trial.simulation import scenario_execution

SCENARIO = Path(__file__).parents[2] / "scenarios" / "assembly" / "fr3_cubes.yaml"
_FUTURES = 1000


@dataclass(frozen=True)
class Figures:
    """What came of one run.

    Attributes:
        outcome: how it ended.
        passed: whether it was completed and the audit found nothing in what was measured.
        off_mm, tilt_deg: farthest and most tilted that a cube stands from its goal.
        joint_rad, tool_mm: farthest that a joint, and a tool, was from its path.
        makespan_s: by the simulator's clock.
        wall_s: by that on the wall.
        latencies_s: from complete to the next motion, by the clock on the wall.
        skills: what each skill of each robot took, by the simulator's clock [s].
        motions: what motions of each robot took, of what was planned.
    """

    outcome: str
    passed: bool
    off_mm: float
    tilt_deg: float
    joint_rad: float
    tool_mm: float
    makespan_s: float
    wall_s: float
    latencies_s: list[float]
    skills: dict[str, list[float]]
    motions: dict[str, float]


def figures_of(done: Driven) -> Figures:
    """Return the figures of a run."""
    tpg, record = done.run.tpg, done.run.record
    assert record is not None
    goals = {h.object: h.pose for h in tpg.handlings if h.holder is None}
    off, tilt = [], []
    for name, goal in goals.items():
        pose = done.poses[name]
        off.append(1000.0 * float(np.linalg.norm(pose[:3, 3] - goal[:3, 3])))
        tilt.append(float(np.degrees(np.arccos(np.clip(pose[2, 2], -1.0, 1.0)))))
    skills, motions = _durations(tpg, done)
    return Figures(
        record.outcome,
        done.run.passed,
        max(off),
        max(tilt),
        max(own.joint for own in done.off.values()),
        1000.0 * max(own.tool_m for own in done.off.values()),
        done.makespan_s,
        done.wall_s,
        latencies_s(tpg, record).tolist(),
        skills,
        motions,
    )


def _durations(
    tpg: TemporalPlanGraph, done: Driven
) -> tuple[dict[str, list[float]], dict[str, float]]:
    skills: dict[str, list[float]] = defaultdict(list)
    motions = {}
    for chain, start, end in zip(tpg.chains, done.start_s, done.end_s, strict=True):
        took = planned = 0.0
        for task in np.unique(chain.task):
            nodes = np.flatnonzero(chain.task == task)
            about = tpg.tasks[int(task)]
            own = float((end[nodes] - start[nodes]).sum())
            if about.kind in (TaskKind.TRANSIT, TaskKind.STRAIGHT):
                took, planned = took + own, planned + float(chain.duration[nodes].sum())
            else:
                skills[f"{about.kind}/{chain.robot}"].append(own)
        motions[chain.robot] = took / planned
    return dict(skills), motions


def forecast_s(
    plan: PlanResult, seen: list[Figures], out: Path
) -> np.ndarray[Any, Any]:
    """Return makespans of futures with the durations of runs that have been seen, rising [s]."""
    skills: dict[str, list[float]] = defaultdict(list)
    speeds: dict[str, list[float]] = defaultdict(list)
    for run in seen:
        for name, own in run.skills.items():
            skills[name] += own
        for robot, ratio in run.motions.items():
            speeds[robot].append(1.0 / ratio)
    overrides = []
    for name, own in skills.items():
        skill, robot = name.split("/")
        file = out.resolve() / f"{skill}-{robot}.csv"
        file.write_text("duration_s\n" + "".join(f"{s!r}\n" for s in own))
        duration = {"kind": "empirical", "csv": str(file)}
        overrides.append({"skill": skill, "robot": robot, "duration": duration})
    factors = {
        robot: {"kind": "uniform", "low": min(own), "high": max(own)}
        for robot, own in speeds.items()
    }
    case = plan.scenario.varied(
        {"skill_overrides": overrides, "speed": {"robots": factors}}
    )
    simulator = Simulator(plan.tpg, scenario_execution(case.sections, case.folder))
    made = [simulator.run(seed=1, replication=r).makespan_s for r in range(_FUTURES)]
    return np.sort(made)


def _tell(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def _runs(plan: PlanResult, out: Path, kind: str, count: int) -> list[Figures]:
    """Drive a plan so many times, or take the figures of what was driven before."""
    found = []
    for k in range(count):
        file = out / f"{kind}-{k}.json"
        if not file.exists():
            folder = out / f"{kind}-{k}"
            own = figures_of(drive(plan, folder, stop_and_go=kind == "stop-and-go"))
            file.write_text(json.dumps(asdict(own), indent=1) + "\n", encoding="utf-8")
        run = Figures(**json.loads(file.read_text(encoding="utf-8")))
        _tell(
            f"{kind} {k}: {run.outcome}, audit {'clean' if run.passed else 'NOT CLEAN'}, cubes {run.off_mm:.1f} mm"
            f" and {run.tilt_deg:.1f} deg off, joints {1000 * run.joint_rad:.1f} mrad, tools {run.tool_mm:.1f} mm,"
            f" {run.makespan_s:.2f} s, {run.wall_s:.1f} s on the wall"
        )
        found.append(run)
    return found


def _spread(values: list[float], unit: str = "s") -> str:
    low, middle, high = min(values), float(np.median(values)), max(values)
    return f"{middle:.2f} ({low:.2f} to {high:.2f}) {unit}"


def main() -> int:
    """Run the benchmark; 1 where a run was not executed to its end."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.live")
    parser.add_argument("scenario", nargs="?", type=Path, default=SCENARIO)
    parser.add_argument("--fit", type=int, default=3, help="runs that durations are of")
    parser.add_argument("--runs", type=int, default=10, help="runs that are foreseen")
    parser.add_argument("--stop-and-go", type=int, default=3, help="runs driven so")
    parser.add_argument("--out", type=Path, default=Path("logs/live"))
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    plan = plan_scenario(load(given.scenario), keep=True)
    planned = Simulator(
        plan.tpg,
        scenario_execution(plan.scenario.sections, plan.scenario.folder),
    ).run(seed=plan.scenario.sections.seed)
    _tell(f"planned: {planned.makespan_s:.2f} s; {machine_line()}")
    seen = _runs(plan, given.out, "fit", given.fit)
    runs = _runs(plan, given.out, "run", given.runs)
    stopping = _runs(plan, given.out, "stop-and-go", given.stop_and_go)
    if seen and runs:
        futures = forecast_s(plan, seen, given.out)
        low, middle, high = np.quantile(futures, (0.025, 0.5, 0.975))
        inside = sum(low <= run.makespan_s <= high for run in runs)
        _tell(
            f"forecast {middle:.2f} s, 95 % between {low:.2f} and {high:.2f}; measured"
            f" {_spread([run.makespan_s for run in runs])}: {inside} of {len(runs)} inside"
        )
    for name, own in (("session", seen + runs), ("stop and go", stopping)):
        waits = [1000.0 * s for run in own for s in run.latencies_s]
        if waits:
            _tell(
                f"{name}: {_spread([run.makespan_s for run in own])}; from complete to the next motion"
                f" {np.median(waits):.0f} ms, P95 {np.quantile(waits, 0.95):.0f} ms, {len(waits)} times"
            )
    return 0 if all(r.outcome == "completed" for r in seen + runs + stopping) else 1


if __name__ == "__main__":
    sys.exit(main())

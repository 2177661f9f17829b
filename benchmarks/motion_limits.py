"""Makespans within limits of acceleration, and whether anything leaves them when robots are late.

    python -m benchmarks.motion_limits                          # all shipped structures
    python -m benchmarks.motion_limits scenarios/lego/cliff.yaml --stalled 5
    python -m benchmarks.motion_limits --corners                # only figures of corners

Each scenario is planned as its file says, at full speed at once. The same plan then gets the times of
motions within limits of 2, 5 and 10 rad/s2 (and as many m/s2 for joints that slide; an acceleration
builds up in 50 ms), and is executed: without limits and with each, with the same drawn skills. At 5
rad/s2 it is executed again with stalls (every robot stands still at 10 random nodes for 1 to 20 s), and
with messages that take 50 and 500 ms and motions that jitter. Of each run: speeds, accelerations and
jerks of every joint as shares of their limits, and whether anybody is inside a node before all that it
waits for is complete. PyBullet audits the run at 5 rad/s2 and ``--audited`` stalled ones.

Last, the corners of the same plan are rounded within 5 rad/s2: by nominal durations, what that saves of
what resting at corners costs, and whether anything is wrong with the run as planned and with stalls.

Writes benchmarks/results/motion_limits.json after every scenario, and motion_limits.md of that.
"""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.machine import date_line, machine_line
from planning.cell.robot_model import BUILD_UP_S, MotionLimits
from scheduling.graph.dispatcher import earliest_times
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.motion_times import nominal_durations, within_limits
from scheduling.shortcuts.corners import round_corners
from twin.audit.audit import Auditor
from twin.audit.motion.executed import read_recording
from twin.durations.bounded import Uniform
from twin.durations.model import NANOSECONDS
from twin.engine.engine import Simulator
from twin.engine.execution_model import ExecutionModel, Messages
from twin.host.guard import write_json
from twin.recorders.observers import objects_table, trajectory_table, write_table
from twin.run.events import ExecutionRecord
from twin.run.folder import OBJECTS, TRAJECTORY
from twin.run.trajectory import object_placements, robot_trajectories
from twin.scenario.manifest import load_scenario
from twin.scenario.sections.scenario import Scenario
from twin.scenario.variations import varied
from twin.trial.planning import plan_scenario
from twin.trial.simulation import scenario_execution
from twin.uncertainty.disturbances import Disturbances, Stalls


def corner_figures(
    rested: TemporalPlanGraph, executed: Callable[[TemporalPlanGraph], list[str]]
) -> dict[str, Any]:
    """Return what corners cost and what rounding them saves, by nominal durations.

    Args:
        rested: a graph within limits whose robots rest at corners.
        executed: executes a graph and returns what is wrong with it.
    """
    begin = time.process_time()
    rounded = within_limits(round_corners(rested))
    spent = time.process_time() - begin
    without, rests = _without_rests(rested)
    corners = [0 if c.corners is None else len(c.corners.bend) for c in rounded.chains]
    return {
        "rests": rests,
        "rounded": sum(corners),
        "rested_s": earliest_times(rested).makespan,
        "rounded_s": earliest_times(rounded).makespan,
        "without_rests_s": earliest_times(without).makespan,
        "rounding_cpu_s": spent,
        "violations": executed(rounded),
    }


def _without_rests(rested: TemporalPlanGraph) -> tuple[TemporalPlanGraph, int]:
    """Return a graph as if corners cost nothing, which no robot could follow, and their number."""
    chains, corners = [], 0
    for k, chain in enumerate(rested.chains):
        drive = chain.drive
        if drive is None:
            chains.append(chain)
            continue
        moves = drive.ramp > 0.0
        goes_on = moves & np.append(moves[1:], False)
        for handling in rested.handlings:
            # What changes hands does so at rest.
            if handling.robot == k:
                goes_on[handling.node - (handling.waypoint == 0)] = False
        corners += int(np.sum(goes_on & drive.rests))
        free = replace(drive, rests=drive.rests & ~goes_on)
        duration = np.where(moves, nominal_durations(free), chain.duration)
        least = np.zeros_like(duration)
        chains.append(replace(chain, duration=duration, least=least, drive=free))
    return replace(rested, chains=tuple(chains)), corners


ROOT = Path(__file__).parents[1]
RESULTS = Path(__file__).parent / "results"
FOLDERS = ("lego", "multi_arm", "construction", "assembly")
ACCELERATIONS = (2.0, 5.0, 10.0)
EXECUTED = 5.0
"""Acceleration at which plans are executed again with whatever makes robots late."""

STALLS = Stalls(count_per_robot=10, duration_s=(1.0, 20.0))
_STALLED_CORNERS = 2

LATENCIES_S = (0.05, 0.5)
JITTER = Uniform(low_s=0.0, high_s=0.02)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure some scenarios, or all; those that are in the results already are left out."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("scenarios", nargs="*", type=Path, metavar="SCENARIO")
    parser.add_argument("--stalled", type=int, default=20, help="runs with stalls")
    parser.add_argument("--audited", type=int, default=1, help="of these audited")
    parser.add_argument(
        "--corners", action="store_true", help="of rows that are there, corners alone"
    )
    options = parser.parse_args(arguments)
    target = RESULTS / "motion_limits.json"
    rows = json.loads(target.read_text()) if target.exists() else {}
    paths = options.scenarios or [
        path
        for folder in FOLDERS
        for path in sorted((ROOT / "scenarios" / folder).glob("*.yaml"))
    ]
    for path in paths:
        known = rows.get(path.stem, {})
        if options.corners:
            if known and (options.scenarios or "corners" not in known):
                known["corners"] = measure_corners(path)
        elif options.scenarios or not known:
            row = measure(path, options.stalled, options.audited)
            rows[path.stem] = row | {"corners": measure_corners(path)}
        else:
            continue
        write_json(target, rows)
        (RESULTS / "motion_limits.md").write_text(report(rows), encoding="utf-8")
        sys.stdout.write(f"{path.stem}: {json.dumps(rows.get(path.stem))}\n")
        sys.stdout.flush()
    return 1 if any(map(_violations, rows.values())) else 0


def measure_corners(path: Path) -> dict[str, Any]:
    """Return the figures of a scenario's corners."""
    scenario = _at_full_speed(load_scenario(path))
    tpg = plan_scenario(scenario, path.parent).tpg
    model = _undisturbed(scenario, path)

    def executed(rounded: TemporalPlanGraph) -> list[str]:
        worst = _Worst()
        with Auditor(rounded) as auditor:
            for seed, kind in enumerate(_runs(model, _STALLED_CORNERS)):
                run = Simulator(rounded, kind).run(seed=seed)
                worst.look(rounded, run, kind.messages)
                worst.violations += _audit(auditor, rounded, run)
        return list(worst.figures()["violations"])

    rested = within_limits(_limited(tpg, scenario, EXECUTED))
    return corner_figures(rested, executed)


def _undisturbed(scenario: Scenario, path: Path) -> ExecutionModel:
    """Return how a scenario is executed where nothing goes wrong."""
    return replace(
        scenario_execution(scenario, path.parent, policy="asynchronous"),
        disturbances=Disturbances(),
        messages=Messages(),
    )


def measure(path: Path, stalled: int, audited: int) -> dict[str, Any]:
    """Return the figures of one scenario."""
    begin = time.process_time()
    scenario = _at_full_speed(load_scenario(path))
    tpg = plan_scenario(scenario, path.parent).tpg
    model = _undisturbed(scenario, path)
    free = Simulator(tpg, model).run(seed=scenario.seed)
    row: dict[str, Any] = {
        "robots": len(tpg.chains),
        "nodes": sum(len(chain) for chain in tpg.chains),
        "makespan_s": free.makespan_s,
        "within_s": {},
    }
    limited = {a: within_limits(_limited(tpg, scenario, a)) for a in ACCELERATIONS}
    worst = _Worst()
    for acceleration, own in limited.items():
        run = Simulator(own, model).run(seed=scenario.seed)
        worst.look(own, run)
        row["within_s"][f"{acceleration:g}"] = run.makespan_s
    own = limited[EXECUTED]
    row["planned_within_s"] = _planned_within(scenario, path, model)
    late = []
    with Auditor(own) as auditor:
        for k, kind in enumerate(_runs(model, stalled)):
            run = Simulator(own, kind).run(seed=k)
            worst.look(own, run, kind.messages)
            late.append(run.makespan_s)
            if k <= audited:
                worst.violations += _audit(auditor, own, run)
    row |= {
        "late_runs": len(late),
        "late_s": [min(late), max(late)],
        "audited": audited + 1,
        "cpu_s": time.process_time() - begin,
    }
    return row | worst.figures()


def _planned_within(
    scenario: Scenario, path: Path, model: ExecutionModel
) -> float | None:
    """Return the makespan of a plan made within limits of 5 rad/s2, None for constructions [s]."""
    if scenario.assembly.kind == "construction":
        return None
    planning: dict[str, Any] = {"speed_model": "limits"}
    if scenario.speed_model == "l1":
        planning["speed_rad_s"] = scenario.planning.l1_rad_s
    limits = {"acceleration": EXECUTED, "jerk": EXECUTED / BUILD_UP_S}
    values: dict[str, Any] = {f"planning.{key}": v for key, v in planning.items()}
    for robot in scenario.cell.robots:
        for key, value in limits.items():
            values[f"cell.robots.{robot.name}.limits.{key}"] = value
    tpg = plan_scenario(varied(scenario, values), path.parent).tpg
    return Simulator(tpg, model).run(seed=scenario.seed).makespan_s


def _at_full_speed(scenario: Scenario) -> Scenario:
    """Return a scenario that is planned without limits of acceleration."""
    if scenario.speed_model != "limits":
        return scenario
    model = "joint" if scenario.planning.speed_rad_s is None else "l1"
    section = scenario.planning.model_copy(update={"speed_model": model})
    return scenario.model_copy(update={"planning": section})


def _limited(
    tpg: TemporalPlanGraph, scenario: Scenario, acceleration: float
) -> TemporalPlanGraph:
    """Return a graph whose robots have limits, with the speeds that it was planned for."""
    l1 = scenario.planning.l1_rad_s if scenario.speed_model == "l1" else np.inf
    robots = []
    for robot in tpg.cell.robots:
        n = robot.model.dof
        limits = MotionLimits(
            robot.model.velocity,
            np.full(n, acceleration),
            np.full(n, acceleration / BUILD_UP_S),
            l1,
        )
        robots.append(replace(robot, limits=limits))
    return replace(tpg, cell=replace(tpg.cell, robots=tuple(robots)))


def _runs(model: ExecutionModel, stalled: int) -> Iterator[ExecutionModel]:
    """Yield the run as planned, those with stalls, and those with slow messages and jitter."""
    yield model
    for _ in range(stalled):
        yield replace(model, disturbances=Disturbances(stalls=STALLS))
    for seconds in LATENCIES_S:
        messages = Messages.of_seconds(None, seconds, seconds)
        jittery = Disturbances(jitter=JITTER)
        yield replace(model, messages=messages, disturbances=jittery)


class _Worst:
    """The worst of all that was executed."""

    def __init__(self) -> None:
        self._shares = np.zeros(3)
        self._unfinished = 0
        self._early = 0
        self.violations: list[str] = []

    def look(
        self,
        tpg: TemporalPlanGraph,
        run: ExecutionRecord,
        messages: Messages | None = None,
    ) -> None:
        """Take note of a run."""
        self._unfinished += run.outcome != "completed"
        late = 0 if messages is None else messages.report_ns + messages.release_ns
        for edge in tpg.edges.tolist():
            r, u, s, v = edge
            done, begun = int(run.end_ns[r][u]), int(run.start_ns[s][v])
            self._early += begun < done + late
        for motion in robot_trajectories(tpg, run):
            limits = tpg.cell.robot(motion.robot).limits
            if limits is None or motion.v is None or motion.a is None:
                continue
            span = np.diff(motion.t_ns)[:, None] / NANOSECONDS
            # Accelerations are differences over the lag: what rounding makes of them is no jerk.
            rise = np.maximum(np.abs(np.diff(motion.a, axis=0)) - 1e-7, 0.0)
            shares = (
                np.abs(motion.v) / limits.velocity,
                np.abs(motion.a) / limits.acceleration,
                rise / span / limits.jerk,
            )
            worst = [float(np.max(share, initial=0.0)) for share in shares]
            self._shares = np.maximum(self._shares, worst)

    def figures(self) -> dict[str, Any]:
        """Return what was found; violations are of limits, of the order and of the audit."""
        found = list(self.violations)
        beyond = np.flatnonzero(self._shares > 1.0 + 1e-6).tolist()
        found += [
            f"beyond the limit of {('speed', 'acceleration', 'jerk')[k]}"
            for k in beyond
        ]
        if self._unfinished:
            found.append(f"{self._unfinished} runs not completed")
        if self._early:
            found.append(f"{self._early} nodes entered too early")
        return {"shares": self._shares.tolist(), "violations": found}


def _audit(auditor: Auditor, tpg: TemporalPlanGraph, run: ExecutionRecord) -> list[str]:
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        write_table(folder / TRAJECTORY, trajectory_table(robot_trajectories(tpg, run)))
        write_table(folder / OBJECTS, objects_table(object_placements(tpg, run)))
        found = auditor.audit(read_recording(folder, tpg.cell))
    return [f"{item.kind}: {item.detail}" for item in found.violations]


def report(rows: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the results as Markdown."""
    head = "".join(f" {a:g} rad/s2 | longer |" for a in ACCELERATIONS)
    lines = [
        "# Makespans within limits of acceleration",
        "",
        f"Measured {date_line()} on {machine_line()}. The same plans, executed with the same draws at full",
        "speed at once and within limits; robots rest at the corners of paths. One column is of plans that were",
        "made within limits. Then the corners of the same plan are rounded within 5 rad/s2, by nominal durations: resting",
        "at corners, rounded, and as if corners cost nothing, which no robot can follow; the share of that cost which",
        "rounding saves. Late runs, at 5 rad/s2: as planned, with stalls (10 of 1 to 20 s a robot), and with",
        "messages of 50 and 500 ms and motions that jitter; PyBullet audits the first of them. Shares are the greatest speed, acceleration and jerk of any joint in any run over its limit.",
        "Made by `python -m benchmarks.motion_limits`.",
        "",
        f"| scenario | robots | nodes | without limits [s] |{head} planned within 5 rad/s2 | corners rounded, of | resting, rounded, free [s] | saved | late runs, audited | shares | violations |",
        "|---|---:|---:|---:|"
        + "---:|---:|" * len(ACCELERATIONS)
        + "---:|---:|---:|---:|---:|---|---:|",
    ]
    for name, row in rows.items():
        free = row["makespan_s"]
        cells = "".join(
            f" {seconds:.1f} | {100 * (seconds / free - 1):.1f} % |"
            for seconds in row["within_s"].values()
        )
        shares = ", ".join(f"{share:.6f}" for share in row["shares"])
        planned = row["planned_within_s"]
        cells += " |" if planned is None else f" {planned:.1f} |"
        cells += _corner_cells(row.get("corners"))
        lines.append(
            f"| {name} | {row['robots']} | {row['nodes']} | {free:.1f} |{cells}"
            f" {row['late_runs']}, {row['audited']} | {shares} | {_violations(row)} |"
        )
    return "\n".join(lines) + "\n"


def _violations(row: Mapping[str, Any]) -> int:
    corners = row.get("corners") or {"violations": []}
    return len(row["violations"]) + len(corners["violations"])


def _corner_cells(corners: Mapping[str, Any] | None) -> str:
    if corners is None:
        return " | | |"
    rested, free = corners["rested_s"], corners["without_rests_s"]
    saved = (rested - corners["rounded_s"]) / max(rested - free, 1e-9)
    return (
        f" {corners['rounded']}, {corners['rests']} |"
        f" {rested:.2f}, {corners['rounded_s']:.2f}, {free:.2f} | {100 * saved:.0f} % |"
    )


if __name__ == "__main__":
    sys.exit(main())

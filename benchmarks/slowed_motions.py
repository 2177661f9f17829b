"""What limits of effort and of the tool's speed cost: makespans of the same plans with and without.

    python -m benchmarks.slowed_motions                                   # boat, gearbox, cliff
    python -m benchmarks.slowed_motions scenarios/multi_arm/tray.yaml     # others

Each scenario is planned once within the limits of its joints. Its plan then gets the times of motions by
these alone, with limits of effort, and with these and the tool at most 1, 0.5 and 0.25 m/s, and is executed
with the same drawn skills. Writes benchmarks/results/slowed_motions.json after every scenario, and
slowed_motions.md of that.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.machine import date_line, machine_line
from planning.cell.workcell import PlacedRobot
from planning.timing.torque import why_unchecked
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.motion_times import within_limits
from scheduling.slowed_motions import motions, slowed_motions
from twin.engine.engine import Simulator
from twin.host.atomic import write_json
from twin.planning.pipeline import plan_scenario
from twin.scenario.file import load_scenario
from twin.scenario.variations import varied
from twin.trial.simulation import scenario_execution

ROOT = Path(__file__).parents[1]
RESULTS = Path(__file__).parent / "results"
SCENARIOS = ("multi_arm/assembly", "assembly/gearbox", "lego/cliff")
TOOL_SPEEDS_M_S = (1.0, 0.5, 0.25)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure some scenarios."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("scenarios", nargs="*", type=Path, metavar="SCENARIO")
    options = parser.parse_args(arguments)
    target = RESULTS / "slowed_motions.json"
    rows = json.loads(target.read_text()) if target.exists() else {}
    shipped = [ROOT / "scenarios" / f"{name}.yaml" for name in SCENARIOS]
    for path in options.scenarios or shipped:
        rows[path.stem] = measure(path)
        write_json(target, rows)
        (RESULTS / "slowed_motions.md").write_text(report(rows), encoding="utf-8")
        sys.stdout.write(f"{path.stem}: {json.dumps(rows[path.stem])}\n")
        sys.stdout.flush()
    return 0


def measure(path: Path) -> dict[str, Any]:
    """Return the figures of one scenario."""
    scenario = varied(load_scenario(path), {"planning.speed_model": "limits"})
    begin = time.process_time()
    tpg = plan_scenario(scenario, path.parent).tpg
    planning_s = time.process_time() - begin
    model = scenario_execution(scenario, path.parent, policy="asynchronous")
    cases: dict[str, TemporalPlanGraph] = {
        "joints": _with(tpg, _without_efforts),
        "efforts": tpg,
    }
    for speed in TOOL_SPEEDS_M_S:
        cases[f"{speed:g} m/s"] = _with(tpg, partial(_capped, speed))
    found = {}
    for name, case in cases.items():
        begin = time.process_time()
        timed = within_limits(case)
        cpu_s = time.process_time() - begin
        run = Simulator(timed, model).run(seed=scenario.seed)
        found[name] = {
            "makespan_s": run.makespan_s,
            "cpu_s": cpu_s,
            "slowed": slowed_motions(timed),
        }
    checked = [why_unchecked(robot) is None for robot in tpg.cell.robots]
    return {
        "robots": len(tpg.chains),
        "checked": sum(checked),
        "motions": sum(len(motions(chain)) for chain in tpg.chains),
        "planning_cpu_s": planning_s,
        "cases": found,
    }


def _with(
    tpg: TemporalPlanGraph, change: Callable[[PlacedRobot], PlacedRobot]
) -> TemporalPlanGraph:
    robots = tuple(map(change, tpg.cell.robots))
    return replace(tpg, cell=replace(tpg.cell, robots=robots))


def _without_efforts(robot: PlacedRobot) -> PlacedRobot:
    drives = robot.model.drives
    assert drives is not None
    free = replace(drives, effort=np.full_like(drives.effort, np.inf))
    return replace(robot, model=replace(robot.model, drives=free))


def _capped(speed: float, robot: PlacedRobot) -> PlacedRobot:
    assert robot.limits is not None
    return replace(robot, limits=replace(robot.limits, tool_speed=speed))


def report(rows: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the results as Markdown."""
    names = ("efforts", *(f"{speed:g} m/s" for speed in TOOL_SPEEDS_M_S))
    head = "".join(f" {name} | longer | by efforts, tool |" for name in names)
    lines = [
        "# Makespans within limits of effort and of the tool's speed",
        "",
        f"Measured {date_line()} on {machine_line()}. The same plans, executed with the same draws: by the speeds,",
        "accelerations and jerks of joints alone; with the efforts of joints; with these and the tool at most so fast. Shares",
        "are of the stretches and skills that are slowed down by efforts, and by the tool's speed. Efforts of robots are kept",
        "to where their descriptions have efforts and masses (checked). Made by `python -m benchmarks.slowed_motions`.",
        "",
        f"| scenario | robots, checked | joints alone [s] |{head} cost of efforts, share of planning |",
        "|---|---:|---:|" + "---:|---:|---:|" * len(names) + "---:|",
    ]
    for name, row in rows.items():
        cases = row["cases"]
        free = cases["joints"]["makespan_s"]
        cells = "".join(
            f" {cases[case]['makespan_s']:.1f} |"
            f" {100 * (cases[case]['makespan_s'] / free - 1):.1f} % |"
            f" {_shares(cases[case]['slowed'], row['motions'])} |"
            for case in names
        )
        cost = cases["efforts"]["cpu_s"] - cases["joints"]["cpu_s"]
        cells += f" {cost:.2f} s, {100 * cost / row['planning_cpu_s']:.2f} % |"
        lines.append(
            f"| {name} | {row['robots']}, {row['checked']} | {free:.1f} |{cells}"
        )
    return "\n".join(lines) + "\n"


def _shares(slowed: Mapping[str, Any], count: int) -> str:
    """Return the shares of motions that are slowed by efforts, and by the tool's speed."""
    if not slowed:
        return "none"
    by = {"effort": 0, "tool": 0}
    for own in slowed.values():
        for cause, counts in own["by"].items():
            by[cause.split()[0]] += counts["stretches"] + counts["skills"]
    return ", ".join(f"{100 * by[cause] / count:.0f} %" for cause in by)


if __name__ == "__main__":
    sys.exit(main())

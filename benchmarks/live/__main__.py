"""Two Franka arms in franky-sim stack cubes by a plan: where cubes end, tracking, and how long it takes.

    python -m benchmarks.live [SCENARIO] [--plan FOLDER] [--out FILE]

The scenario is planned, or a plan of it is read; MuJoCo's world is made of its cell; the plan is driven by
``FrankaDriver``, one a robot, node by node as it is cleared. Needs the packages franky-control and
franky-sim. The simulator takes a core for itself: times are given by its own clock, too.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np

import twin
from benchmarks.live.driven import Driven, drive
from benchmarks.live.scene import OPENING, Scene
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.drivers.franka import FrankaDriver, HandGrip

SCENARIO = Path(__file__).parents[2] / "scenarios" / "assembly" / "fr3_cubes.yaml"


def drivers_of(
    tpg: TemporalPlanGraph, addresses: dict[str, str]
) -> dict[str, FrankaDriver]:
    """Return a driver for each robot of a plan, with the limits that the plan keeps to."""
    found = {}
    width = float(np.median([item.size[1] for item in tpg.cell.objects]))
    # Simulated fingers are springs of 1 N/mm each.
    grip = HandGrip(width=width, opening=OPENING, goal=0.0, force=30.0)
    for robot in tpg.cell.robots:
        assert robot.limits is not None
        found[robot.name] = FrankaDriver(
            addresses[robot.name], robot.limits, grip=grip, realtime=False
        )
    return found


def _tell(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def report(tpg: TemporalPlanGraph, done: Driven, planned_s: float) -> dict[str, object]:
    """Print and return what came of it."""
    goals = {h.object: h.pose for h in tpg.handlings if h.holder is None}
    rows = {}
    for name, goal in goals.items():
        pose = done.poses[name]
        off = pose[:3, 3] - goal[:3, 3]
        turn = np.degrees(np.arccos(np.clip(pose[2, 2], -1.0, 1.0)))
        rows[name] = {"off_mm": (1000 * off).round(2).tolist(), "tilt_deg": turn}
        far = 1000 * np.linalg.norm(off)
        _tell(f"{name}: {far:.1f} mm off its goal, tilted by {turn:.1f} deg")
    for robot, off_rad in done.off.items():
        far = 1000 * done.tool_off[robot]
        _tell(
            f"{robot}: joints at most {off_rad:.4f} rad, tool {far:.1f} mm from its path"
        )
    _tell(
        f"makespan {done.simulated_s:.1f} s by the simulator's clock, {done.wall_s:.1f} s"
        f" by that on the wall; planned {planned_s:.1f} s"
    )
    if done.failed:
        _tell(f"not finished: {done.failed}")
    return {
        "cubes": rows,
        "off_rad": done.off,
        "tool_off_m": done.tool_off,
        "makespan_s": done.simulated_s,
        "wall_s": done.wall_s,
        "planned_s": planned_s,
        "failed": done.failed,
    }


def main() -> int:
    """Run the benchmark; 1 where the plan was not executed to its end."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.live")
    parser.add_argument("scenario", nargs="?", type=Path, default=SCENARIO)
    parser.add_argument("--plan", type=Path, help="folder of a run whose plan is taken")
    parser.add_argument("--out", type=Path, help="file for the figures")
    given = parser.parse_args()
    begin = time.process_time()
    plan = twin.read_plan(given.plan) if given.plan else twin.plan(given.scenario)
    planned_s = twin.simulate(plan).makespan_s
    _tell(f"planned in {time.process_time() - begin:.1f} CPU s")
    tpg = plan.tpg
    starts = {chain.robot: chain.start for chain in tpg.chains}
    starts = {
        robot.name: starts.get(robot.name, robot.home) for robot in tpg.cell.robots
    }
    with Scene(tpg.cell, starts) as scene:
        done = drive(tpg, drivers_of(tpg, scene.addresses), scene)
    figures = report(tpg, done, planned_s)
    if given.out:
        given.out.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    return 1 if done.failed else 0


if __name__ == "__main__":
    sys.exit(main())

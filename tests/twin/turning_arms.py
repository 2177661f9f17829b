"""A scenario of two arms, and a plan for it that needs no planner."""

from pathlib import Path

import numpy as np

from planning.cell.workcell import Workcell
from planning.motion.motion_plan import MotionPlan, TaskMotion
from planning.tasks.task import Task, TaskKind
from planning.transforms import Array
from scheduling.build_tpg import build_tpg
from scheduling.graph.plan_files import save_plan
from tests.twin.program import invoke
from twin.planning.build_workcell import build_workcell
from twin.reading.scenario_file import load_scenario

SCENARIO = """\
version: 1
name: two
cell:
  robots:
    - {name: left, model: gp4, base: {xyz_m: [0, 0, 0.9246]}}
    - {name: right, model: gp4, base: {xyz_m: [0.88, 0, 0.9246], rpy_deg: [0, 0, 180]}}
  fixtures: [{name: plate, size_m: [0.384, 0.384, 0.005], pose: {xyz_m: [0.44, 0, 1.112]}}]
assembly:
  kind: assembly
  parts:  # where it belongs already: nobody touches it
    - {name: b1, size_m: [0.0158, 0.0318, 0.0096], start: {xyz_m: [0.2881234, 0.1441234, 1.1193]},
       goal: {xyz_m: [0.2881234, 0.1441234, 1.1193]}}
  steps: [b1]
planning: {speed_model: joint}  # the plan below says times and no motions within limits
execution:
  skills:
    pick: {kind: lognormal, median_s: 5, p95_s: 6}
"""


def planned_arms(folder: Path, more: str = "") -> Path:
    """Write the scenario as ``two.yaml`` with more at its end, and a plan of it beside it."""
    file = folder / "two.yaml"
    file.write_text(SCENARIO + more)
    save_plan(
        build_tpg(turning_plan(build_workcell(load_scenario(file), folder))), folder
    )
    return folder


QUICK = ("--no-audit", "--no-recording", "-q")


def running(folder: Path, out: Path, *options: object) -> tuple[str, ...]:
    """Return the command that executes the plan in a folder."""
    words = ("run", folder / "two.yaml", "--plan", folder, "--out", out, *options)
    return tuple(map(str, words))


def run_arms(folder: Path, *options: object, out: Path | None = None) -> Path:
    """Execute the plan in a folder, neither audited nor recorded; return the folder of the run."""
    out = out or folder / "run"
    invoke(*running(folder, out, *QUICK, *options), code=0)
    return out


def turning_plan(cell: Workcell) -> MotionPlan:
    """Each arm turns aside and works there, one after the other."""
    tasks: list[Task] = []
    motions: list[TaskMotion] = []
    clock = 0.0
    for robot in cell.robots:
        aside = robot.home + np.array([0.4, 0, 0, 0, 0, 0])
        for kind, goal in ((TaskKind.TRANSIT, aside), ("pick", aside - 0.05)):
            start = motions[-1].path[-1] if kind != TaskKind.TRANSIT else robot.home
            path = straight(start, goal, 9 if kind == TaskKind.TRANSIT else 3)
            time = clock + np.linspace(
                0.0, 0.4 if kind == TaskKind.TRANSIT else 5.0, len(path)
            )
            waypoints = path[-1:] if kind == TaskKind.TRANSIT else path[1:]
            label = f"{kind} of {robot.name}"
            tasks.append(Task(len(tasks), robot.name, kind, 1, label, waypoints))
            motions.append(TaskMotion(path, time))
            clock = float(time[-1])
    nothing = np.empty((0, 2), dtype=np.int64)
    return MotionPlan(cell, tuple(tasks), tuple(motions), nothing, ())


def straight(start: Array, goal: Array, waypoints: int) -> Array:
    share = np.linspace(0.0, 1.0, waypoints)[:, None]
    return (1 - share) * start + share * goal

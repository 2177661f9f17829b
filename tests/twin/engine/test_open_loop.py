"""Two arms reach into the same place: the graph keeps them apart, the clock does not."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import Result

from planning.cell.workcell import Workcell
from planning.motion.known_motions import MotionPlan, TaskMotion
from planning.tasks.task import TRANSIT, Task
from scheduling.build_tpg import build_tpg
from scheduling.graph.plan_files import save_plan
from tests.twin.program import invoke
from tests.twin.turning_arms import SCENARIO, straight
from twin.planning.build_workcell import build_workcell
from twin.scenario.manifest import load_scenario

LATE = """\
  speed: {robots: {left: {kind: fixed, value: 0.25}}}
"""
REACH = np.array([0.0, 0.8, 1.0, 0.0, 0.6, 0.0])
"""From HOME forward, to where the other arm reaches too."""


def reaching_plan(cell: Workcell) -> MotionPlan:
    """Each arm reaches forward and comes back, one after the other."""
    tasks: list[Task] = []
    motions: list[TaskMotion] = []
    clock = 0.0
    for robot in cell.robots:
        for k, (a, b) in enumerate(((0.0, 1.0), (1.0, 0.0))):
            path = straight(robot.home + a * REACH, robot.home + b * REACH, 25)
            time = clock + np.linspace(0.0, 1.2, len(path))
            label = f"{'back' if k else 'there'} of {robot.name}"
            tasks.append(Task(len(tasks), robot.name, TRANSIT, 1, label, path[-1:]))
            motions.append(TaskMotion(path, time))
            clock = float(time[-1])
    nothing = np.empty((0, 2), dtype=np.int64)
    return MotionPlan(cell, tuple(tasks), tuple(motions), nothing, ())


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("plan")
    (folder / "two.yaml").write_text(SCENARIO + LATE)
    cell = build_workcell(load_scenario(folder / "two.yaml"), folder)
    tpg = build_tpg(reaching_plan(cell))
    assert len(tpg.edges) > 3
    save_plan(tpg, folder)
    return folder


def run(plan: Path, out: Path, policy: str) -> tuple[Result, dict]:
    where = ("run", plan / "two.yaml", "--plan", plan, "--out", out)
    result = invoke(*where, "--policy", policy, "--no-recording", "--json")
    return result, json.loads((out / "summary.json").read_text())


def test_a_late_robot_is_waited_for(plan: Path, tmp_path: Path) -> None:
    result, summary = run(plan, tmp_path / "run", "asynchronous")
    assert result.exit_code == 0, result.output
    assert summary["audit"]["violations"] == []
    assert summary["wait_s"]["right"] > 3.0


def test_in_open_loop_a_late_robot_is_run_into(plan: Path, tmp_path: Path) -> None:
    """What the audit finds are violations, and the run does not pass."""
    result, summary = run(plan, tmp_path / "run", "open-loop")
    assert result.exit_code == 1
    assert summary["outcome"] == "completed"
    found = summary["audit"]["violations"]
    assert found
    assert all(
        {entry["first"].split("/")[0], entry["second"].split("/")[0]}
        == {"left", "right"}
        for entry in found
    )
    assert summary["audit"]["min_distance_m"] < -0.01

"""A small structure with bricks to spare, planned so that what fails can be planned anew."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.planning.facing_arms import FACING_ARMS
from twin.operate.operation import Operation, operate
from twin.recorders.observers import MemoryRecorder
from twin.run.events import Event
from twin.trial.loaded_scenario import load
from twin.trial.plan_result import PlanResult
from twin.trial.planning import plan_to_operate
from twin.trial.simulation import scenario_execution

CLIFF = Path(__file__).parents[3] / "scenarios" / "lego" / "cliff.yaml"

STACK = (
    FACING_ARMS
    + """\
  stock:
    - {name: left_a, brick: 2x4, at: [2, 30, 1]}
    - {name: left_b, brick: 2x4, at: [6, 30, 1]}
    - {name: left_c, brick: 2x4, at: [2, 36, 1]}
    - {name: left_d, brick: 2x4, at: [6, 36, 1]}
    - {name: left_e, brick: 2x4, at: [2, 42, 1]}
    - {name: right_a, brick: 2x4, at: [44, 30, 1]}
    - {name: right_b, brick: 2x4, at: [40, 30, 1]}
    - {name: right_c, brick: 2x4, at: [44, 36, 1]}
    - {name: right_d, brick: 2x4, at: [40, 36, 1]}
    - {name: right_e, brick: 2x4, at: [44, 42, 1]}
  steps:
    - {brick: 2x4, at: [23, 15, 1]}
    - {brick: 2x4, at: [23, 15, 2]}
    - {brick: 2x4, at: [23, 15, 3]}
    - {brick: 2x4, at: [23, 15, 4]}
planning: {shortcut_candidates: 30}
"""
)


FEW = {"planning.shortcut_candidates": 30, "recovery.shortcuts": 4}
"""Few shortcuts: what is tried here has to do with none, and each plan is made anew many times."""


def planned(file: Path, **values: Any) -> PlanResult:
    """Return a plan of a scenario with few shortcuts, and with other values of it."""
    return plan_to_operate(load(file).varied({**FEW, **values}))


@cache
def stack(folder: Path) -> PlanResult:
    """Return the plan of the stack, whose file is written into a folder."""
    file = folder / "stack.yaml"
    file.write_text(STACK)
    return planned(file)


def operated(
    plan: PlanResult, seed: int, *, halting: bool = False, **values: Any
) -> tuple[Operation, list[Event]]:
    """Operate a plan with other values of its execution; return what was told, too."""
    case = plan.scenario.varied(values)
    memory = MemoryRecorder()
    done = operate(
        case.sections,
        plan.motions,
        plan.tpg,
        scenario_execution(case.sections, case.folder),
        seed=seed,
        recorders=(memory,),
        halting=halting,
    )
    return done, memory.events


def lost(chance: float, retries: int = 0) -> dict[str, Any]:
    """Return the values by which attempts to pick and to place fail with a chance, half of them losing the brick."""
    item = {"probability": chance, "retries": retries, "loses": 0.5}
    return {f"failures.{skill}": item for skill in ("pick", "place-down")}


def require_own_contacts(tpg: TemporalPlanGraph) -> None:
    """Check that a tool may only touch an object in tasks of its robot, or in steps about the object."""
    tools = {f"{robot.name}/tool": robot.name for robot in tpg.cell.robots}
    for contact in tpg.allowed:
        pair = {contact.first, contact.second}
        if len(pair & tools.keys()) != 1:
            continue
        (tool,) = pair & tools.keys()
        (name,) = pair - {tool}
        steps = {task.step for task in tpg.tasks if task.object == name}
        for task in (tpg.tasks[k] for k in contact.tasks):
            about = task.object == name or (task.object is None and task.step in steps)
            assert about or task.robot == tools[tool], task

"""A small structure with bricks to spare, planned so that what fails can be planned anew."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import twin
from planning.cell.workcell import Attachment
from planning.tasks.task import Handling, Task
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.invariant import check_invariant
from scheduling.rolling.cut import world_state_after
from scheduling.verification.verify import verify_plan
from tests.twin.planning.facing_arms import FACING_ARMS
from tests.twin.program import invoke
from twin.operations.operation import Operation, operate
from twin.recorders.observers import MemoryRecorder
from twin.runs.events import Event
from twin.runs.folder import EVENTS, SUMMARY
from twin.trial.loaded_scenario import load
from twin.trial.plan_result import PlanResult
from twin.trial.planning import plan_scenario
from twin.trial.run_result import RunResult
from twin.trial.simulation import execute, scenario_execution

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
    return plan_scenario(load(file).varied({**FEW, **values}), keep=True)


@cache
def stack(folder: Path) -> PlanResult:
    """Return the plan of the stack, whose file is written into a folder."""
    file = folder / "stack.yaml"
    file.write_text(STACK)
    return planned(file)


def operated(
    plan: PlanResult, seed: int, halting: bool = False, /, **values: Any
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


def tasks_of(done: Operation | RunResult, *kinds: str) -> list[Task]:
    """Return the tasks of some kinds that were executed."""
    return [task for task in done.tpg.tasks if task.kind in kinds]


def placed(done: Operation) -> list[int]:
    """Return the steps of which something was put down, each as often as it was."""
    return sorted(task.step for task in tasks_of(done, "place-down"))


def gone(done: Operation) -> set[str]:
    """Return what has left the cell."""
    return {h.object for h in done.tpg.handlings if h.holder == Handling.GONE}


def at_the_end(done: Operation) -> Mapping[str, Attachment]:
    """Return where everything is in the end."""
    return world_state_after(
        done.tpg, [len(chain) for chain in done.tpg.chains]
    ).attachments


def came_at(events: Sequence[Event]) -> dict[str, int]:
    """Return when what came up later was there [ns]."""
    return {e.object: e.t_ns for e in events if e.detail.startswith("comes up")}


def require_safe(tpg: TemporalPlanGraph) -> None:
    """Check the guarantee of a graph, searched anew and verified from scratch."""
    check_invariant(DerivedTpg(tpg))
    assert verify_plan(tpg).problems == ()


def require_kept(done: Operation, message_ns: int = 0) -> None:
    """Check that every node of a safe graph was executed, in an order that its edges allow."""
    require_safe(done.tpg)
    start, end = done.record.start_ns, done.record.end_ns
    assert all((own >= 0).all() for own in (*start, *end))
    for k, u, i, v in done.tpg.edges.tolist():
        assert end[k][u] + message_ns <= start[i][v]


def require_same_run(plan: PlanResult) -> Operation:
    """Check that an operation in which nothing fails is the run of its plan."""
    case, memory = plan.scenario, MemoryRecorder()
    record = execute(case.sections, plan.tpg, case.folder, recorders=(memory,))
    done, events = operated(plan, case.sections.seed)
    assert events == memory.events
    assert done.record.makespan_ns == record.makespan_ns
    return done


def operated_by_program(
    file: Path, out: Path, *options: object, code: int | None = 0
) -> tuple[str, dict[str, Any]]:
    """Operate by the program, audited and verified; return what it prints, and the summary."""
    words = "--no-recording", *options, "--out", out
    printed = invoke("operate", file, *words, code=code).stdout
    summary: dict[str, Any] = json.loads((out / SUMMARY).read_text())
    assert summary["audit"]["violations"] == []
    invoke("verify", out, code=0)
    return printed, summary


def summary_of(folder: Path) -> dict[str, Any]:
    """Return the summary of a run, without the seconds that planning took and what is sealed with them."""
    summary: dict[str, Any] = json.loads((folder / SUMMARY).read_text("utf-8"))
    versions = summary["operation"]["versions"]
    assert versions, "something was planned anew"
    for version in versions:
        del version["cpu_s"]
    return {
        key: value
        for key, value in summary.items()
        if key not in ("files", "planning_s", "resumed")
    }


def require_resumed(out: Path, last: str = "", more: int = 0) -> str:
    """Break the log of a run off so many lines after one that says something, or in its middle; resume it.

    Returns:
        The log, which is what it was.
    """
    log, before = (out / EVENTS).read_text(), summary_of(out)
    lines = log.splitlines(keepends=True)
    said = (k for k, line in enumerate(lines) if last in line)
    at = next(said) + more if last else len(lines) // 2
    (out / EVENTS).write_text("".join(lines[:at]) + lines[at][:9])
    (out / SUMMARY).unlink()
    invoke("resume", out, "--quiet")
    assert (out / EVENTS).read_text() == log
    assert summary_of(out) == before
    return log


def gone_on(run: RunResult, at_s: float, folder: Path) -> tuple[PlanResult, RunResult]:
    """Return the plan of what is left of a run at a time [s], and its run, which is audited."""
    left = twin.plan(world=f"{run.files}@{at_s}")
    require_safe(left.tpg)
    went = twin.run(left, out=folder, recording=False)
    assert went.outcome == "completed"
    assert went.summary["audit"]["violations"] == []
    return left, went


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

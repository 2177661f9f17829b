"""Header of a run with warnings about its plan, and the figures of the finished run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from scheduling.graph.machine_chains import idle_robots
from scheduling.graph.plan_files import plan_sha256
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.slowed_motions import describe_overloaded_joints
from twin.engine.bulk.bulk_engine import with_model_holds
from twin.engine.engine import Simulator
from twin.engine.execution_model import ExecutionModel
from twin.planning.idle_robots import IdleRobot
from twin.registry import AUDIT, AUDITORS, RECORDERS
from twin.runs.execution_record import DeadlockError, ExecutionRecord, Policy
from twin.runs.header import RunHeader
from twin.runs.policies import SHORTENED
from twin.runs.summary import summarize_run
from twin.runs.windows import window_warnings
from twin.scenario.sections.kind import assembly_kind
from twin.scenario.sections.scenario import Scenario
from twin.trial.plan_result import PlanResult
from twin.trial.simulation import execute, scenario_execution
from twin.uncertainty.skill_durations import SkillDurations
from twin.uncertainty.speed_override import unreached_speeds


def stall_warnings(scenario: Scenario, tpg: TemporalPlanGraph) -> tuple[str, ...]:
    """Return warnings about requested stalls that cannot all happen.

    A robot or machine stalls at most once a node, so that more stalls than nodes are not executed.
    """
    found = []
    for chain in tpg.chains:
        own, who = scenario.execution.stalls, "robot"
        if tpg.cell.is_machine(chain.robot):
            own, who = scenario.execution.of_machine(chain.robot).stalls, "machine"
        if own.count_per_robot > len(chain):
            found.append(
                f"stalls.count_per_robot is {own.count_per_robot}, but {who} {chain.robot!r} has"
                f" {len(chain)} nodes and stalls once at each of them"
            )
    return tuple(found)


def nominal_window_warnings(
    scenario: Scenario, tpg: TemporalPlanGraph, base: Path
) -> tuple[str, ...]:
    """Return warnings about time windows that a plan exceeds at nominal times."""
    if not any(window.most is not None for window in tpg.windows):
        return ()
    model = scenario_execution(scenario, base)
    held = with_model_holds(tpg, model)
    nominal = ExecutionModel(SkillDurations({}), model.policy, model.messages)
    try:
        run = Simulator(held, nominal).run(seed=scenario.seed)
    except DeadlockError:
        return ()
    return tuple(window_warnings(tpg, run, held=held is not tpg))


def _unreached_speeds(plan: PlanResult) -> tuple[str, ...]:
    """Return warnings about speed factors beyond the robots' limits; see ``unreached_speeds``."""
    case = plan.scenario
    disturbances = case.sections.execution.disturbances(case.robots, case.folder)
    return unreached_speeds(plan.tpg, disturbances, case.sections.seed)


def run_header(
    plan: PlanResult,
    *,
    recording: bool = False,
    audit: bool | str = False,
    execution: Mapping[str, Any] = MappingProxyType({}),
) -> RunHeader:
    """Return the header of a run.

    Args:
        plan: plan to execute.
        recording: whether recordings are wanted, such as ``run.rrd``.
        audit: whether to audit the run; a name selects the collision engine.
        execution: entries of the executor.
    """
    known = {own.robot: own for own in plan.idle}
    idle = [known.get(k, IdleRobot(k, "unknown")) for k in idle_robots(plan.tpg)]
    # Of a plan of first steps, later ones may be for it.
    windowed = (
        execution.get("operated")
        and plan.scenario.sections.execution.window is not None
    )
    return RunHeader(
        recording=recording and bool(RECORDERS.names()),
        audit=audit if AUDIT in AUDITORS else False,
        planning_s=dict(plan.planning_s),
        makespan_sequential_s=_makespan_s(plan, plan.turns or plan.tpg, "sequential"),
        plan_sha256=plan_sha256(plan.tpg),
        warnings=(
            *plan.warnings,
            *stall_warnings(plan.scenario.sections, plan.tpg),
            *nominal_window_warnings(
                plan.scenario.sections, plan.tpg, plan.scenario.folder
            ),
            *describe_overloaded_joints(plan.tpg),
            *_unreached_speeds(plan),
            *(own.message for own in idle if not windowed),
        ),
        checks_off=plan.scenario.sections.checks_off,
        fits=plan.fits,
        idle={own.robot: own.content() for own in idle},
        plan=plan.name,
        turns_sha256=None if plan.turns is None else plan_sha256(plan.turns),
        load_bound_s=plan.load_bound_s,
        # The sequential plan kept next to one in slots has no type-2 edges.
        makespan_asynchronous_s=None
        if plan.turns is None or plan.name != SHORTENED
        else _makespan_s(plan, plan.turns, "asynchronous"),
        **execution,
    )


def _makespan_s(
    plan: PlanResult, tpg: TemporalPlanGraph, policy: Policy
) -> float | None:
    """Return the makespan of a plan under a policy [s], None if it deadlocks."""
    case = plan.scenario
    try:
        baseline = execute(case.sections, tpg, case.folder, policy)
    except DeadlockError:
        return None
    return baseline.makespan_s if baseline.outcome == "completed" else None


def run_figures(
    plan: PlanResult,
    record: ExecutionRecord,
    header: RunHeader,
    audit: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return the figures of a finished run, with the keys of ``summary.json``.

    Args:
        plan: the executed plan.
        record: how it was executed.
        header: header of the run.
        audit: findings of the audit, None without one.
    """
    scenario = plan.scenario.sections
    due = assembly_kind(scenario.assembly).due()
    return summarize_run(plan.tpg, record, scenario.name, header, audit, *due)

"""Entry ``run`` of the manifest of a run, and summary figures of the finished run."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from types import MappingProxyType
from typing import Any

from scheduling.graph.plan_files import plan_sha256
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.planning.idle_robots import IdleRobot
from twin.registry import AUDIT, AUDITORS, HOOKS, RECORDERS
from twin.runs.execution_record import DeadlockError, ExecutionRecord, Policy
from twin.runs.header import RunHeader
from twin.runs.policies import SHORTENED
from twin.runs.summary import summarize_run
from twin.scenario.sections.kind import assembly_kind
from twin.trial.plan_result import PlanResult
from twin.trial.simulation import execute


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
    idle = [known.get(k, IdleRobot(k, "unknown")) for k in plan.tpg.idle_robots()]
    # Of a plan of first steps, later ones may be for it.
    windowed = (
        execution.get("operated")
        and plan.scenario.sections.execution.step_window is not None
    )
    warnings = (
        HOOKS.load("plan warnings")(plan.scenario, plan.tpg)
        if "plan warnings" in HOOKS
        else ()
    )
    return RunHeader(
        recording=recording and bool(RECORDERS.names()),
        audit=audit if AUDIT in AUDITORS else False,
        planning_s=dict(plan.planning_s),
        makespan_sequential_s=_makespan_s(plan, plan.turns or plan.tpg, "sequential"),
        plan_sha256=plan_sha256(plan.tpg),
        warnings=(
            *plan.warnings,
            *warnings,
            *(own.message for own in idle if not windowed),
        ),
        checks_off=plan.scenario.sections.checks_off,
        fits=plan.fits,
        idle={own.robot: own.content() for own in idle},
        plan=plan.name,
        turns_sha256=None if plan.turns is None else plan_sha256(plan.turns),
        makespan_bound_s=plan.makespan_bound_s,
        assignment_search=None if plan.search is None else plan.search.content(),
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
    scrapped: Collection[int] = (),
) -> dict[str, Any]:
    """Return the figures of a finished run, with the keys of ``summary.json``.

    Args:
        plan: the executed plan.
        record: how it was executed.
        header: header of the run.
        audit: findings of the audit, None without one.
        scrapped: numbers of the products that were begun and are not complete.
    """
    scenario = plan.scenario.sections
    orders = line_orders(plan, scrapped)
    return summarize_run(plan.tpg, record, scenario.name, header, audit, *orders)


def line_orders(plan: PlanResult, scrapped: Collection[int] = ()) -> tuple[Any, ...]:
    """Return what the hook ``line`` asks of the products of a plan and of those that were scrapped."""
    kind = assembly_kind(plan.scenario.sections.assembly)
    return *kind.due(), kind.variants(), scrapped

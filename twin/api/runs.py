"""Functions of the Python API on one scenario: check, plan, simulate, run, audit, replay."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from planning.errors import RequestError, ScenarioError
from twin.api.checked import Checked, check_if_installed
from twin.host.arguments import checks_arguments
from twin.host.progress import Report, report_nothing
from twin.recorders.observers import MemoryRecorder
from twin.registry import HOOKS, POLICIES
from twin.runs.folder import run_folder
from twin.runs.policies import named_policies, parse_policy_name
from twin.scenario.variations import short_key
from twin.trial.auditor import load_auditor
from twin.trial.loaded_scenario import AnyScenario, LoadedScenario, PathOrName, load
from twin.trial.plan_result import PlanResult, require_plan_of, scenario_of_run
from twin.trial.planning import plan_scenario, plan_until_final
from twin.trial.run_moment import RunMoment
from twin.trial.run_plan import run_plan_to_folder
from twin.trial.run_result import RunResult
from twin.trial.simulation import execute

StartCallback = Callable[[Checked, Path], None]
"""Told of the check and of the folder of a run, before it is planned."""


AnyPlan = AnyScenario | PlanResult
"""A plan, or the scenario that is to be planned, or the path of its file."""


@checks_arguments
def plan(
    scenario: AnyScenario | None = None,
    *,
    world: RunMoment | str | None = None,
    out_of_service: Sequence[str] = (),
    progress: Report = report_nothing,
) -> PlanResult:
    """Check and plan a scenario, or the remainder of a scenario from a given time of a run.

    Args:
        scenario: a scenario, or the path of its file; by default that of the run.
        world: where the plan begins, as ``runs/cliff@42``: the folder of a run, and seconds since its
            start; by default with all robots at HOME and all objects at their starts. Each robot
            continues
            to the first border at which it is at rest and within no skill; the plan begins there.
        out_of_service: robots that do nothing from then on, and stand where they are.
        progress: receives the progress of each stage.

    Raises:
        InvalidScenarioError: the file is not valid, or the check of the cell finds an error.
        RequestError: a robot cannot continue from there, or nothing is left to do.
        TwinError: the assembly cannot be built as it is, or no plan was found.
    """
    moment = RunMoment.named(world) if isinstance(world, str) else world
    if scenario is None:
        if moment is None:
            raise RequestError("say what to plan: a scenario, or a time of a run")
        scenario = scenario_of_run(moment.run.files)
    if moment is None and out_of_service:
        raise RequestError(
            "robots are out of service from a time of a run on: name one, such as runs/cliff@0; for plans"
            " from the start leave them out of the scenario"
        )
    checked = check_if_installed(load(scenario), progress)
    checked.require_ok()
    start = None
    if moment is not None:
        cut_run = HOOKS.require("cut of a run", "a plan from a run")
        start = cut_run(checked.scenario, moment, out_of_service)
    if start is None:
        made = plan_until_final(checked.scenario, progress=progress, bound=True)
    else:
        made = plan_scenario(checked.scenario, progress=progress, start=start)
    return replace(made, warnings=checked.warnings, fits=checked.fits)


def planned_scenario(source: AnyPlan) -> LoadedScenario:
    """Return the scenario of a plan, of a file, or one that was loaded before."""
    return source.scenario if isinstance(source, PlanResult) else load(source)


def _planned(source: AnyPlan, progress: Report) -> PlanResult:
    """Return a given plan unchanged; plan anything else."""
    return source if isinstance(source, PlanResult) else plan(source, progress=progress)


@checks_arguments
def simulate(
    plan: AnyPlan,
    values: Mapping[str, Any] | None = None,
    *,
    seed: int | None = None,
    policy: str | None = None,
    progress: Report = report_nothing,
) -> RunResult:
    """Execute a plan once in the twin, and write nothing.

    Args:
        plan: the plan; a scenario, or the path of its file, is planned first.
        values: other values at keys of the execution section, such as
            ``{"stalls.rate_per_h": 60}``; see ``LoadedScenario.varied``.
        seed: of the draws, in place of the scenario's.
        policy: how nodes are released, in place of the scenario's: asynchronous, sequential,
            synchronous or open-loop.
        progress: receives the progress of each planning stage.

    Raises:
        ScenarioError: a value does not fit.
        RequestError: a value would need another plan.
        DeadlockError: no robot could continue.
        TwinError: there is no plan; see ``twin.plan``.
    """
    ready = _with_values(_planned(plan, progress), values or {}, seed, policy)
    case, memory = ready.scenario, MemoryRecorder()
    record = execute(case.sections, ready.tpg, case.folder, recorders=(memory,))
    return RunResult(plan=ready, history=memory.events, record=record)


@checks_arguments
def run(
    plan: AnyPlan,
    *,
    out: PathOrName | None = None,
    recording: bool = True,
    audit: bool = True,
    audit_engine: str | None = None,
    begun: StartCallback | None = None,
    progress: Report = report_nothing,
) -> RunResult:
    """Check and plan a scenario, execute it in the twin, audit it, and write everything.

    Args:
        plan: a scenario, or the path of its file; a plan is not made again.
        out: folder for the results; by default ``logs/<scenario>-<UTC time>``.
        recording: write ``run.rrd`` for the viewer.
        audit: check the executed motions with independent code.
        audit_engine: collision engine of the audit, pybullet or coal; by default PyBullet where it
            is installed, else coal.
        begun: receives the check and the folder before planning starts.
        progress: receives the progress of each stage.

    Returns:
        The run; findings of the audit are in its summary.

    Raises:
        InvalidScenarioError: the file is not valid, or the check of the cell finds an error.
        OutputError: the folder cannot be written to.
        TwinError: there is no plan, or the run broke off; see ``twin.plan``.
    """
    # Now, not after the planning.
    if audit and audit_engine is not None:
        load_auditor(audit_engine)
    ready = plan if isinstance(plan, PlanResult) else None
    case = planned_scenario(plan)
    checked = check_if_installed(case, progress)
    checked.require_ok()
    with run_folder(out, case.name) as folder:
        if begun is not None:
            begun(checked, folder)
        made = ready or plan_until_final(
            checked.scenario, progress=progress, bound=True
        )
        return run_plan_to_folder(
            replace(made, warnings=checked.warnings, fits=checked.fits),
            folder,
            recording=recording,
            audit=audit and (audit_engine or True),
            progress=progress,
        )


def _with_values(
    plan: PlanResult, values: Mapping[str, Any], seed: int | None, policy: str | None
) -> PlanResult:
    """Return a plan with some values of its scenario replaced for execution."""
    given = {"seed": seed, "policy": policy}
    values = {short_key(key): value for key, value in values.items()}
    values |= {key: value for key, value in given.items() if value is not None}
    other = plan.scenario.varied(released(values))
    require_plan_of(plan, other)
    return replace(plan, scenario=other)


def released(values: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the values unchanged; refuse an unknown release policy.

    Raises:
        ScenarioError: names the right key or value.
    """
    policy = values.get("policy")
    if policy is None or policy in POLICIES:
        return values
    try:
        name = parse_policy_name(str(policy))
    except RequestError:
        message = f"policy: there is no {policy!r}"
        raise ScenarioError(message, choices=POLICIES.names()) from None
    plan, release = named_policies()[name]
    raise ScenarioError(
        f"policy {name!r} is {release} of the plan {plan}: give --policy {release}; --shortcuts"
        " and the scenario's coordination say which plan it is"
    )

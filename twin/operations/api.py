"""Operation of a cell: execution of its plan, with replanning after failures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path

from planning.errors import RequestError
from twin.api.checked import check_if_installed
from twin.api.runs import AnyPlan, StartCallback
from twin.host.arguments import checks_arguments
from twin.host.progress import Report, report_nothing
from twin.operations.executor import OperatedExecutor
from twin.operations.operation import require_picked, require_rolling
from twin.operations.person import AnswerCallback
from twin.registry import HOOKS
from twin.runs.folder import run_folder
from twin.runs.policies import named_policies
from twin.scenario.sections.kind import assembly_kind
from twin.scenario.variations import Variant, apply_variation, layout_of
from twin.trial.auditor import load_auditor
from twin.trial.executor import Executor
from twin.trial.loaded_scenario import AnyScenario, LoadedScenario, PathOrName, load
from twin.trial.plan_result import PlanResult
from twin.trial.planning import plan_until_final, with_failures
from twin.trial.run_plan import run_plan_to_folder
from twin.trial.run_result import RunResult


@checks_arguments
def operate(
    scenario: AnyScenario,
    *,
    out: PathOrName | None = None,
    failures: float | None = None,
    recording: bool = True,
    audit: bool = True,
    audit_engine: str | None = None,
    answer: AnswerCallback | None = None,
    drivers: PathOrName | None = None,
    page: int | None = None,
    opened: Callable[[str], None] | None = None,
    begun: StartCallback | None = None,
    progress: Report = report_nothing,
) -> RunResult:
    """Operate a cell: execute its plan in the twin, and replan after failures.

    A skill that fails for good is retried, by another robot or with another object of its kind;
    infeasible steps are abandoned with all dependent ones, and the rest continues.

    Args:
        scenario: a scenario, or the path of its file.
        out: folder for the results; by default ``logs/<scenario>-<UTC time>``.
        failures: probability that an attempt at any skill fails, a fifth of which lose the object;
            for skills without a rate in the scenario.
        recording: write ``run.rrd`` for the viewer.
        audit: check the executed motions with independent code.
        audit_engine: collision engine of the audit, pybullet or coal; by default PyBullet where it
            is installed, else coal.
        answer: answers questions to a person before a step is abandoned, in
            place of what is drawn; such a run cannot be resumed.
        drivers: file of the drivers that move the robots, in place of the twin.
        page: with drivers, a port of this machine for a page that shows the run next to the cell,
            with buttons and the questions of ``recovery.ask``; 0 for any free port.
        opened: receives the address of that page.
        begun: receives the check and the folder before planning starts.
        progress: receives the progress of each stage.

    Raises:
        InvalidScenarioError: the file is not valid, or the check of the cell finds an error.
        RequestError: the scenario cannot be replanned while it is executed, or there is no page.
        TwinError: there is no plan, or the run broke off; see ``twin.plan``.
    """
    if page is not None and drivers is None:
        raise RequestError(
            "a page is for robots that drivers move: name a file of them, too"
        )
    if audit and audit_engine is not None:
        load_auditor(audit_engine)
    case = _with_step_window(load(scenario))
    require_rolling(case.sections)
    checked = check_if_installed(case, progress)
    checked.require_ok()
    driven = None
    if drivers is not None:
        driven = HOOKS.require("driven cell", "--drivers")(case, Path(drivers))
    with run_folder(out, case.name) as folder:
        if begun is not None:
            begun(checked, folder)
        made = plan_until_final(case, progress=progress, keep=True)
        if failures is not None:
            made = replace(
                made, scenario=with_failures(made.scenario, made.tpg, failures)
            )
        operated: AbstractContextManager[Executor] = nullcontext(
            OperatedExecutor(answer)
        )
        if driven is not None:
            operated = driven.executor(
                made.scenario, folder, answer=answer, page=page, opened=opened
            )
        with operated as executor:
            return run_plan_to_folder(
                replace(made, warnings=checked.warnings, fits=checked.fits),
                folder,
                recording=recording,
                audit=audit and (audit_engine or True),
                executor=executor,
                progress=progress,
            )


def _with_step_window(case: LoadedScenario) -> LoadedScenario:
    """Return a scenario with the rolling planning window that its assembly chooses, if it has none of its own."""
    own = case.sections
    if own.execution.window is not None:
        return case
    chosen = assembly_kind(own.assembly).step_window()
    if chosen is None:
        return case
    return case.varied({"window": chosen.model_dump()})


def require_operable(
    plan: AnyPlan,
    case: LoadedScenario,
    names: Sequence[str],
    variants: Sequence[Variant],
) -> None:
    """Refuse a study of operations that cannot be replanned during execution.

    Args:
        plan, case: the plan to study, and its scenario.
        names: requested policies.
        variants: values of the varied keys.

    Raises:
        RequestError: replanning is impossible; the message says why.
    """
    if isinstance(plan, PlanResult) and (
        plan.made_of is None or plan.made_of.work is None
    ):
        raise RequestError(
            "a plan alone does not say what others can be made from: operate a scenario"
        )
    for name in names:
        if named_policies()[name].release != "asynchronous":
            could = [
                p for p, own in named_policies().items() if own[1] == "asynchronous"
            ]
            raise RequestError(
                f"policy {name!r} cannot be replanned during its execution",
                choices=tuple(could),
            )
    for variant in variants:
        if keys := ", ".join(layout_of(variant)):
            raise RequestError(
                f"{keys}: what is operated has one plan; study each layout by itself"
            )
        own = apply_variation(case.sections, variant)
        require_rolling(own)
        if own.execution.step_window is not None:
            raise RequestError(
                "what is replicated is a plan of all steps: leave out execution.window"
            )


def operated_plan(
    plan: AnyPlan,
    variants: Sequence[Variant],
    shortcuts: int | None,
    failures: float | None,
    progress: Report,
) -> PlanResult:
    """Return the plan that a study operates, with its scenario of failures.

    Args:
        plan: the plan to study.
        variants: values of the varied keys.
        shortcuts: maximum number of tried shortcuts; None for that of the scenario.
        failures: probability that an attempt fails, for skills without a rate in the scenario.
        progress: receives the progress of each stage.

    Raises:
        RequestError: a late part is picked by no robot, or supports others.
        TwinError: there is no plan; see ``twin.plan``.
    """
    if not isinstance(plan, PlanResult):
        tried = {"planning.shortcut_candidates": shortcuts}
        case = load(plan).varied({} if shortcuts is None else tried)
        plan = plan_until_final(case, progress=progress, keep=True)
    if failures is not None:
        case = with_failures(plan.scenario, plan.tpg, failures)
        plan = replace(plan, scenario=case)
    for variant in variants:
        late = apply_variation(plan.scenario.sections, variant).execution.late
        require_picked(plan.motions, [item.part for item in late])
    return plan

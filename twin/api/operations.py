"""Operating a cell: its plan is executed, and what fails is planned anew."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from twin.api.runs import Begun, check
from twin.audit.worlds.engines import engine_named
from twin.host.progress import Report, report_nothing
from twin.operate.operation import require_rolling
from twin.run.folder import run_folder
from twin.trial.loaded_scenario import AnyScenario, PathOrName, load
from twin.trial.planning import plan_to_operate, with_failures
from twin.trial.run_result import RunResult
from twin.trial.trial import try_plan


def operate(
    scenario: AnyScenario,
    *,
    out: PathOrName | None = None,
    failures: float | None = None,
    recording: bool = True,
    audit: bool = True,
    audit_engine: str | None = None,
    begun: Begun | None = None,
    progress: Report = report_nothing,
) -> RunResult:
    """Operate a cell: execute its plan in the twin, and plan anew whatever fails.

    A skill that fails for good is done again with what is left, by another robot or with another object of
    its kind; what nobody can do any more is given up with all that rests on it, and the rest goes on.

    Args:
        scenario: a scenario, or the path of its file.
        out: folder for the results; by default ``logs/<scenario>-<UTC time>``.
        failures: probability that an attempt at any skill fails, of which a fifth loses what is handled,
            where the scenario says nothing of that skill.
        recording: write ``run.rrd`` for the viewer.
        audit: check what was executed with code of its own.
        audit_engine: what the audit measures with, pybullet or coal; by default PyBullet where it
            is installed, else coal.
        begun: told of the check and of the folder, before anything that takes long.
        progress: told how far each stage has come.

    Raises:
        InvalidScenarioError: the file is not valid, or the check of the cell finds an error.
        RequestError: the scenario cannot be planned anew while it is executed.
        TwinError: there is no plan, or the run broke off; see ``twin.plan``.
    """
    engine = engine_named(audit_engine) if audit and audit_engine is not None else None
    case = load(scenario)
    require_rolling(case.sections)
    checked = check(case, progress=progress)
    checked.require_ok()
    with run_folder(None if out is None else Path(out), case.name) as folder:
        if begun is not None:
            begun(checked, folder)
        made = plan_to_operate(case, progress)
        if failures is not None:
            made = replace(made, scenario=with_failures(case, made.tpg, failures))
        return try_plan(
            replace(made, warnings=checked.warnings, fits=checked.fits),
            folder,
            recording=recording,
            audit=engine or audit,
            operated=True,
            progress=progress,
        )

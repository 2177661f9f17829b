"""Auditor that checks an executed run against its scenario."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from twin.audits.audit import AuditReport, audit_run
from twin.audits.expectations import scenario_expectations
from twin.audits.worlds.engines import Engine, engine_named
from twin.host.progress import Report, report_nothing
from twin.scenario.sections.scenario import Scenario


class RunAuditor:
    """Audit of runs with the code of this package; implements the interface in ``twin.trial.auditor``."""

    def __init__(self, engine: str | None = None) -> None:
        """Choose the collision engine.

        Args:
            engine: pybullet or coal; by default PyBullet where it is installed, else coal.

        Raises:
            RequestError: there is no such engine, or it is not installed.
        """
        self._engine = engine_named(engine)

    def judge(
        self,
        scenario: Scenario,
        folder: Path,
        *,
        ordered: bool,
        finished: bool,
        progress: Report,
    ) -> Mapping[str, Any]:
        """Return the findings of a run; see RunJudge."""
        return audit_execution(
            scenario,
            folder,
            ordered=ordered,
            finished=finished,
            engine=self._engine,
            progress=progress,
        ).content()


def audit_execution(
    scenario: Scenario,
    folder: Path,
    *,
    ordered: bool,
    finished: bool,
    engine: Engine | None = None,
    progress: Report = report_nothing,
) -> AuditReport:
    """Audit an execution against its scenario.

    Args:
        scenario: places and holds of objects.
        folder: with the plan and the tables of the motion.
        ordered: whether the run had to keep the plan's type-2 edges, as all policies but
            open-loop do.
        finished: whether the run came to its end, so that all must be in place.
        engine: to measure with; by default PyBullet where it is installed, else coal.
        progress: receives the progress of the audit.
    """
    return audit_run(
        folder,
        progress,
        ordered=ordered,
        wanted=scenario_expectations(scenario),
        finished=finished,
        engine=engine,
    )

"""Interface for auditing a run; the audit uses no code of the planner."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

from twin.host.progress import Report
from twin.registry import AUDIT, AUDITORS
from twin.scenario.sections.scenario import Scenario


class RunJudge(Protocol):
    """Auditor that checks an executed plan against its scenario."""

    def judge(
        self,
        scenario: Scenario,
        folder: Path,
        *,
        ordered: bool,
        finished: bool,
        progress: Report,
    ) -> Mapping[str, Any]:
        """Return the findings, with the keys of ``audit`` in ``summary.json``.

        Args:
            scenario: states where objects belong and what holds them.
            folder: with the plan and the tables of the motion.
            ordered: whether the run had to keep the plan's type-2 edges, as all policies but
                open-loop do.
            finished: whether the run came to its end, so that all must be in place.
            progress: receives the progress of the audit.
        """
        ...


def load_auditor(engine: str | None = None) -> RunJudge:
    """Return the auditor of runs.

    Args:
        engine: to measure with; by default PyBullet where it is installed, else coal.

    Raises:
        RequestError: there is no auditor, or it has no such engine.
    """
    found: RunJudge = AUDITORS.require(AUDIT, "an audit")(engine)
    return found

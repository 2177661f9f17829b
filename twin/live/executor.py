"""Executor of runs whose robots are moved by drivers (programs that each move one robot)."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from planning.errors import TwinError
from twin.durations.nanoseconds import NANOSECONDS
from twin.live.measured_log import MEASURED
from twin.live.run_history import History, history_of
from twin.live.session import Session
from twin.operations.executor import operate_plan, plan_again, require_unanswered
from twin.operations.person import AnswerCallback
from twin.recorders.observers import Recorder
from twin.runs.events import Event
from twin.runs.folder import EVENTS
from twin.runs.header import RunHeader
from twin.trial.errors import ResumeError
from twin.trial.executor import Executed
from twin.trial.loaded_scenario import LoadedScenario
from twin.trial.plan_result import PlanResult


@dataclass(frozen=True)
class LiveExecutor:
    """Executes plans with drivers that move the robots, and replans after failures.

    Attributes:
        session: the drivers.
        answer: answers for a person; see twin.operate.
        history: events of the log, of a run that is continued.
    """

    session: Session
    answer: AnswerCallback | None = None
    history: History | None = None

    @classmethod
    def of(cls, header: RunHeader, folder: Path) -> LiveExecutor:
        """Return the executor of a run that has begun.

        Raises:
            ResumeError: a person answered questions in it.
        """
        require_unanswered(header, folder)
        assert header.session is not None
        return cls(Session.of(folder.name, header.session))

    @property
    def entries(self) -> Mapping[str, Any]:
        """Entries of a run's header that identify its executor."""
        return {
            "operated": True,
            "answered": self.answer is not None,
            "session": self.session.content(),
        }

    def execute(
        self,
        plan: PlanResult,
        folder: Path,
        recorders: Sequence[Recorder],
        sync: Callable[[], None],
    ) -> Executed:
        """Execute a plan; see Executor."""
        live = self.session.execution(
            plan.tpg.cell, sync, folder / MEASURED, self.history
        )
        return operate_plan(plan, folder, recorders, self.answer, live)

    def plan_to_resume(
        self, case: LoadedScenario, folder: Path, _header: RunHeader
    ) -> PlanResult:
        """Return the plan with which a run began; see ``plan_again``."""
        return plan_again(case, folder)

    def continued(
        self, plan: PlanResult, folder: Path, log: Sequence[str]
    ) -> LiveExecutor:
        """Return an executor that continues a run from the state of its drivers and its log.

        Raises:
            ResumeError: it was replanned.
        """
        try:
            history = history_of(plan.tpg, list(map(Event.parse, log)))
        except TwinError as error:
            raise ResumeError(f"{folder}: {error}") from None
        stood_s = max(time.time() - (folder / EVENTS).stat().st_mtime, 0.0)
        history.since_ns += round(stood_s * self.session.drivers.pace * NANOSECONDS)
        return replace(self, history=history)

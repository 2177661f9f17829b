"""Interface of executors of a plan, and the executor for simulation; extensions can register further executors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from twin.recorders.observers import Recorder
from twin.registry import EXECUTORS
from twin.runs.execution_record import ExecutionRecord
from twin.runs.header import RunHeader
from twin.trial.loaded_scenario import LoadedScenario
from twin.trial.plan_result import PlanResult, plan_of_run
from twin.trial.simulation import execute


@dataclass(frozen=True)
class Executed:
    """A plan that was executed.

    Attributes:
        plan: the executed plan, revisions included.
        record: when everything happened.
        replanned: whether another plan took over meanwhile.
        finished: whether every object is at its goal.
        summary: further entries of ``summary.json``.
    """

    plan: PlanResult
    record: ExecutionRecord
    replanned: bool = False
    finished: bool = True
    summary: Mapping[str, Any] = field(default_factory=dict)


class Executor(Protocol):
    """Executes the plan of a run."""

    @property
    def entries(self) -> Mapping[str, Any]:
        """Entries of a run's header that identify its executor."""
        ...

    def execute(
        self,
        plan: PlanResult,
        folder: Path,
        recorders: Sequence[Recorder],
        sync: Callable[[], None],
    ) -> Executed:
        """Execute a plan.

        Args:
            plan: plan to execute.
            folder: of the run.
            recorders: receive every event, then are closed.
            sync: returns once all events so far are on the disk.

        Raises:
            DeadlockError: no robot could continue.
        """
        ...

    def plan_to_resume(
        self, case: LoadedScenario, folder: Path, header: RunHeader
    ) -> PlanResult:
        """Return the plan with which a run began.

        Raises:
            ResumeError: it cannot be had any more.
        """
        ...

    def continued(
        self, plan: PlanResult, folder: Path, log: Sequence[str]
    ) -> Executor | None:
        """Return an executor that continues a run after its log; None to execute from the start.

        Raises:
            ResumeError: the run cannot be continued.
        """
        ...


def executor_of(header: RunHeader, folder: Path) -> Executor:
    """Return the executor of a run that has begun.

    Raises:
        RequestError: it is not installed.
        ResumeError: it cannot execute the run again.
    """
    found: Executor = EXECUTORS.load(header.executor).of(header, folder)
    return found


class SimulatedExecutor:
    """Executes plans in the simulation, as they are."""

    @classmethod
    def of(cls, _header: RunHeader, _folder: Path) -> SimulatedExecutor:
        """Return the executor of a run that has begun."""
        return cls()

    @property
    def entries(self) -> Mapping[str, Any]:
        """No entries of the header of a run."""
        return {}

    def execute(
        self,
        plan: PlanResult,
        _folder: Path,
        recorders: Sequence[Recorder],
        _sync: Callable[[], None],
    ) -> Executed:
        """Execute a plan; see Executor."""
        scenario, base = plan.scenario.sections, plan.scenario.folder
        record = execute(scenario, plan.tpg, base, recorders=tuple(recorders))
        return Executed(plan, record, finished=record.outcome == "completed")

    def plan_to_resume(
        self, case: LoadedScenario, folder: Path, header: RunHeader
    ) -> PlanResult:
        """Return the plan in the folder of a run."""
        return PlanResult(case, plan_of_run(folder), header.plan, folder=folder)

    def continued(self, _plan: PlanResult, _folder: Path, _log: Sequence[str]) -> None:
        """Return None: a run is executed again from its start."""

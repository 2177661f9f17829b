"""Executor of runs with replanning (``twin operate``): executes a plan and revises it after failures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from scheduling.graph.plan_files import load_plan, plan_sha256, save_plan
from twin.engine.execution import Ports
from twin.operations.operation import operate
from twin.operations.person import AnswerCallback
from twin.recorders.observers import Recorder
from twin.runs.folder import FIRST, VERSIONS
from twin.runs.header import RunHeader
from twin.trial.errors import ResumeError
from twin.trial.executor import Executed
from twin.trial.loaded_scenario import LoadedScenario
from twin.trial.plan_result import PlanResult
from twin.trial.planning import plan_scenario
from twin.trial.simulation import scenario_execution
from twin.uncertainty.disturbances import Disturbances


@dataclass(frozen=True)
class OperatedExecutor:
    """Executes plans in the simulation, and replans after failures.

    Attributes:
        answer: answers for a person; see twin.operate.
    """

    answer: AnswerCallback | None = None

    @classmethod
    def of(cls, header: RunHeader, folder: Path) -> OperatedExecutor:
        """Return the executor of a run that has begun.

        Raises:
            ResumeError: a person answered questions in it.
        """
        require_unanswered(header, folder)
        return cls()

    @property
    def entries(self) -> Mapping[str, Any]:
        """Entries of a run's header that identify its executor."""
        return {"operated": True, "answered": self.answer is not None}

    def execute(
        self,
        plan: PlanResult,
        folder: Path,
        recorders: Sequence[Recorder],
        _sync: Callable[[], None],
    ) -> Executed:
        """Execute a plan; see Executor."""
        return operate_plan(plan, folder, recorders, self.answer)

    def plan_to_resume(
        self, case: LoadedScenario, folder: Path, _header: RunHeader
    ) -> PlanResult:
        """Return the plan with which a run began; see ``plan_again``."""
        return plan_again(case, folder)

    def continued(self, _plan: PlanResult, _folder: Path, _log: Sequence[str]) -> None:
        """Return None: a run is executed again from its start."""


def require_unanswered(header: RunHeader, folder: Path) -> None:
    """Refuse to resume a run in which a person answered questions.

    Raises:
        ResumeError: a person answered.
    """
    if header.answered:
        raise ResumeError(
            f"{folder}: somebody answered at the keyboard while it ran, and may answer otherwise now: run it again"
        )


def plan_again(case: LoadedScenario, folder: Path) -> PlanResult:
    """Plan the start of a run again, with the data that replanning needs.

    Raises:
        ResumeError: the new plan differs from the saved one.
    """
    plan = plan_scenario(case, keep=True)
    if plan_sha256(plan.tpg) != plan_sha256(load_plan(folder / FIRST)):
        raise ResumeError(f"{folder / FIRST}: planned again, it is another plan")
    return plan


def operate_plan(
    plan: PlanResult,
    folder: Path,
    recorders: Sequence[Recorder],
    answer: AnswerCallback | None = None,
    ports: Ports | None = None,
) -> Executed:
    """Execute a plan and replan after failures; each revision is saved in the folder.

    Args:
        plan: plan to execute.
        folder: of the run.
        recorders: receive every event, then are closed.
        answer: answers for a person.
        ports: robots and audience, where drivers move the robots; None for a simulation.
    """
    scenario, base = plan.scenario.sections, plan.scenario.folder
    model = scenario_execution(scenario, base)
    if ports is not None:
        # With drivers, disturbances are real and not simulated.
        model = replace(model, disturbances=Disturbances())
    done = operate(
        scenario,
        plan.motions,
        plan.tpg,
        model,
        seed=scenario.seed,
        recorders=recorders,
        answer=answer,
        ports=ports,
        keep=lambda number, tpg: save_plan(tpg, folder / VERSIONS / str(number)),
    )
    come = list(done.rush_after)
    values = {"assembly.products.rush_after": come} if come else {}
    return Executed(
        replace(plan, tpg=done.tpg, scenario=plan.scenario.varied(values)),
        done.record,
        bool(done.versions),
        done.finished,
        {"operation": done.content()},
    )

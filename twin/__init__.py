"""Digital twin of robot teams: ``twin.simulate(twin.plan(twin.load("cell.yaml"))).makespan_s``.

The names below are the public interface, together with the interfaces for extensions; docs/reference/python.md
lists both, and docs/guides/python.md explains them. Each name is imported when it is first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

_MODULES = {
    "ArgumentError": "planning.errors",
    "ConstructionError": "planning.errors",
    "FittingError": "planning.errors",
    "InfeasibleStepError": "planning.errors",
    "OutputError": "planning.errors",
    "PlanInvariantError": "planning.errors",
    "RequestError": "planning.errors",
    "RobotModelError": "planning.errors",
    "ScenarioError": "planning.errors",
    "ShapeError": "planning.errors",
    "TransitError": "planning.errors",
    "TwinError": "planning.errors",
    "UndecidedError": "planning.errors",
    "plan": "twin.api.runs",
    "run": "twin.api.runs",
    "simulate": "twin.api.runs",
    "Audit": "twin.audits.api",
    "audit": "twin.audits.api",
    "Check": "twin.checks.api",
    "check": "twin.checks.api",
    "ClusterError": "twin.cluster.client",
    "ClusterLostError": "twin.cluster.client",
    "InvalidScenarioError": "twin.document.validation",
    "Explored": "twin.explorations.api",
    "explore": "twin.explorations.api",
    "operate": "twin.operations.api",
    "replay": "twin.rerun.api",
    "RunMoment": "twin.trial.run_moment",
    "ViewerError": "twin.rerun.viewer",
    "DeadlockError": "twin.runs.execution_record",
    "Comparison": "twin.studies.compare",
    "Study": "twin.studies.api",
    "compare": "twin.studies.compare",
    "resume_study": "twin.studies.api",
    "study": "twin.studies.api",
    "Precision": "twin.studies.replications.statistics",
    "LoadedScenario": "twin.trial.loaded_scenario",
    "load": "twin.trial.loaded_scenario",
    "PlanResult": "twin.trial.plan_result",
    "read_plan": "twin.trial.plan_result",
    "RunResult": "twin.trial.run_result",
    "read_run": "twin.trial.run_result",
    "TooManyPiecesError": "planning.meshes.convex_pieces",
    "InterlockedError": "planning.disassembly.assembly_plan",
    "FrankaError": "twin.drivers.franka_hand",
    "CircularWaitsError": "twin.judge.delays",
    "MessageError": "twin.live.wire_format",
    "UnknownEntryError": "twin.registry",
    "EventLogError": "twin.runs.events",
    "ResumeError": "twin.trial.errors",
    "IncompleteRunError": "twin.trial.errors",
}
"""Module of each name; it is imported when the name is first used."""

if TYPE_CHECKING:
    from planning.disassembly.assembly_plan import InterlockedError as InterlockedError
    from planning.errors import ArgumentError as ArgumentError
    from planning.errors import ConstructionError as ConstructionError
    from planning.errors import FittingError as FittingError
    from planning.errors import InfeasibleStepError as InfeasibleStepError
    from planning.errors import OutputError as OutputError
    from planning.errors import PlanInvariantError as PlanInvariantError
    from planning.errors import RequestError as RequestError
    from planning.errors import RobotModelError as RobotModelError
    from planning.errors import ScenarioError as ScenarioError
    from planning.errors import ShapeError as ShapeError
    from planning.errors import TransitError as TransitError
    from planning.errors import TwinError as TwinError
    from planning.errors import UndecidedError as UndecidedError
    from planning.meshes.convex_pieces import TooManyPiecesError as TooManyPiecesError
    from twin.api.runs import plan as plan
    from twin.api.runs import run as run
    from twin.api.runs import simulate as simulate
    from twin.audits.api import Audit as Audit
    from twin.audits.api import audit as audit
    from twin.checks.api import Check as Check
    from twin.checks.api import check as check
    from twin.cluster.client import ClusterError as ClusterError
    from twin.cluster.client import ClusterLostError as ClusterLostError
    from twin.document.validation import (
        InvalidScenarioError as InvalidScenarioError,
    )
    from twin.drivers.franka_hand import FrankaError as FrankaError
    from twin.explorations.api import Explored as Explored
    from twin.explorations.api import explore as explore
    from twin.judge.delays import CircularWaitsError as CircularWaitsError
    from twin.live.wire_format import MessageError as MessageError
    from twin.operations.api import operate as operate
    from twin.registry import UnknownEntryError as UnknownEntryError
    from twin.rerun.api import replay as replay
    from twin.rerun.viewer import ViewerError as ViewerError
    from twin.runs.events import EventLogError as EventLogError
    from twin.runs.execution_record import DeadlockError as DeadlockError
    from twin.studies.api import Study as Study
    from twin.studies.api import resume_study as resume_study
    from twin.studies.api import study as study
    from twin.studies.compare import Comparison as Comparison
    from twin.studies.compare import compare as compare
    from twin.studies.replications.statistics import Precision as Precision
    from twin.trial.errors import IncompleteRunError as IncompleteRunError
    from twin.trial.errors import ResumeError as ResumeError
    from twin.trial.loaded_scenario import LoadedScenario as LoadedScenario
    from twin.trial.loaded_scenario import load as load
    from twin.trial.plan_result import PlanResult as PlanResult
    from twin.trial.plan_result import read_plan as read_plan
    from twin.trial.run_moment import RunMoment as RunMoment
    from twin.trial.run_result import RunResult as RunResult
    from twin.trial.run_result import read_run as read_run

__all__ = sorted(_MODULES)


def __getattr__(name: str) -> object:
    """Import the object of a name that is used for the first time.

    Raises:
        AttributeError: there is no such name, or the part that has it is not installed.
    """
    if name == "__version__":
        from importlib.metadata import version

        found: object = version("assembly-twin")
    elif name in _MODULES:
        try:
            found = getattr(import_module(_MODULES[name]), name)
        except ModuleNotFoundError as error:
            if not (error.name or "").startswith(("twin.", "scheduling.", "planning.")):
                raise
            raise AttributeError(
                f"twin.{name} needs {error.name}, which is not installed"
            ) from error
    else:
        raise AttributeError(f"module 'twin' has no attribute {name!r}")
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    """Return the names that other programs may rely on."""
    return [*__all__, "__version__"]

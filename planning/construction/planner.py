"""Construction planning: problem in, timed plan and statistics out (Hartmann et al.)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from planning.construction.problem.problem import ConstructionProblem
from planning.construction.problem.reach_bounds import reach_bounds
from planning.construction.problem.settings import PlannerSettings, SearchSettings
from planning.construction.search import ConstructionSearch
from planning.construction.subproblem import Attempt, SubproblemSolver
from planning.construction.world.building import Building


@dataclass(frozen=True)
class ConstructionPlan:
    """A planned construction.

    Attributes:
        problem: what is built by whom.
        building: all timelines, and the work that they are made of.
        seconds: wall-clock seconds by component: keyframes, and path with its post-processing.
        cpu: processor seconds, likewise.
        rewound: how many placements were taken back.
        failures: what did not work on the way.
    """

    problem: ConstructionProblem
    building: Building
    seconds: Mapping[str, float]
    cpu: Mapping[str, float]
    rewound: int = 0
    failures: tuple[Attempt, ...] = ()

    @property
    def makespan(self) -> float:
        """Time at which the last robot has done its work [s]."""
        return max(work.end for work in self.building.work)


def no_progress(done: int, total: int) -> None:
    """Ignore progress."""


def plan_construction(
    problem: ConstructionProblem,
    settings: PlannerSettings | None = None,
    progress: Callable[[int, int], None] = no_progress,
) -> ConstructionPlan:
    """Plan a construction in space and time.

    Args:
        problem: what is built by whom.
        settings: effort.
        progress: told how many parts are planned, of how many.

    Raises:
        ConstructionError: no plan was found.
    """
    settings = settings or PlannerSettings()
    solver = SubproblemSolver(reach_bounds(problem), settings.subproblem)
    return plan_with(solver, settings.search, progress)


def plan_with(
    solver: SubproblemSolver,
    settings: SearchSettings,
    progress: Callable[[int, int], None],
) -> ConstructionPlan:
    """Search with some solver of sub-problems; see plan_construction."""
    search = ConstructionSearch(solver, settings, progress)
    building = search.run()
    return ConstructionPlan(
        solver.problem,
        building,
        dict(solver.watch.seconds),
        dict(solver.watch.cpu),
        search.rewound,
        tuple(search.failures),
    )

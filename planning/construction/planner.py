"""Construction planning: a depth-first search over parts and robots with backtracking (Hartmann et al. IV-D)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import NamedTuple

import numpy as np

from planning.construction.candidates import Skeleton, rank_next, skeletons
from planning.construction.held_parts import plan_held_part
from planning.construction.problem.problem import ConstructionProblem, Part
from planning.construction.problem.reach_bounds import reach_bounds
from planning.construction.problem.settings import PlannerSettings, SearchSettings
from planning.construction.subproblem import Attempt, Solution, SubproblemSolver
from planning.construction.world.fixed_world import BuildState, initial_build_state
from planning.errors import ConstructionError
from planning.progress import Progress, no_progress


@dataclass(frozen=True)
class ConstructionPlan:
    """A planned construction.

    Attributes:
        problem: the construction problem.
        building: all timelines, and the work that they are made of.
        seconds: wall-clock seconds by component: keyframes, path and its postprocessing.
        cpu: processor seconds, likewise.
        rewound: number of placements undone.
        failures: failures during the search.
    """

    problem: ConstructionProblem
    building: BuildState
    seconds: Mapping[str, float]
    cpu: Mapping[str, float]
    rewound: int = 0
    failures: tuple[Attempt, ...] = ()

    @property
    def makespan(self) -> float:
        """Time at which the last robot has finished [s]."""
        return max(work.end for work in self.building.work)


def plan_construction(
    problem: ConstructionProblem,
    settings: PlannerSettings | None = None,
    progress: Progress = no_progress,
) -> ConstructionPlan:
    """Plan a construction in space and time.

    Args:
        problem: the construction problem.
        settings: effort.
        progress: called with how many parts are planned, of how many.

    Raises:
        ConstructionError: no plan was found.
    """
    settings = settings or PlannerSettings()
    solver = SubproblemSolver(reach_bounds(problem), settings.subproblem)
    return plan_with_solver(solver, settings.search, progress)


def plan_with_solver(
    solver: SubproblemSolver,
    settings: SearchSettings,
    progress: Progress,
) -> ConstructionPlan:
    """Search with a given solver of sub-problems; see plan_construction."""
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


class ConstructionSearch:
    """Depth-first search over placements, with backtracking where a part cannot be placed.

    A part that no robot can place is blocked by others: the last placements are undone until it can be
    placed. The blocking parts are recorded, and are not all placed before it again as long as there are
    other candidates. The number of backtracks per part is bounded.

    Args:
        solver: of sub-problems.
        settings: effort of the search.
        progress: called with how many parts are planned, of how many.

    Attributes:
        rewound: number of placements undone.
        failures: attempts of all robots that could not place a part, in order.
        spent: how much has been tried: attempts, those that try hard thrice.
    """

    def __init__(
        self,
        solver: SubproblemSolver,
        settings: SearchSettings,
        progress: Progress,
    ) -> None:
        self.problem = problem = solver.problem
        self.solver = solver
        self.settings = settings
        self.progress = progress
        self.rewound = 0
        self.failures: list[Attempt] = []
        self.spent = 0
        self._rng = np.random.default_rng([problem.seed, 1])
        self._walls: dict[str, set[frozenset[str]]] = {}
        self._returns: Counter[str] = Counter()
        self._rounds = PlacementRounds(self, settings)

    def run(self) -> BuildState:
        """Return the state in which every part is in its place.

        Raises:
            ConstructionError: no way was found; names the part.
        """
        total = len(self.problem.parts)
        done = [initial_build_state(self.problem)]
        while len(done[-1].placed) < total:
            planned = self._rounds.next(done[-1])
            done += planned.states
            if planned.stuck is not None:
                done = self._backtrack(done, planned.stuck)
            self.progress(len(done[-1].placed), total)
        return done[-1]

    def next_parts(self, building: BuildState) -> list[Part]:
        """Return the parts that may be placed next, best first."""
        ranked = rank_next(self.problem, building, self._walls, self._rng)
        if not ranked:
            # The recorded blockers exclude every part: ignore them, and see what can be placed.
            ranked = rank_next(self.problem, building, {}, self._rng)
        return [self.problem.part(name) for name in ranked]

    def _backtrack(self, done: list[BuildState], part: Part) -> list[BuildState]:
        """Return the states up to one from which a part that failed can be placed.

        Raises:
            ConstructionError: it cannot be placed before any of the others, either; or others
                that come after it cannot, again and again.
        """
        if self._returns[part.name] >= self.settings.returns:
            others = ", ".join(sorted(set(self._returns) - {part.name}))
            raise ConstructionError(
                f"no way was found to place both {part.name} and {others or 'the rest'}: whichever "
                f"comes first keeps the other from its place",
                parts=[part.name],
            )
        for effort in range(self.settings.efforts):
            # In the last state it has just failed with no more effort than usual.
            for back in range(1 if effort == 0 else 0, len(done)):
                before = done[-1 - back]
                if part.name not in self.problem.balance.placeable(before.placed):
                    continue
                after = (
                    self._place(before, part, effort)
                    if effort
                    else self.place_next(before, [part], 0, np.inf)
                )
                if after is None:
                    continue
                if back:
                    wall = frozenset(done[-back].placed)
                    self._walls.setdefault(part.name, set()).add(wall)
                    self._returns[part.name] += 1
                    self.rewound += back
                return [*done[: len(done) - back], after.building]
        robots = ", ".join(
            dict.fromkeys(
                " and ".join(f.robots)
                for f in self.failures
                if f.part.name == part.name
            )
        )
        raise ConstructionError(
            f"no way was found to place {part.name}, with any of the {len(done) - 1} parts"
            f" planned before it in place or taken back; tried: {robots or 'nobody'}",
            parts=[part.name],
        )

    def place_next(
        self, building: BuildState, parts: list[Part], turn: int, most_loss: float
    ) -> Solution | None:
        """Plan the placement of the first part, or of another one where that is easier.

        Args:
            building: the state before.
            parts: that may be placed next, the best first.
            turn: how often this has been planned before. The first time all is tried, later
                only what is easy and one hard attempt.
            most_loss: a way with which so much time is lost is of no use [s].
        """
        own = [building.step, self.rewound, turn]
        easy = self._place_easily(building, parts, own, most_loss)
        if easy is not None:
            return easy
        if turn == 0:
            return self._place(building, parts[0])
        skeleton = next(skeletons(self.solver.bounds, building, parts[0]), None)
        if skeleton is None:
            return None
        seed = [self.problem.seed, 4, *own]
        return self._solve(building, Attempt(parts[0], skeleton, seed, lost=most_loss))

    def _place_easily(
        self,
        building: BuildState,
        parts: Sequence[Part],
        own: Sequence[int],
        most_loss: float,
    ) -> Solution | None:
        """Return the best of a few placements by paths that need little search, None for none.

        The first robot places the first part. Where it would lose time with that, because
        others are in its way or what the part rests on comes late, it may place another one;
        of a few the one with which it loses least. Where there are few parts for many robots
        all wait for the first: other robots are tried, in case they are sooner.

        Args:
            building: the state before.
            parts: that may be placed next, the best first.
            own: part of the seed of all random numbers.
            most_loss: a way with which as much time is lost is of no use [s].
        """
        team = self.problem.team
        seed = [self.problem.seed, 3, *own]
        if len(team) == 1 or len(parts) <= len(team) // 2:
            return self._place_soonest(building, parts[0], seed, most_loss)
        best: Solution | None = None
        for part in parts[: self.settings.parts]:
            first = next(skeletons(self.solver.bounds, building, part, 1), None)
            if first is None:
                break
            attempt = self._low_effort_attempt(part, first, seed, most_loss)
            found = self._solve(building, attempt)
            if found is None:
                continue
            best, most_loss = found, found.lost
            if found.lost <= self.settings.late_s:
                break
        return best

    def _place_soonest(
        self, building: BuildState, part: Part, seed: Sequence[int], most_loss: float
    ) -> Solution | None:
        """Return the candidate that has a part in place earliest, None for none.

        The first robot does it, unless others are in its way and it would be late: then others
        are asked, too, as long as they may be sooner.
        """
        best: Solution | None = None
        latest = np.inf
        alone = skeletons(self.solver.bounds, building, part, 1)
        for skeleton in islice(alone, self.settings.asked):
            free = building.world.free_from(skeleton[0])
            seconds = self.problem.seconds_of("pick", skeleton[0], part)
            seconds += self.problem.seconds_of("place-down", skeleton[-1], part)
            if free + seconds > latest:
                break
            attempt = self._low_effort_attempt(part, skeleton, seed, most_loss)
            found = self._solve(building, replace(attempt, latest=latest))
            if found is None:
                continue
            if found.building.placed[part.name] < latest:
                best, latest = found, found.building.placed[part.name]
            if found.late <= self.settings.late_s:
                break
        return best

    def _low_effort_attempt(
        self, part: Part, robots: Skeleton, seed: Sequence[int], lost: float
    ) -> Attempt:
        own = [*seed, self.problem.team.index(robots[0])]
        return Attempt(part, robots, own, low_effort=True, lost=lost)

    def _place(
        self, building: BuildState, part: Part, effort: int = 0
    ) -> Solution | None:
        """Plan the placement of a part; None where no robot can do it.

        Args:
            building: the state before.
            part: what is placed.
            effort: how much harder than usual is tried.
        """
        for skeleton in skeletons(self.solver.bounds, building, part):
            for turn in range(self.settings.attempts):
                seed = [self.problem.seed, 2, building.step, self.rewound, turn]
                # One number for each action.
                acting = skeleton[0], *skeleton, skeleton[-1]
                seed += [effort, *map(self.problem.team.index, acting)]
                attempt = Attempt(part, skeleton, seed, effort)
                after = self._solve(building, attempt)
                if after is not None:
                    return after
            self.failures.append(attempt)
        return None

    def _solve(self, building: BuildState, attempt: Attempt) -> Solution | None:
        """Plan the transport of a part to its place; None where that failed."""
        self.spent += 1 if attempt.low_effort else 3
        return self.solver.solve(building, attempt)


class PlacementRound(NamedTuple):
    """Placements, one after another.

    Attributes:
        states: after each of them.
        lost: for how long robots stood or made detours, and at the end of a construction for
            how long they had nothing to do [s].
        stuck: the part that could not be placed, None where all was well.
    """

    states: list[BuildState]
    lost: float
    stuck: Part | None = None


@dataclass
class PlacementRounds:
    """Rounds of a few placements, replanned where robots lose much time.

    Robots are planned one after another, so an early one may block all others: most of all with the first
    parts, when all robots start together, and with the last ones, when some are idle. Other random numbers
    often lose half as much time.

    Attributes:
        search: plans a placement.
        settings: how often a round is planned.
    """

    search: ConstructionSearch
    settings: SearchSettings

    def __post_init__(self) -> None:
        """Set the number of attempts that may go into replanning."""
        parts, robots = len(self.search.problem.parts), len(self.search.problem.team)
        self._spare = self.settings.again * parts / robots

    def next(self, start: BuildState) -> PlacementRound:
        """Return the next placements: the best of a few tries.

        Args:
            start: the state before.
        """
        size = min(len(self.search.problem.team), self.settings.round)
        left = len(self.search.problem.parts) - len(start.placed)
        if left < 2 * size:
            size = left  # no short round at the end
        best = self._plan(start, size, 0, np.inf)
        for turn in range(1, self.settings.tries):
            if (
                best.stuck is not None
                or best.lost <= self.settings.acceptable_loss_s * size
                or self._spare <= 0.0
            ):
                break
            before = self.search.spent
            found = self._plan(start, size, turn, best.lost)
            self._spare -= self.search.spent - before
            if found.stuck is None and found.lost < best.lost:
                best = found
        return best

    def _plan(
        self, start: BuildState, size: int, turn: int, most_loss: float
    ) -> PlacementRound:
        """Return a round, aborted when the time lost exceeds a limit."""
        states: list[BuildState] = []
        now, lost, total = start, 0.0, len(self.search.problem.parts)
        while len(now.placed) < min(len(start.placed) + size, total):
            parts = self.search.next_parts(now)
            if parts:
                found = self.search.place_next(now, parts, turn, most_loss - lost)
            else:
                found = plan_held_part(self.search.solver, now)
            if found is None:
                return PlacementRound(
                    states, lost, parts[0] if parts else self._held(now)
                )
            now, lost = found.building, lost + found.lost
            states.append(now)
        if len(now.placed) == total:
            free = [now.world.free_from(robot) for robot in self.search.problem.team]
            lost += sum(max(free) - t for t in free)
        return PlacementRound(states, lost)

    def _held(self, building: BuildState) -> Part:
        problem = self.search.problem
        return problem.part(next(problem.balance.held(building.placed))[0])

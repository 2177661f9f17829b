"""Searches over objects, robots and action sequences, depth first with backtracking (IV-D)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from planning.construction.attempt import Attempt
from planning.construction.bounds import ReachBounds
from planning.construction.building import Building, nothing_built
from planning.construction.candidates import Candidates
from planning.construction.easy_placement import EasyPlacement
from planning.construction.object_order import rank_parts
from planning.construction.problem import ConstructionProblem, Part
from planning.construction.search_settings import SearchSettings
from planning.construction.skeletons import Skeleton, robots_of
from planning.construction.subproblem import SubproblemSolver
from planning.errors import ConstructionError
from planning.kinematics import frame_pose


@dataclass(frozen=True)
class Failure:
    """What did not work, for the list that is gone through again when nothing else is left.

    Attributes:
        part: its name.
        skeleton: the sequence of actions.
        placed: parts that were in place.
        effort: how hard it was tried, from 0.
    """

    part: str
    skeleton: Skeleton
    placed: frozenset[str]
    effort: int


class ConstructionSearch:
    """Plans part after part, fixed once planned, and takes placements back where it must.

    A part that nobody can place is kept from its place by others: those placed last are taken
    back until it can be placed. The parts that were in its way are remembered, and never
    complete again before it, so the search ends.

    Args:
        problem: what is built by whom.
        bounds: who reaches what.
        solver: of sub-problems.
        settings: how hard is tried.
        progress: told how many parts are planned, of how many.

    Attributes:
        rewound: how many placements have been taken back.
        failures: what did not work, in order.
    """

    def __init__(
        self,
        problem: ConstructionProblem,
        bounds: ReachBounds,
        solver: SubproblemSolver,
        settings: SearchSettings,
        progress: Callable[[int, int], None],
    ) -> None:
        self.problem = problem
        self.candidates = Candidates(problem, bounds, settings.group)
        self.easy = EasyPlacement(problem, self.candidates, solver, settings)
        self.solver = solver
        self.settings = settings
        self.progress = progress
        self.rewound = 0
        self.failures: list[Failure] = []
        self._rng = np.random.default_rng([problem.seed, 1])
        self._walls: dict[str, set[frozenset[str]]] = {}

    def run(self) -> Building:
        """Return the state in which every part is in its place.

        Raises:
            ConstructionError: no way was found; names the part.
        """
        total = len(self.problem.parts)
        done = [nothing_built(self.problem)]
        while len(done[-1].placed) < total:
            parts = self._next_parts(done[-1])
            after = self._place(done[-1], parts)
            if after is not None:
                done.append(after)
            else:
                done = self._backtrack(done, parts[0])
            self.progress(len(done[-1].placed), total)
        return done[-1]

    def _next_parts(self, building: Building) -> list[Part]:
        problem = self.problem
        world = building.world
        robot = min(problem.team, key=world.free_from)
        free = world.free_from(robot)
        q = world.robots[robot].at(free)
        tool = frame_pose(problem.cell.robot(robot), q, problem.frame)[:3, 3]
        args = (problem, building.placed)
        ranked = rank_parts(*args, self._walls, self._rng, free, tool)
        if not ranked:
            # What has been remembered leaves nothing: go on, and see what can be placed.
            ranked = rank_parts(*args, {}, self._rng, free, tool)
        return [problem.part(name) for name in ranked]

    def _backtrack(self, done: list[Building], part: Part) -> list[Building]:
        """Return the states up to one in which a part is in its place that could not be placed.

        Raises:
            ConstructionError: it cannot be placed before any of the others, either.
        """
        for effort in range(self.settings.efforts):
            # In the last state it has just failed with no more effort than usual.
            for back in range(1 if effort == 0 else 0, len(done)):
                before = done[-1 - back]
                if part.name not in self._placeable(before):
                    continue
                after = self._place(before, (part,), effort)
                if after is None:
                    continue
                if back:
                    wall = frozenset(done[-back].placed)
                    self._walls.setdefault(part.name, set()).add(wall)
                    self.rewound += back
                return [*done[: len(done) - back], after]
        robots = ", ".join(
            dict.fromkeys(
                " and ".join(robots_of(f.skeleton))
                for f in self.failures
                if f.part == part.name
            )
        )
        raise ConstructionError(
            f"no way was found to place {part.name}, with any of the {len(done) - 1} parts"
            f" planned before it in place or taken back; tried: {robots or 'nobody'}"
        )

    def _placeable(self, building: Building) -> tuple[str, ...]:
        problem = self.problem
        return problem.graph.placeable(building.placed, carried=problem.carried)

    def _place(
        self, building: Building, parts: Sequence[Part], effort: int = 0
    ) -> Building | None:
        """Return the state in which a part is in its place, None where nobody can do it.

        Args:
            building: the state before.
            parts: the first is placed, or another one where that is easier.
            effort: how much harder than usual is tried.
        """
        if effort == 0:
            seed = [self.problem.seed, 3, building.step, self.rewound]
            easy = self.easy.place(building, parts, seed)
            if easy is not None:
                return easy
        part = parts[0]
        for skeleton in self.candidates.of(building, part):
            for attempt in range(self.settings.attempts):
                seed = [self.problem.seed, 2, building.step, self.rewound, attempt]
                seed += [effort, *(self.problem.team.index(a.robot) for a in skeleton)]
                after = self.solver.solve(
                    building, Attempt(part, skeleton, seed, effort)
                )
                if after is not None:
                    return after.building
            placed = frozenset(building.placed)
            self.failures.append(Failure(part.name, skeleton, placed, effort))
        return None

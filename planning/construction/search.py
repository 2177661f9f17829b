"""Searches over objects, robots and action sequences, depth first with backtracking (IV-D)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np

from planning.construction.bounds import ReachBounds
from planning.construction.building import Building, nothing_built
from planning.construction.object_order import rank_parts
from planning.construction.problem import ConstructionProblem, Part
from planning.construction.skeletons import Skeleton, skeletons
from planning.construction.subproblem import Solution, SubproblemSolver
from planning.errors import ConstructionError
from planning.kinematics import frame_pose


@dataclass(frozen=True)
class SearchSettings:
    """How hard the search tries.

    Attributes:
        attempts: of each sequence of actions, before the next robots are tried.
        group: most robots that work on one part together.
        asked: robots that may plan a part before anything is tried hard, one after another, as
            long as each is late; where there are no more parts to place than for half of them.
        parts: that the first robot may plan before anything is tried hard, one after another,
            as long as it loses time with each; where there are more.
        late: a part that comes no later than this after speeds and the world at its place allow
            is not late, and so much is no loss [s].
        efforts: how often failures are gone through again when nothing else is left, each
            time trying harder.
    """

    attempts: int = 2
    group: int = 2
    asked: int = 3
    parts: int = 3
    late: float = 2.0
    efforts: int = 3


def robot_groups(
    building: Building, team: tuple[str, ...], size: int
) -> list[tuple[str, ...]]:
    """Return the groups of a size, those first that are free earliest (eq. 7)."""
    free = {name: building.world.free_from(name) for name in team}
    groups = set(combinations(team, size))
    return sorted(
        groups,
        key=lambda g: (max(free[r] for r in g), [team.index(r) for r in g]),
    )


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
        self.bounds = bounds
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
                " and ".join(_robots(f.skeleton))
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
            easy = self._place_easily(building, parts)
            if easy is not None:
                return easy
        part = parts[0]
        for skeleton in self._skeletons(building, part):
            for attempt in range(self.settings.attempts):
                seed = [self.problem.seed, 2, building.step, self.rewound, attempt]
                seed += [effort, *(self.problem.team.index(a.robot) for a in skeleton)]
                after = self.solver.solve(building, part, skeleton, seed, effort)
                if after is not None:
                    return after.building
            placed = frozenset(building.placed)
            self.failures.append(Failure(part.name, skeleton, placed, effort))
        return None

    def _place_easily(
        self, building: Building, parts: Sequence[Part]
    ) -> Building | None:
        """Return the best of a few states in which a part is in its place, None for none.

        The first robot places the first part. Where it would lose time with that, because
        others are in its way or what the part rests on comes late, it may place another one;
        of a few the one with which it loses least. Where there are few parts for many robots
        all wait for the first: others are asked whether they have it there sooner.
        """
        team = self.problem.team
        if len(team) == 1 or len(parts) <= len(team) // 2:
            return self._soonest(building, parts[0])
        best: Solution | None = None
        for part in parts[: self.settings.parts]:
            skeleton = next(self._skeletons(building, part), ())
            if len(_robots(skeleton)) != 1:
                break
            found = self._easily(building, part, skeleton)
            if found is not None and (best is None or found.lost < best.lost):
                best = found
            if best is not None and best.lost <= self.settings.late:
                break
        return None if best is None else best.building

    def _soonest(self, building: Building, part: Part) -> Building | None:
        """Return the state in which a part is in its place soonest, None for none.

        The first robot does it, unless others are in its way and it would be late: then others
        are asked, too, as long as they may be sooner.
        """
        best: Solution | None = None
        latest = np.inf
        asked = 0
        for skeleton in self._skeletons(building, part):
            robots = _robots(skeleton)
            if len(robots) > 1 or asked >= self.settings.asked:
                break
            if building.world.free_from(robots[0]) + self._least() > latest:
                break
            asked += 1
            found = self._easily(building, part, skeleton, latest)
            if found is None:
                continue
            if found.building.placed[part.name] < latest:
                best, latest = found, found.building.placed[part.name]
            if found.late <= self.settings.late:
                break
        return None if best is None else best.building

    def _easily(
        self,
        building: Building,
        part: Part,
        skeleton: Skeleton,
        latest: float = np.inf,
    ) -> Solution | None:
        """Return how a part can be placed by ways that are easy to find, None for none."""
        seed = [self.problem.seed, 3, building.step, self.rewound]
        seed += [self.problem.team.index(r) for r in _robots(skeleton)]
        return self.solver.solve(
            building, part, skeleton, seed, hasty=True, latest=latest
        )

    def _least(self) -> float:
        """Return how long a robot works on a part that it picks and places at least [s]."""
        return self.problem.seconds.pick + self.problem.seconds.place

    def _skeletons(self, building: Building, part: Part) -> Iterator[Skeleton]:
        """Yield sequences of actions: robots by eq. 7, one before several, short before long."""
        for size in range(1, self.settings.group + 1):
            for group in robot_groups(building, self.problem.team, size):
                for skeleton in skeletons(group):
                    if self._may_work(part, skeleton):
                        yield skeleton

    def _may_work(self, part: Part, skeleton: Skeleton) -> bool:
        """Tell whether lower bounds leave a sequence of actions any chance."""
        robots = _robots(skeleton)
        if len(robots) == 1:
            return robots[0] in self.bounds.alone(part)
        return (
            bool(self.bounds.pick_grips(robots[0], part))
            and bool(self.bounds.place_grips(robots[-1], part))
            and all(self.bounds.can_hand_over(a, b, part) for a, b in pairwise(robots))
        )


def _robots(skeleton: Skeleton) -> tuple[str, ...]:
    return tuple(dict.fromkeys(action.robot for action in skeleton))

"""Parts that would fall: who places one keeps hold of it until another robot has placed the next."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planning.construction.candidates import skeletons
from planning.construction.checks.checker import SpaceTimeChecker
from planning.construction.checks.time_windows import arrival_windows
from planning.construction.problem.problem import Part
from planning.construction.subproblem import (
    Attempt,
    LegPlanner,
    Solution,
    SubproblemSolver,
)
from planning.construction.world.fixed_world import Building, Keeping
from planning.steps.skill import gripped


def place_held(solver: SubproblemSolver, building: Building) -> Solution | None:
    """Plan a part that would fall, the one that keeps it standing, and how its robot then leaves it.

    Args:
        solver: of sub-problems.
        building: the state before, in which no part may come that stands at once.

    Returns:
        The state with both in place, None where nobody can do it.
    """
    bounds, problem = solver.bounds, solver.problem
    for name, other in problem.balance.held(building.placed):
        part, last = problem.part(name), problem.part(other)
        for holder in skeletons(bounds, building, part, 1):
            seed = [problem.seed, 6, building.step, problem.team.index(holder[0])]
            kept = solver.solve(building, Attempt(part, holder, seed, keep=True))
            if kept is None:
                continue
            for robots in skeletons(bounds, kept.building, last):
                if holder[0] in robots:
                    continue
                own = [*seed, *map(problem.team.index, robots)]
                after = solver.solve(kept.building, Attempt(last, robots, own))
                if after is None:
                    continue
                done = _let_go(solver, after.building, part, last)
                if done is not None:
                    return replace(after, building=done)
    return None


def _let_go(
    solver: SubproblemSolver, building: Building, part: Part, last: Part
) -> Building | None:
    """Return the state in which a robot has let go of a part and left, None where it cannot.

    Args:
        solver: of sub-problems.
        building: the state before, in which it keeps hold of the part.
        part: what it lets go of.
        last: the part that is in place by then.
    """
    keeping = building.kept[part.name]
    robot, way = keeping.robot, keeping.way
    allowed = gripped(robot, part.name)
    checker = SpaceTimeChecker(building.world, robot, allowed=allowed)
    velocity = solver.problem.cell.robot(robot).model.velocity
    steps = np.max(np.abs(np.diff(way, axis=0)) / velocity, axis=1)
    times = np.concatenate([[0.0], np.cumsum(steps)])
    since = max(checker.start, building.placed[last.name])
    windows = arrival_windows([(checker, way)], float(times[-1]), since)
    if not len(windows):
        return None
    begin = float(windows[0, 0])
    # Others were planned before it was to stand here.
    if not checker.skill_free(way[:1], checker.start, begin):
        return None
    kept = {**building.kept, part.name: Keeping(robot, way, last.name, begin)}
    building = replace(building, kept=kept).moved(robot, begin + times, way)
    rng = np.random.default_rng([solver.problem.seed, 7, building.step])
    legs = LegPlanner(solver.settings.rrt, rng, solver.watch)
    return legs.retreat(building, robot)

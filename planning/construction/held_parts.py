"""Planning of parts that would fall if released: the robot that places one holds it until the next part is placed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

import numpy as np

from planning.construction.candidates import Skeleton, skeletons
from planning.construction.checks.checker import SpaceTimeChecker
from planning.construction.checks.time_windows import arrival_windows
from planning.construction.problem.problem import ConstructionProblem, Hold, Part
from planning.construction.subproblem import (
    Attempt,
    LegPlanner,
    Solution,
    SubproblemSolver,
)
from planning.construction.world.fixed_world import BuildState, HeldPlacement
from planning.construction.world.skill_motion import follow_straight_line
from planning.handling.skill_contacts import grip_contact
from planning.kinematics.kinematics import frame_pose
from planning.transforms import Array

Teams = Callable[[BuildState, Part], Iterable[Skeleton]]
"""Returns the robots that may place a part in a state, in order of preference."""


def plan_held_part(
    solver: SubproblemSolver,
    building: BuildState,
    teams: Teams | None = None,
    holds: Mapping[str, Hold] | None = None,
    effort: int = 0,
) -> Solution | None:
    """Plan a part that would fall, the part that secures it, and the retreat of its robot.

    Args:
        solver: of sub-problems.
        building: the state before, in which no part may come that stands at once.
        teams: robots that may place a part; by default all that no lower bound rules out.
        holds: how parts are held that are in hands already.
        effort: how much harder than usual is tried.

    Returns:
        The state with both in place, None where no robot can do it.
    """
    problem, own = solver.problem, holds or {}
    teams = teams or (lambda now, part: skeletons(solver.bounds, now, part))
    for name, other in problem.balance.held(building.placed):
        part = problem.part(name)
        for holder in teams(building, part):
            if len(holder) > 1:
                continue
            seed = [problem.seed, 6, building.step, problem.team.index(holder[0])]
            seed += [effort] * (effort > 0)
            attempt = Attempt(part, holder, seed, effort, keep=True, hold=own.get(name))
            kept = solver.solve(building, attempt)
            if kept is None:
                continue
            done = plan_securing_part(
                solver, kept.building, part, [other], teams, own, effort
            )
            if done is not None:
                return done
    return None


def plan_securing_part(
    solver: SubproblemSolver,
    building: BuildState,
    part: Part,
    others: Iterable[str],
    teams: Teams,
    holds: Mapping[str, Hold],
    effort: int = 0,
) -> Solution | None:
    """Plan a part that secures a held one, and the retreat of the robot that held it.

    Args:
        solver: of sub-problems.
        building: the state before.
        part: that would fall.
        others: parts with any of which it stands, by name.
        teams, holds, effort: see ``plan_held_part``.
    """
    problem, keeping = solver.problem, building.kept[part.name]
    robot, team = keeping.robot, problem.team
    number = [problem.seed, 6, building.step - 1]
    number.append(team.index(robot) if robot in team else len(team))
    for last in map(problem.part, others):
        for robots in teams(building, last):
            if robot in robots:
                continue
            seed = [*number, *map(team.index, robots), *[effort] * (effort > 0)]
            attempt = Attempt(last, robots, seed, effort, hold=holds.get(last.name))
            after = solver.solve(building, attempt)
            if after is None:
                continue
            kept = {
                **after.building.kept,
                part.name: keeping._replace(last=last.name),
            }
            done: BuildState | None = replace(after.building, kept=kept)
            if robot in team:  # else it is out, and stays
                done = release_part(solver, after.building, part, last)
            if done is not None:
                return replace(after, building=done)
    return None


def release_path(problem: ConstructionProblem, robot: str, q: Array) -> Array | None:
    """Return the path by which a robot retreats from a part that it holds, shape (w, n), None if it cannot.

    Args:
        problem: says how far.
        robot: its name.
        q: where it stands, shape (n,).
    """
    placed = problem.cell.robot(robot)
    at = frame_pose(placed, q, problem.frame)
    return follow_straight_line(
        placed, problem.frame, at, q, -problem.approach * at[:3, 2]
    )


def release_part(
    solver: SubproblemSolver, building: BuildState, part: Part, last: Part
) -> BuildState | None:
    """Return the state in which a robot has released a part and retreated, None where it cannot.

    Args:
        solver: of sub-problems.
        building: the state before, in which it keeps holding the part.
        part: the released part.
        last: the part placed last.
    """
    keeping = building.kept[part.name]
    robot, path = keeping.robot, keeping.exit_path
    allowed = grip_contact(robot, part.name)
    checker = SpaceTimeChecker(building.world, robot, allowed=allowed)
    velocity = solver.problem.cell.robot(robot).model.velocity
    steps = np.max(np.abs(np.diff(path, axis=0)) / velocity, axis=1)
    times = np.concatenate([[0.0], np.cumsum(steps)])
    since = max(checker.start, building.placed[last.name])
    windows = arrival_windows([(checker, path)], float(times[-1]), since)
    if not len(windows):
        return None
    begin = float(windows[0, 0])
    # Others were planned before it was to stand here.
    if not checker.skill_free(path[:1], checker.start, begin):
        return None
    kept = {**building.kept, part.name: HeldPlacement(robot, path, last.name, begin)}
    building = replace(building, kept=kept).moved(robot, begin + times, path)
    rng = np.random.default_rng([solver.problem.seed, 7, building.step])
    legs = LegPlanner(solver.settings.rrt, rng, solver.watch)
    return legs.retreat(building, robot)

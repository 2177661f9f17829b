"""Planners of others for single motions: each finds a path from one configuration to another."""

from collections.abc import Callable
from importlib.util import find_spec
from itertools import pairwise

import numpy as np

from benchmarks.open.free_space import FINE, FreeSpace
from planning.transforms import Array

Bounds = tuple[Array, Array]
"""Least and greatest joint values."""

PathFinder = Callable[[FreeSpace, Array, Array, Bounds, int], Array | None]
"""Returns a free polyline from start to goal within bounds with a seed, shape (w, n); None for none."""

_TRIES = 4000
"""Configurations that one search draws at most."""


def installed(module: str) -> bool:
    """Tell whether a planner's package is there."""
    return find_spec(module) is not None


def ompl_path(
    space: FreeSpace, start: Array, goal: Array, bounds: Bounds, seed: int
) -> Array | None:
    """Return a path of OMPL's RRT-Connect, made shorter by OMPL's own simplification."""
    from ompl import base as ob
    from ompl import geometric as og
    from ompl import util as ou

    n = len(start)
    ou.setLogLevel(ou.LogLevel.LOG_NONE)
    ou.RNG.setSeed(seed + 1)
    joints = ob.RealVectorStateSpace(n)
    box = ob.RealVectorBounds(n)
    for k in range(n):
        box.setLow(k, float(min(bounds[0][k], start[k], goal[k])))
        box.setHigh(k, float(max(bounds[1][k], start[k], goal[k])))
    joints.setBounds(box)
    information = ob.SpaceInformation(joints)

    class Asks(ob.MotionValidator):  # type: ignore[misc]
        count = 0

        def checkMotion(self, a: object, b: object) -> bool:  # noqa: N802 - OMPL's name
            self.count += 1
            return space.motion_free(values(a), values(b))

    def values(state: object) -> Array:
        return np.array([state[k] for k in range(n)])  # type: ignore[index]

    asks = Asks(information)
    information.setStateValidityChecker(ob.AllValidStateValidityChecker(information))
    information.setMotionValidator(asks)
    information.setup()
    problem = ob.ProblemDefinition(information)
    ends = joints.allocState(), joints.allocState()
    for k in range(n):
        ends[0][k], ends[1][k] = float(start[k]), float(goal[k])
    problem.setStartAndGoalStates(*ends)
    planner = og.RRTConnect(information)
    planner.setProblemDefinition(problem)
    planner.setup()
    over = ob.PlannerTerminationCondition(lambda: asks.count > _TRIES)
    if planner.solve(over).getStatus() != ob.PlannerStatus.EXACT_SOLUTION:
        return None
    path = problem.getSolutionPath()
    shorter = og.PathSimplifier(information)
    shorter.reduceVertices(path, 40, 15)
    shorter.partialShortcutPath(path, 60, 20)
    rows = np.array([values(state) for state in path.getStates()])
    rows[0], rows[-1] = start, goal
    return rows


def klampt_path(
    space: FreeSpace, start: Array, goal: Array, bounds: Bounds, seed: int
) -> Array | None:
    """Return a path of Klampt's bidirectional lazy planner (SBL), which shortcuts it itself."""
    from klampt.plan import cspace, motionplanning

    motionplanning.set_random_seed(seed + 1)
    asked = cspace.CSpace()
    low, high = np.minimum(bounds[0], start), np.maximum(bounds[1], start)
    low, high = np.minimum(low, goal), np.maximum(high, goal)
    asked.setBounds(list(zip(low.tolist(), high.tolist(), strict=True)))
    asked.eps = space.joint_step
    asked.feasible = lambda q: space.free(np.array(q))
    plan = cspace.MotionPlan(asked, "sbl", perturbationRadius=0.7, shortcut=1)
    try:
        plan.setEndpoints(start.tolist(), goal.tolist())
        for _ in range(_TRIES // 50):
            plan.planMore(50)
            path = plan.getPath()
            if path:
                rows = np.array(path)
                rows[0], rows[-1] = start, goal
                return rows
    finally:
        plan.close()
        asked.close()
    return None


def path_found(
    finder: PathFinder,
    space: FreeSpace,
    start: Array,
    goal: Array,
    bounds: Bounds,
    seed: int,
) -> Array | None:
    """Return a path of a planner that is free when it is looked at more finely, None after three tries."""
    if space.motion_free(start, goal, FINE):
        return np.array([start, goal])
    for attempt in range(3):
        path = finder(space, start, goal, bounds, 10 * seed + attempt)
        if path is not None and all(
            space.motion_free(a, b, FINE) for a, b in pairwise(path)
        ):
            return path
    return None

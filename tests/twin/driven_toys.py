"""Made-up graphs of robots that keep to limits of acceleration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from hypothesis import strategies as st

from planning.cell.robot_model import MotionLimits
from planning.cell.workcell import PlacedRobot
from scheduling.graph.temporal_plan_graph import NodeChain, TemporalPlanGraph
from scheduling.motion_times import within_limits
from tests.twin.twin_toys import random_tpg


def driven_tpg(
    seed: int,
    *,
    dofs: tuple[int, ...] = (2, 3),
    tasks: int = 6,
    nodes_per_transit: int = 6,
    edges: int = 8,
    jerk: float | None = None,
) -> TemporalPlanGraph:
    """Return a random graph whose transits are one or two straight stretches, with random limits.

    That of jerk is the same for all joints where it is given.
    """
    tpg = random_tpg(
        seed, dofs=dofs, tasks=tasks, nodes_per_transit=nodes_per_transit, edges=edges
    )
    return with_limits(tpg, np.random.default_rng(seed), _straightened, jerk)


DRIVEN_TPGS = st.builds(
    driven_tpg,
    st.integers(0, 10**6),
    dofs=st.sampled_from([(2, 3), (1, 2, 3), (2,)]),
    tasks=st.integers(1, 10),
    nodes_per_transit=st.integers(1, 12),
    edges=st.integers(0, 20),
)


def with_limits(
    tpg: TemporalPlanGraph,
    rng: np.random.Generator,
    laid: Callable[[NodeChain, np.random.Generator], NodeChain],
    jerk: float | None = None,
) -> TemporalPlanGraph:
    """Return a graph with random limits, and with chains as they are laid at random."""
    robots = tuple(_limited(robot, rng, jerk) for robot in tpg.cell.robots)
    chains = tuple(laid(chain, rng) for chain in tpg.chains)
    cell = replace(tpg.cell, robots=robots)
    return within_limits(replace(tpg, cell=cell, chains=chains))


def _limited(
    robot: PlacedRobot, rng: np.random.Generator, jerk: float | None
) -> PlacedRobot:
    """Return a robot with random limits."""
    n = robot.model.dof
    limits = MotionLimits(
        rng.uniform(0.5, 3.0, n), rng.uniform(1.0, 10.0, n), rng.uniform(20, 500, n)
    )
    if jerk is not None:
        limits = replace(limits, jerk=np.full(n, jerk))
    return replace(robot, limits=limits)


def _straightened(chain: NodeChain, rng: np.random.Generator) -> NodeChain:
    """Return a chain in which each task's pose nodes lie on one straight way, or on two."""
    points = chain.waypoints.copy()
    for task in np.unique(chain.task):
        nodes = np.flatnonzero((chain.task == task) & ~chain.skill)
        if not len(nodes):
            continue
        rows = chain.first[nodes]
        before = chain.start if rows[0] == 0 else points[rows[0] - 1]
        bend = int(rng.integers(0, len(rows)))
        corner = points[rows[bend]] if bend else before
        ends = [(0, bend, before, corner), (bend, len(rows), corner, points[rows[-1]])]
        for low, high, a, b in ends:
            for k in range(low, high):
                points[rows[k]] = a + (b - a) * ((k - low + 1) / (high - low))
    return replace(chain, waypoints=points)

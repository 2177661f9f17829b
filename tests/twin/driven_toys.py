"""Made-up graphs of robots that keep to limits of acceleration, and that pass corners of their paths at speed."""

from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import replace
from itertools import pairwise

import numpy as np
from hypothesis import strategies as st

from planning.cell.motion_limits import MotionLimits
from planning.cell.workcell import PlacedRobot
from planning.transforms import Array, Indices
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.corners.bends import NodesLeft, TransitRun, find_runs
from scheduling.graph.temporal_plan_graph import NodeChain, TemporalPlanGraph
from scheduling.motion_times import assign_node_times, stretch_numbers
from scheduling.pace import paces
from scheduling.shortcuts.candidates import TransitSpan
from scheduling.shortcuts.rewiring import rewire
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
    return assign_node_times(replace(tpg, cell=cell, chains=chains))


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
    for rows, start in _motions(chain, points):
        bend, end = int(rng.integers(0, len(rows))), points[rows[-1]]
        corner = points[rows[bend]] if bend else start
        _lay(points, rows[:bend], start, corner)
        _lay(points, rows[bend:], corner, end)
    return replace(chain, waypoints=points)


def _motions(chain: NodeChain, points: Array) -> Iterator[tuple[Indices, Array]]:
    """Yield the rows of each task's pose nodes, and where these begin as points lie by then."""
    for task in np.unique(chain.task):
        nodes = np.flatnonzero((chain.task == task) & ~chain.skill)
        if len(nodes):
            rows = chain.first[nodes]
            yield rows, chain.start if rows[0] == 0 else points[rows[0] - 1]


def _lay(points: Array, rows: Indices, start: Array, end: Array) -> None:
    """Lay rows on a straight way."""
    for k, row in enumerate(rows, start=1):
        points[row] = start + (end - start) * (k / len(rows))


def bent_tpg(
    seed: int,
    *,
    dofs: tuple[int, ...] = (2, 3),
    tasks: int = 4,
    nodes_per_transit: int = 16,
    edges: int = 8,
) -> TemporalPlanGraph:
    """Return a random graph whose transits have many corners, most of them rounded at random.

    Nothing is checked for collisions. Windows overlap where legs are short.
    """
    rng = np.random.default_rng(seed)
    tpg = random_tpg(
        seed, dofs=dofs, tasks=tasks, nodes_per_transit=nodes_per_transit, edges=edges
    )
    tpg = with_limits(tpg, rng, _with_legs)
    graph = DerivedTpg(tpg)
    for k, (chain, pace) in enumerate(zip(tpg.chains, paces(tpg), strict=True)):
        assert pace is not None
        spans = list(_spans(chain, k))
        for run in find_runs(chain, spans, stretch_numbers(tpg, k), pace):
            graph = _bent(graph, run, rng)
    return assign_node_times(graph.tpg)


BENT_TPGS = st.builds(
    bent_tpg,
    st.integers(0, 10**6),
    dofs=st.sampled_from([(2, 3), (1, 2, 3), (3,)]),
    tasks=st.integers(1, 8),
    nodes_per_transit=st.integers(6, 30),
    edges=st.integers(0, 20),
)


def _spans(chain: NodeChain, index: int) -> Iterator[TransitSpan]:
    """Yield the pose nodes of each task of a chain."""
    for task in np.unique(chain.task[~chain.skill]):
        nodes = np.flatnonzero((chain.task == task) & ~chain.skill)
        first = max(int(nodes[0]), 1)
        if first < nodes[-1]:
            yield TransitSpan(index, first, int(nodes[-1]))


def _bent(graph: DerivedTpg, run: TransitRun, rng: np.random.Generator) -> DerivedTpg:
    """Return a graph with some corners of a run rounded."""
    most = 10.0 ** rng.uniform(-2.5, 0.5, len(run.at))
    rests = np.flatnonzero(rng.random(len(run.at)) < 0.2)
    rests = np.unique([0, *rests, len(run.at) - 1])
    left = NodesLeft(run)
    for first, last in pairwise(rests.tolist()):
        if last - first < 2:
            continue
        windows = run.windows(first, last, most)
        if np.min(windows) <= 1e-4:
            continue
        path, curve = run.rounded(first, last, windows)
        assert curve is not None
        tried, before = graph, copy(left)
        for low, high in run.bends(path, curve):
            found = left.bent(tried.tpg.chains[run.chain], path, low, high)
            if found is None:
                # Corners that share a stretch are rounded together or not at all.
                tried, left = graph, before
                break
            tried = rewire(tried, found.swap, found.nodes, [])
        graph = tried
    return graph


def _with_legs(chain: NodeChain, rng: np.random.Generator) -> NodeChain:
    """Return a chain in which each task's pose nodes lie on several straight ways."""
    points = chain.waypoints.copy()
    for rows, at in _motions(chain, points):
        low = 0
        while low < len(rows):
            high = min(len(rows), low + int(rng.integers(1, 8)))
            end = at + rng.normal(size=len(at)) * 10.0 ** rng.uniform(-1.5, 0.3)
            _lay(points, rows[low:high], at, end)
            at, low = end, high
    return replace(chain, waypoints=points)

"""What settles pairs of motions without measuring them never settles one that comes too close."""

from dataclasses import replace
from itertools import product

import networkx as nx
import numpy as np
import pytest

from planning.transforms import Array, rotation
from scheduling.build_tpg import build_tpg
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.verification.verify import verify_plan
from scheduling.witness.measuring import Measuring
from scheduling.witness.motion import Motion
from scheduling.witness.parts import measure
from scheduling.witness.robot import WitnessRobot
from scheduling.witness.shapes import farthest, hull_of
from scheduling.witness.sweeps import DIRECTIONS, SweepBounds, close_pairs
from tests.scheduling.two_arms import random_turns, two_arms

CLEARANCE = 0.001


def points_of(shape: object, rng: np.random.Generator) -> Array:
    """Points on the surface of a shape, by coal's distance to far away points of a box."""
    import coal

    if isinstance(shape, coal.Box):
        corners: Array = np.array(list(product((-1.0, 1.0), repeat=3))) * shape.halfSide
        return corners
    if isinstance(shape, coal.Cylinder):
        angle = rng.uniform(0.0, 2.0 * np.pi, 200)
        rim = shape.radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return np.column_stack([rim, rng.choice([-1.0, 1.0], 200) * shape.halfLength])
    assert isinstance(shape, coal.ConvexBase)
    return np.asarray(shape.points())


def motions(seed: int) -> list[Motion]:
    """Every part of an arm in some random motions."""
    rng = np.random.default_rng(seed)
    placed = two_arms().robots[seed % 2]
    robot = WitnessRobot(placed)
    knots = placed.home + np.cumsum(rng.uniform(-0.15, 0.15, (7, robot.dof)), axis=0)
    frames = robot.joint_frames_along(knots)
    return [Motion(robot, p, knots, frames[:, p.joint + 1]) for p in robot.parts]


@pytest.mark.parametrize("seed", range(4))
def test_no_point_of_a_part_reaches_further_than_its_bound(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for motion in motions(seed):
        points = points_of(motion.part.shape, rng) @ motion.part.local[:3, :3].T
        points = points + motion.part.local[:3, 3]
        pieces = np.arange(len(motion))
        low, high = motion.extents(pieces)
        direction = rotation("y", 0.3)[:3, :3] @ DIRECTIONS[4]
        reach = motion.reach(pieces, direction)
        for piece, share in product(pieces, np.linspace(0.0, 1.0, 6)):
            q = motion.knots[piece] + share * (
                motion.knots[piece + 1] - motion.knots[piece]
            )
            assert motion.robot is not None
            frame = motion.robot.joint_frame(q, motion.part.joint)
            along = DIRECTIONS @ (points @ frame[:3, :3].T + frame[:3, 3]).T
            assert np.all(along.min(axis=1) >= low[:, piece] - 1e-9)
            assert np.all(along.max(axis=1) <= high[:, piece] + 1e-9)
            most = ((points @ frame[:3, :3].T + frame[:3, 3]) @ direction).max()
            assert most <= reach[piece] + 1e-9
        # And the bound is near: no more than the motion of a piece is added.
        assert np.all(high - low <= 2.0 * motion.part.radius + 0.5)


def test_shapes_reach_as_far_as_coal_says() -> None:
    import coal

    shapes = [
        coal.Box(0.1, 0.2, 0.3),
        coal.Sphere(0.1),
        coal.Capsule(0.1, 0.3),
        coal.Cylinder(0.1, 0.3),
        coal.Ellipsoid(0.1, 0.2, 0.3),
    ]
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(30, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    for shape in shapes:
        found = farthest(shape, directions)
        for direction, reach in zip(directions, found, strict=True):
            # A huge wall whose face looks at the shape, 2 m away.
            turn, _ = np.linalg.qr(
                np.column_stack([direction, rng.normal(size=(3, 2))])
            )
            wall = coal.Transform3s(turn, (2.0 + 50.0) * direction)
            gap = coal.distance(
                shape,
                coal.Transform3s(),
                coal.Box(100.0, 100.0, 100.0),
                wall,
                coal.DistanceRequest(),
                coal.DistanceResult(),
            )
            assert reach >= 2.0 - gap - 1e-6
            if not isinstance(shape, coal.Ellipsoid):
                assert reach == pytest.approx(2.0 - gap, abs=1e-5)


def test_a_hull_reaches_as_far_as_its_farthest_corner() -> None:
    rng = np.random.default_rng(1)
    corners = rng.normal(size=(40, 3))
    directions = rng.normal(size=(1500, 3))
    found = farthest(hull_of(corners), directions)
    assert found == pytest.approx((directions @ corners.T).max(axis=1), abs=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_close_pairs_are_those_of_a_double_loop(seed: int) -> None:
    rng = np.random.default_rng(seed)
    limits = rng.uniform(0.0, 0.01, (3, 2))
    both = []
    for pieces, bodies in ((rng.integers(1, 150), 3), (rng.integers(1, 150), 2)):
        way = np.cumsum(rng.normal(scale=0.05, size=(13, pieces, 1)), axis=1)
        middle = way + rng.normal(scale=0.1, size=(13, 1, bodies))
        half = rng.uniform(0.0, 0.1, (13, pieces, bodies))
        there = rng.random((pieces, bodies)) < 0.9
        sweeps = SweepBounds.nothing(int(pieces), bodies)
        sweeps.low[0][:, there] = (middle - half)[:, there]
        sweeps.high[0][:, there] = (middle + half)[:, there]
        both.append(sweeps)
    a, b = both
    n, m = a.low[0].shape[1], b.low[0].shape[1]
    low = np.sort(rng.integers(0, m + 1, n))
    high = np.maximum(low, np.sort(rng.integers(0, m + 1, n)))
    expected = set()
    for i, x, y in product(range(n), range(3), range(2)):
        for j in range(low[i], high[i]):
            gap = np.maximum(
                a.low[0][:, i, x] - b.high[0][:, j, y],
                b.low[0][:, j, y] - a.high[0][:, i, x],
            )
            if np.all(gap < limits[x, y]):
                expected.add((x, y, i, j))
    found: list[tuple[int, int, int, int]] = []
    for close in close_pairs(a.with_coarser(), b.with_coarser(), (low, high), limits):
        found += zip(
            *(v.tolist() for v in (close.x, close.y, close.i, close.j)), strict=True
        )
    assert len(found) == len(set(found))
    assert set(found) == expected


@pytest.mark.parametrize("seed", range(3))
def test_pairs_that_are_settled_keep_their_distance(seed: int) -> None:
    """Measured densely, no pair that one direction settled is nearer than the limit."""
    rng = np.random.default_rng(seed)
    robots = [WitnessRobot(placed) for placed in two_arms(gap=0.62).robots]
    both = []
    for k, robot in enumerate(robots):
        home = two_arms().robots[k].home + np.array([0.0, 0.75, 0.1, 0.0, 0.1, 0.0])
        knots = home + np.cumsum(rng.uniform(-0.1, 0.1, (6, 6)), axis=0)
        part = robot.parts[-4]
        frames = robot.joint_frames_along(knots)[:, part.joint + 1]
        both.append(Motion(robot, part, knots, frames))
    x, y = both
    rows, columns = np.indices((5, 5)).reshape(2, -1)
    least = np.full(25, np.inf)
    for k, (i, j) in enumerate(zip(rows, columns, strict=True)):
        for s, t in product(np.linspace(0.0, 1.0, 5), repeat=2):
            now = [
                m.robot.joint_frame(
                    m.knots[p] + u * (m.knots[p + 1] - m.knots[p]), m.part.joint
                )
                for m, p, u in ((x, i, s), (y, j, t))
                if m.robot is not None
            ]
            least[k] = min(least[k], measure(x.part, now[0], y.part, now[1]))
    for limit in np.quantile(least, [0.2, 0.5, 0.8]):
        near = Measuring().too_close(x, y, (rows, columns), limit, np.arange(25))
        found = {pair: gap for pair, gap, _ in near}
        assert set(np.flatnonzero(least < limit - 1e-6)) <= set(found)
        assert all(gap < limit for gap in found.values())


def too_close_in_samples(tpg: TemporalPlanGraph) -> set[tuple[int, int]]:
    """Pairs of nodes that nothing orders and that come too close in the middle of both."""
    order: nx.DiGraph[tuple[int, int]] = nx.DiGraph()
    for a, chain in enumerate(tpg.chains):
        nx.add_path(order, [(a, v) for v in range(len(chain))])
    order.add_edges_from(((a, u), (b, v)) for a, u, b, v in tpg.edges.tolist())
    free = np.ones([len(chain) for chain in tpg.chains], dtype=np.bool_)
    for u in range(len(tpg.chains[0])):
        free[u, [v for a, v in nx.descendants(order, (0, u)) if a == 1]] = False
        free[u, [v for a, v in nx.ancestors(order, (0, u)) if a == 1]] = False
    robots, frames = [], []
    for chain in tpg.chains:
        robots.append(WitnessRobot(tpg.cell.robot(chain.robot)))
        before = np.vstack([chain.start[None], chain.waypoints[:-1]])
        middle = 0.5 * (before + chain.waypoints)
        frames.append(robots[-1].joint_frames_along(middle))
    found = np.zeros_like(free)
    for x, y in product(robots[0].parts[::-1], robots[1].parts[::-1]):
        at = frames[0][:, x.joint + 1], frames[1][:, y.joint + 1]
        one, other = (
            f[:, :3, :3] @ p.centre + f[:, :3, 3]
            for f, p in zip(at, (x, y), strict=True)
        )
        apart = np.linalg.norm(one[:, None] - other, axis=2) - x.radius - y.radius
        for u, v in np.argwhere(free & ~found & (apart < CLEARANCE)):
            found[u, v] = measure(x, at[0][u], y, at[1][v]) < CLEARANCE - 1e-4
    return {(int(u), int(v)) for u, v in np.argwhere(found)}


@pytest.mark.parametrize(
    "seed", [0, *(pytest.param(s, marks=pytest.mark.nightly) for s in (1, 2))]
)
def test_whatever_edges_are_removed_what_samples_find_is_found(seed: int) -> None:
    tpg = build_tpg(random_turns(seed, 4, gap=0.64))
    assert np.all(np.diff(tpg.chains[0].first) == 1)
    rng = np.random.default_rng(seed)
    gone = rng.random(len(tpg.edges)) < 0.5
    gone[rng.integers(len(gone))] = True
    less = replace(tpg, edges=tpg.edges[~gone], cause=tpg.cause[~gone])
    expected = too_close_in_samples(less)
    assert expected
    report = verify_plan(less, limit=10**6)
    found = {
        (p.first.node, p.second.node)
        for p in report.problems
        if p.kind == "nodes" and p.first and p.second
    }
    assert expected <= found
    assert not too_close_in_samples(tpg)

"""What is proved apart is apart: against coal on random hulls and random motions."""

import itertools
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import coal
import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from planning.geometry.exact import TOLERANCE, hull_distance_at, may_come_close
from planning.geometry.gjk import BETWEEN, CLOSE, FAR, TOO_CLOSE, classify_gap
from planning.geometry.separation import (
    APART,
    CONFLICT,
    check_hulls_continuously,
    make_scratch,
    pose_segments,
)
from planning.transforms import Array
from scheduling.build_nodes import build_nodes
from scheduling.conflicts.conflict_search import search_conflicts
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.conflicts.occupancy import MOTION, Occupancy
from tests.kernels import outer
from tests.planning.geometry.swept_segments import sweep_segments
from tests.scheduling.mini_world import random_plan

_gap_class = outer(classify_gap)
_judge_hulls = outer(check_hulls_continuously)
_pose_segments = outer(pose_segments)


def _coal_distance(a: Array, b: Array) -> float:
    shapes = []
    for points in (a, b):
        model = coal.BVHModelOBBRSS()
        model.beginModel(0, len(points))
        model.addVertices(points)
        model.endModel()
        model.buildConvexHull(True, "Qt")
        shapes.append(model.convex)
    still = coal.Transform3s(np.eye(3), np.zeros(3))
    return float(
        coal.distance(
            shapes[0],
            still,
            shapes[1],
            still,
            coal.DistanceRequest(),
            coal.DistanceResult(),
        )
    )


def test_gaps_agree_with_coal() -> None:
    rng = np.random.default_rng(0)
    seen = {FAR: 0, BETWEEN: 0, CLOSE: 0, TOO_CLOSE: 0}
    for _ in range(400):
        a, b = (rng.normal(size=(int(rng.integers(4, 30)), 3)) for _ in range(2))
        a, b = a[ConvexHull(a).vertices], b[ConvexHull(b).vertices]
        b = np.ascontiguousarray(b + rng.normal(size=3) * rng.uniform(0, 4))
        gap = _coal_distance(a, b)
        clearance, enough = sorted(rng.uniform(0.0, 2.0, 2))
        answer = _gap_class(a, len(a), b, len(b), clearance, enough, np.zeros(3))
        seen[answer] += 1
        if answer == FAR:
            assert gap >= enough - 1e-7
        if gap >= enough + 1e-4:
            assert answer == FAR
        if gap < clearance - 1e-6:
            assert answer in (CLOSE, TOO_CLOSE)
        if answer == CLOSE:
            assert gap < clearance + 1e-3
        if answer == TOO_CLOSE:
            assert gap < clearance
        below = _gap_class(a, len(a), b, len(b), -0.1, enough, np.zeros(3))
        assert below != TOO_CLOSE
    assert min(seen[FAR], seen[BETWEEN], seen[TOO_CLOSE]) > 20
    assert seen[CLOSE] < 0.1 * seen[TOO_CLOSE]


def test_boxes_side_by_side_are_not_called_overlapping() -> None:
    """Faces opposite each other: four points of the difference may be in one plane."""
    rng = np.random.default_rng(2)
    answers = {FAR: 0, BETWEEN: 0, CLOSE: 0, TOO_CLOSE: 0}
    unit = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
    for _ in range(600):
        turn = Rotation.random(random_state=rng).as_matrix()
        sizes = rng.uniform(0.02, 0.2, (2, 3))
        gap = rng.uniform(-0.001, 0.01)
        apart = 0.5 * sizes.sum(axis=0) * rng.uniform(-0.9, 0.9, 3)
        apart[2] = 0.5 * sizes[:, 2].sum() + gap
        a, b = unit * sizes[0], unit * sizes[1] + apart
        a, b = np.ascontiguousarray(a @ turn.T), np.ascontiguousarray(b @ turn.T)
        clearance = rng.uniform(0.0, 0.008)
        enough = clearance + rng.uniform(0.0, 0.008)
        answer = _gap_class(a, 8, b, 8, clearance, enough, np.zeros(3))
        answers[answer] += 1
        if answer == TOO_CLOSE:
            assert gap < clearance
        if answer == FAR:
            assert gap >= enough - 1e-9
        if answer == BETWEEN:
            assert gap >= clearance - 1e-9
    assert min(answers[FAR], answers[BETWEEN], answers[TOO_CLOSE]) > 40
    assert answers[CLOSE] < 60


@pytest.fixture(scope="module")
def occupancies() -> list[Occupancy]:
    plan = random_plan(2, 10, step=0.5)
    return DerivedTpg(build_nodes(plan)).occupancies


def test_motions_proved_apart_are_apart(occupancies: list[Occupancy]) -> None:
    a, b = occupancies
    scratch = make_scratch(a.hulls, b.hulls)
    rng = np.random.default_rng(1)
    proved = refused = conflicts = 0
    for _ in range(1500):
        s = int(rng.integers(len(a.hulls.q_a)))
        t = int(rng.integers(len(b.hulls.q_a)))
        i, j = int(rng.integers(2)), int(rng.integers(2))
        solid_a, solid_b = a.solids[i], b.solids[j]
        gap = hull_distance_at(solid_a, a.hulls.q_a[s], solid_b, b.hulls.q_b[t])
        # Clearances near the gap are where it matters.
        clearance = max(gap, 0.0) + rng.uniform(-0.03, 0.01)
        _pose_segments(a.hulls, s, b.hulls, t, scratch)
        answer = _judge_hulls(a.hulls, i, b.hulls, j, clearance, scratch)
        apart = answer == APART
        if answer == CONFLICT:
            conflicts += 1
            x, y = scratch.where
            q_a = a.hulls.q_a[s] + x * (a.hulls.q_b[s] - a.hulls.q_a[s])
            q_b = b.hulls.q_a[t] + y * (b.hulls.q_b[t] - b.hulls.q_a[t])
            assert hull_distance_at(solid_a, q_a, solid_b, q_b) < clearance + TOLERANCE
        motions = (
            solid_a,
            a.hulls.q_a[s],
            a.hulls.q_b[s],
            solid_b,
            b.hulls.q_a[t],
            b.hulls.q_b[t],
        )
        if apart:
            proved += 1
            # coal may call close what is within its tolerance.
            assert not may_come_close(*motions, clearance - 2.1e-4)
            share = rng.random((8, 2))
            for x, y in share:
                q = motions[1] + x * (motions[2] - motions[1])
                p = motions[4] + y * (motions[5] - motions[4])
                assert hull_distance_at(solid_a, q, solid_b, p) >= clearance - 1e-6
        elif clearance > 0.0:
            refused += 1
            assert may_come_close(*motions, clearance + 1e-3)
    assert proved > 200
    assert refused > 200
    assert conflicts > 50


def test_segments_are_short_and_join(occupancies: list[Occupancy]) -> None:
    for occupancy in occupancies:
        hulls = occupancy.hulls
        assert np.array_equal(hulls.q_a[1:], hulls.q_b[:-1])
        node = occupancy.sequence.node
        assert np.all(np.diff(node) >= 0)
        grown = sweep_segments(hulls, hulls.q_a, hulls.q_b)[2]
        assert grown.min() >= 0.0
        assert 2.0 * grown.max() <= 1.05 * MOTION


def test_searches_that_take_turns_find_what_each_finds_alone() -> None:
    tpg = DerivedTpg(build_nodes(random_plan(2, 30, step=0.5)))
    a, b = tpg.occupancies

    def search(slack: float) -> Iterator[tuple[int, int]]:
        nodes = [int(own.sequence.node[-1]) + 1 for own in (a, b)]
        floor, limit = np.full(nodes[0], -1), np.full(nodes[0], nodes[1])
        return search_conflicts(a, b, floor, limit, tpg.table, slack)

    slacks = [0.01 * k for k in range(6)]
    alone = [list(search(slack)) for slack in slacks]
    assert len({len(found) for found in alone}) > 1
    turns = itertools.zip_longest(*map(search, slacks))
    assert [[p for p in own if p] for own in zip(*turns, strict=True)] == alone
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(lambda slack: list(search(slack)), slacks)) == alone

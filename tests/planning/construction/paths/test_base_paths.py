"""Ways to drive around what lies on the floor, against networkx on the same lattice."""

from __future__ import annotations

from itertools import pairwise, product

import networkx as nx
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from planning.cell.workcell import Fixture
from planning.construction.checks.checker import SpaceTimeChecker
from planning.construction.paths.base_paths import (
    SPACING,
    Lattice,
    base_path,
    lattice_way,
    lay_lattice,
    stand_at,
)
from planning.construction.paths.direct_paths import Query
from planning.construction.paths.rrt import query_to
from planning.construction.world.fixed_world import FixedWorld
from planning.packed import packed
from planning.transforms import Array
from tests.planning.construction.toy_tasks import PLAIN, find_path
from tests.planning.construction.toy_teams import fixture, placed, rover, team

PLENTY = 10_000
"""Steps enough for every lattice here."""

START = (-1.5, 0.0, 0.0, 0.3, -1.0)
HOME = (-1.5, 0.0, 0.0, 0.0, 0.0)


def checker_of(*fixtures: Fixture) -> SpaceTimeChecker:
    """A rover among blocks, nobody else."""
    cell = team([placed("me", rover(), HOME)], fixtures=fixtures)
    return SpaceTimeChecker(FixedWorld(cell), "me")


def query_of(checker: SpaceTimeChecker, goal: Array) -> Query:
    """From START to one goal, at any time."""
    query = query_to(checker, np.array([goal]), [np.array([[0.0, np.inf]])])
    return packed(query._replace(start=np.array(START)))


def clear_steps(
    checker: SpaceTimeChecker, query: Query, lattice: Lattice
) -> nx.DiGraph:
    """All steps that the rover may take: from the first place and to the last one any."""
    size = range(lattice.rows * lattice.columns)
    places = np.empty((len(size), len(query.start)))
    for at in size:
        stand_at(query, 0, lattice, at, places[at])
    free = [checker.configuration_free(q, 0.0) for q in places]
    free[lattice.first] = free[lattice.last] = True
    graph = nx.DiGraph()
    graph.add_nodes_from((lattice.first, lattice.last))
    for a, di, dk in product(size, (-1, 0, 1), (-1, 0, 1)):
        row, column = a // lattice.columns + di, a % lattice.columns + dk
        b = row * lattice.columns + column
        inside = 0 <= row < lattice.rows and 0 <= column < lattice.columns
        if a == b or not inside or not (free[a] and free[b]):
            continue
        if (
            a == lattice.first
            or b == lattice.last
            or checker.motion_free(places[a], 0.0, places[b], 1.0)
        ):
            graph.add_edge(a, b, weight=lattice.spacing * float(np.hypot(di, dk)))
    return graph


def blocks(places: list[tuple[float, float, float]]) -> tuple[Fixture, ...]:
    return tuple(
        fixture(f"block {k}", (0.5, 0.2, 0.2), (x, y, 0.1), turn)
        for k, (x, y, turn) in enumerate(places)
    )


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    st.lists(
        st.tuples(st.floats(-1.0, 1.6), st.floats(-1.5, 1.5), st.floats(0.0, 3.1)),
        max_size=14,
    ),
    st.floats(-1.0, 2.0),
    st.floats(-1.5, 1.5),
)
def test_no_way_over_the_lattice_is_shorter(
    places: list[tuple[float, float, float]], x: float, y: float
) -> None:
    checker = checker_of(*blocks(places))
    query = query_of(checker, np.array([x, y, 1.0, 0.5, 0.5]))
    lattice = lay_lattice(query, 0, 0.5)
    way, times = lattice_way(checker.scene, query, 0, lattice, PLENTY)
    graph = clear_steps(checker, query, lattice)
    ends = lattice.first, lattice.last
    if not nx.has_path(graph, *ends):
        assert len(way) == 0
        return
    shortest = nx.shortest_path_length(graph, *ends, weight="weight")
    assert (times[-1] - times[0]) * query.velocity[0] == pytest.approx(shortest)
    assert np.all(np.hypot(*np.diff(way[:-1, :2], axis=0).T) < 0.5 * 1.5)
    for k in range(1, len(way) - 2):
        assert checker.motion_free(way[k], times[k], way[k + 1], times[k + 1])


def test_ends_of_a_way_are_start_and_goal_with_the_arm_at_home() -> None:
    checker = checker_of()
    for goal in ([1.9, -0.8, 1.0, 1, 0], [-1.6, 0.1, -1.0, 0, 1], [4.0, 4.0, 0, 1, 0]):
        query = query_of(checker, np.array(goal, dtype=float))
        lattice = lay_lattice(query, 0, SPACING)
        last = np.array(divmod(lattice.last, lattice.columns)) * SPACING
        assert np.all(np.abs(lattice.origin + last - goal[:2]) <= SPACING)
        corners = base_path(checker.scene, query, 0, 800)
        assert np.array_equal(corners[0], [*START[:3], *HOME[3:]])
        if lattice.last != lattice.first:
            assert np.array_equal(corners[-1], [*goal[:3], *HOME[3:]])


def maze() -> tuple[Fixture, ...]:
    """Two walls across the room, one open above, one below."""
    return (
        fixture("low", (0.1, 6.0, 0.3), (-0.5, -2.0, 0.15)),
        fixture("high", (0.1, 6.0, 0.3), (0.6, 2.0, 0.15)),
    )


def test_corners_of_a_way_can_be_driven_straight() -> None:
    checker = checker_of(*maze())
    goal = np.array([1.6, 0.0, 0.0, 0.0, 1.0])
    query = query_of(checker, goal)
    lattice = lay_lattice(query, 0, SPACING)
    way, _ = lattice_way(checker.scene, query, 0, lattice, PLENTY)
    corners = base_path(checker.scene, query, 0, 800)
    assert 4 <= len(corners) < len(way) / 2
    assert np.array_equal(corners[0], way[0])
    assert np.array_equal(corners[-1], way[-1])
    t = 0.0
    for a, b in pairwise(corners):
        seconds = checker.least_duration(a, b)
        assert checker.motion_free(a, t, b, t + seconds)
        t += seconds


def test_too_much_to_look_at_and_no_way_at_all() -> None:
    checker = checker_of(*maze())
    query = query_of(checker, np.array([1.6, 0.0, 0.0, 0.0, 1.0]))
    lattice = lay_lattice(query, 0, SPACING)
    assert len(lattice_way(checker.scene, query, 0, lattice, 20)[0]) == 0
    shut = checker_of(*maze(), fixture("all", (0.1, 8.6, 0.3), (0.1, 0.0, 0.15)))
    assert len(base_path(shut.scene, query, 0, 800)) == 0


def test_a_maze_is_found_through_by_few_vertices() -> None:
    checker = checker_of(*maze())
    few = PLAIN._replace(
        iterations=0, patience=0, vertices=12, neighbours=6, checks=300
    )
    found = find_path(checker, np.array([1.6, 0.0, 0.0, 0.0, 1.0]), settings=few)
    assert found is not None
    for (a, b), (s, t) in zip(pairwise(found.path), pairwise(found.time), strict=True):
        assert checker.motion_free(a, s, b, t)

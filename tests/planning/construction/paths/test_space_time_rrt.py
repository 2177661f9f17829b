"""The space-time RRT against an exhaustive search on a grid, what its paths promise, and drives and queues against networkx and heapq."""

from __future__ import annotations

import heapq
from dataclasses import replace
from functools import cache
from itertools import pairwise, product

import networkx as nx
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from benchmarks.construction.fine_check.check import check_construction
from planning.cell.robot_model import RobotModel
from planning.cell.workcell import Fixture
from planning.construction.checks.checker import SpaceTimeChecker
from planning.construction.paths import motion_queue, rrt
from planning.construction.paths.base_paths import (
    SPACING,
    Lattice,
    base_path,
    lattice_path,
    lay_lattice,
    write_base_configuration,
)
from planning.construction.paths.motion_queue import MOST
from planning.construction.paths.query import Query, SpaceTimePath
from planning.construction.paths.rrt import make_query
from planning.construction.planner import plan_construction
from planning.construction.problem.models import tower
from planning.construction.problem.settings import PlannerSettings
from planning.construction.world.fixed_world import FixedWorld
from planning.construction.world.timeline import RobotTimeline
from planning.packed import packed
from planning.transforms import Array
from tests.kernels import outer
from tests.planning.construction.toy_sites import toy_problem
from tests.planning.construction.toy_tasks import PLAIN, find_path
from tests.planning.construction.toy_teams import (
    SPEED,
    fixture,
    placed,
    rover,
    slider,
    team,
)

SEARCH = PLAIN._replace(direct=0)
"""Without the straight lines that are tried first."""

THOROUGH = PLAIN._replace(rounds=3, vertices=200, neighbours=16, checks=4000)


@cache
def small(x: float = 1.5, y: float = 1.0) -> RobotModel:
    """A slider that stays in a room."""
    room = np.array([x, y])
    return replace(slider(), lower=-room, upper=room)


def check_path(checker: SpaceTimeChecker, found: SpaceTimePath, goals: Array) -> None:
    """All that a path promises."""
    assert np.array_equal(found.path[0], checker.start_configuration())
    assert np.array_equal(found.path[-1], np.atleast_2d(goals)[found.goal])
    assert found.time[0] == checker.start
    assert np.all(np.diff(found.time) > 0)
    assert found.earliest <= found.arrival + 1e-9
    for (a, b), (s, t) in zip(pairwise(found.path), pairwise(found.time), strict=True):
        assert np.all(np.abs(b - a) <= checker.model.velocity * (t - s) + 1e-6)
        assert checker.motion_free(a, s, b, t)


@cache
def door_world() -> FixedWorld:
    """A wall with a gap, and in the gap a door that is away from 8 s to 11 s."""
    walls = (
        fixture("upper", (0.1, 1.7, 0.4), (0.0, 1.15, 0.2)),
        fixture("lower", (0.1, 1.7, 0.4), (0.0, -1.15, 0.2)),
    )
    door = slider((0.1, 0.56, 0.3))
    cell = team(
        [placed("me", small(), (-1.0, 0.0)), placed("door", door, (0.0, 0.0))],
        fixtures=walls,
    )
    line = RobotTimeline(
        "door",
        np.array([0.0, 7.9, 8.0, 11.0, 11.1]),
        np.array([[0.0, 0], [0, 0], [0, 4], [0, 4], [0, 0]]),
    )
    return FixedWorld(cell, {"door": line})


@pytest.mark.parametrize("seed", range(4))
def test_a_door_that_is_open_for_a_while_is_used_at_once(seed: int) -> None:
    checker = SpaceTimeChecker(door_world(), "me")
    goal = np.array([1.0, 0.0])
    found = find_path(checker, goal, settings=SEARCH, seed=seed)
    assert found is not None
    check_path(checker, found, goal)
    # The front is at the door when it opens; 1.2 m are left.
    soonest = 7.9 + 1.2 / SPEED
    assert soonest <= found.arrival <= soonest + 0.3


def test_the_same_seed_gives_the_same_path() -> None:
    checker = SpaceTimeChecker(door_world(), "me")
    goal = np.array([1.0, 0.5])
    first, again, other = (
        find_path(checker, goal, settings=SEARCH, seed=s) for s in (3, 3, 4)
    )
    assert first is not None
    assert again is not None
    assert other is not None
    assert np.array_equal(first.path, again.path)
    assert np.array_equal(first.time, again.time)
    assert not np.array_equal(first.path, other.path)


def test_a_goal_that_is_closed_off_is_not_reached() -> None:
    world = door_world()
    shut = FixedWorld(world.cell)
    checker = SpaceTimeChecker(shut, "me")
    assert find_path(checker, np.array([1.0, 0.0])) is None
    inside_the_wall = np.array([0.0, 0.8])
    for how in (PLAIN, THOROUGH):
        assert find_path(checker, inside_the_wall, settings=how) is None
    assert find_path(SpaceTimeChecker(world, "me"), [[1, 0]], latest=9.0) is None  # type: ignore[arg-type]


def test_times_of_arrival_are_kept() -> None:
    checker = SpaceTimeChecker(door_world(), "me")
    goals = np.array([[1.0, 0.0], [-1.0, 0.5]])
    near = find_path(checker, goals)
    assert near is not None
    assert near.goal == 1
    assert near.arrival == pytest.approx(1.0)
    late = find_path(checker, goals, not_before=3.25)
    assert late is not None
    assert late.arrival == pytest.approx(3.25)
    fixed = find_path(checker, goals[:1], arrival=12.5)
    assert fixed is not None
    assert fixed.arrival == 12.5
    check_path(checker, fixed, goals[:1])
    assert find_path(checker, goals[:1], arrival=9.0) is None
    # In the doorway one may stand only while the door is away.
    doorway = np.array([0.0, 0.0])
    short = find_path(checker, doorway, stay=1.0)
    assert short is not None
    assert 8.3 < short.arrival <= 10.0
    assert find_path(checker, doorway, stay=np.inf) is None
    only = [np.array([[9.1, 9.3]])]
    there = find_path(checker, doorway, windows=only)
    assert there is not None
    assert 9.1 - 1e-9 <= there.arrival <= 9.3 + 1e-9


def grid_arrival(checker: SpaceTimeChecker, goal: Array, latest: float) -> float:
    """The earliest arrival on a grid of 0.2 m, one step to a neighbour or none in 0.4 s."""
    pitch, tick = 0.2, 0.2 / SPEED
    start = tuple(np.round(checker.start_configuration() / pitch).astype(int).tolist())
    target = tuple(np.round(goal / pitch).astype(int).tolist())
    front, t = {start}, 0.0
    room = np.round(checker.model.upper / pitch).astype(int)
    while front and t < latest:
        if target in front:
            return t
        after = set()
        for place, step in product(sorted(front), product((-1, 0, 1), repeat=2)):
            there = (place[0] + step[0], place[1] + step[1])
            if there in after or np.any(np.abs(there) > room):
                continue
            a, b = np.array(place) * pitch, np.array(there) * pitch
            if checker.motion_free(a, t, b, t + tick):
                after.add(there)
        front, t = after, t + tick
    return np.inf


def crowded_world(seed: int) -> FixedWorld:
    """Three robots wander through a small room with a pillar, and then stay where they are."""
    rng = np.random.default_rng(seed)
    robots = [placed("me", small(1.2, 1.2), (-1.0, -1.0))]
    lines = {}
    for k in range(3):
        path = rng.uniform(-0.9, 0.9, (4, 2))
        robots.append(placed(f"r{k}", slider((0.4, 0.4, 0.3)), tuple(path[0])))
        times = np.concatenate([[0.0], np.cumsum(rng.uniform(1.0, 4.0, 3))])
        lines[f"r{k}"] = RobotTimeline(f"r{k}", times, path)
    pillar = fixture("pillar", (0.3, 0.3, 0.4), (*rng.uniform(-0.4, 0.4, 2), 0.2))
    return FixedWorld(team(robots, fixtures=(pillar,)), lines)


def test_it_is_hardly_later_than_the_best_way_on_a_grid() -> None:
    goal = np.array([1.0, 1.0])
    later = []
    for seed in (0, 3, 8):
        checker = SpaceTimeChecker(crowded_world(seed), "me")
        best = grid_arrival(checker, goal, 10.0)
        assert 4.0 <= best < 10.0
        found = find_path(checker, goal, settings=THOROUGH, seed=seed)
        assert found is not None
        check_path(checker, found, goal)
        later.append(found.arrival - best)
    # The grid is no bound: a path off it may be earlier, by less than its pitch.
    assert np.mean(later) <= 0.6
    assert max(later) <= 1.5


def test_a_wait_is_put_where_it_costs_nothing() -> None:
    robots = [
        placed("me", small(), (-1.0, 0.0)),
        placed("other", slider(), (0.0, -1.0)),
    ]
    line = RobotTimeline(
        "other", np.array([0.0, 4.0]), np.array([[0.0, -1.0], [0.0, 1.0]])
    )
    world = FixedWorld(team(robots), {"other": line})
    checker = SpaceTimeChecker(world, "me")
    goal = np.array([1.0, 0.0])
    found = find_path(checker, goal, stay=np.inf, settings=SEARCH)
    assert found is not None
    check_path(checker, found, goal)
    # Straight across behind it, or a small way around: never as late as after it has gone.
    assert found.arrival <= 5.5


def test_who_lingers_leaves_as_late_as_it_can() -> None:
    checker = SpaceTimeChecker(door_world(), "me")
    goal = np.array([1.0, 0.0])
    for arrival in (None, 12.5):
        hurried = find_path(checker, goal, arrival=arrival)
        lingering = find_path(checker, goal, arrival=arrival, linger=True)
        assert hurried is not None
        assert lingering is not None
        check_path(checker, lingering, goal)
        assert lingering.arrival == hurried.arrival
        start = checker.start_configuration()
        stands = np.all(np.isclose(lingering.path, start), axis=1)
        leaves = float(lingering.time[stands][-1])
        least = checker.least_duration(start, goal)
        straight = [
            t
            for t in np.arange(0.0, lingering.arrival - least + 1e-9, 0.01)
            if checker.motion_free(start, t, goal, t + least)
        ]
        # Whoever waits on the way has to leave earlier than who goes straight through the door.
        assert leaves == pytest.approx(max(straight), abs=0.15)


def test_hints_lead_where_chance_does_not() -> None:
    walls = door_world().cell.fixtures
    cell = team([placed("me", small(), (-1.0, 0.7))], fixtures=walls)
    checker = SpaceTimeChecker(FixedWorld(cell), "me")
    goal = np.array([1.0, 0.7])
    few = PLAIN._replace(direct=0, iterations=0, patience=0, vertices=0)
    assert find_path(checker, goal, settings=few) is None
    hints = np.array([[-0.5, 0.0], [0.5, 0.0]])
    found = find_path(checker, goal, hints=hints, settings=few)
    assert found is not None
    check_path(checker, found, goal)


def test_the_rrt_alone_finds_all_paths_of_a_construction(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    effort = PlannerSettings()
    assert effort.finding("auto") is effort
    calls = dict.fromkeys(
        ("direct_paths", "search_roadmap", "base_path", "grow_forests"), 0
    )

    def counted(name: str) -> None:
        own = getattr(rrt, name)

        def call(*args: object) -> object:
            calls[name] += 1
            return own(*args)

        monkeypatch.setattr(rrt, name, call)

    for name in calls:
        counted(name)
    plan = plan_construction(toy_problem(tower(3), 2), effort.finding("rrt"))
    # To each part, to its place and away again.
    assert calls.pop("grow_forests") >= 3 * 3
    assert not any(calls.values())
    assert not check_construction(plan).faults


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
    query = make_query(checker, np.array([goal]), [np.array([[0.0, np.inf]])])
    return packed(query._replace(start=np.array(START)))


def clear_steps(
    checker: SpaceTimeChecker, query: Query, lattice: Lattice
) -> nx.DiGraph[int]:
    """All steps that the rover may take: from the first place and to the last one any."""
    size = range(lattice.rows * lattice.columns)
    places = np.empty((len(size), len(query.start)))
    for at in size:
        write_base_configuration(query, 0, lattice, at, places[at])
    free = [checker.configuration_free(q, 0.0) for q in places]
    free[lattice.first] = free[lattice.last] = True
    graph: nx.DiGraph[int] = nx.DiGraph()
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
    way, times = lattice_path(checker.scene, query, 0, lattice, PLENTY)
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
    way, _ = lattice_path(checker.scene, query, 0, lattice, PLENTY)
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
    assert len(lattice_path(checker.scene, query, 0, lattice, 20)[0]) == 0
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


no_motions = motion_queue.empty_motions
pop = outer(motion_queue.pop_motion)
push = outer(motion_queue.push_motion)


@settings(deadline=None)
@given(st.lists(st.one_of(st.none(), st.integers(0, 30)), max_size=80))
def test_the_least_key_comes_first(steps: list[int | None]) -> None:
    known: list[int] = []
    heap = no_motions()
    for number, key in enumerate(steps):
        if key is not None:
            push(heap, float(key), 0.5 * number, number, number + 1, number % 3)
            heapq.heappush(known, key)
        elif known:
            first = int(heap.edge[0, 0])
            assert heap.key[0] == heapq.heappop(known) == steps[first]
            assert heap.depart[0] == 0.5 * first
            assert heap.edge[0].tolist() == [first, first + 1, first % 3]
            pop(heap)
        assert heap.size[0] == len(known)


def test_what_does_not_fit_is_left_out() -> None:
    heap = no_motions()
    for number in range(MOST + 2):
        push(heap, float(-number), 0.0, number, 0, 0)
    assert heap.size[0] == MOST
    assert heap.edge[0, 0] == MOST - 1

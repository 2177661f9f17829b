"""What touches what, found from geometry, against rules anyone can check by hand."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations, permutations

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.construction.schedule import longest_chain
from planning.construction.problem.models import ModelPart, pavilion, tower, wall, well
from planning.construction.problem.site import ground_fixture, part_objects
from planning.construction.problem.supply_layout import Spiral
from planning.contacts.precedence import (
    PartGraph,
    build_part_graph,
    parts_stacked_on,
    with_insertions,
)
from planning.errors import ConstructionError
from planning.transforms import from_rpy, read_only_copy, translation


def graph_of(parts: tuple[ModelPart, ...], touch: float = 0.03) -> PartGraph:
    objects = {item.name: item for item in part_objects(parts, Spiral())}
    ground = ground_fixture()
    return build_part_graph(
        {part.name: (objects[part.name], part.goal) for part in parts},
        [(ground, ground.pose)],
        touch=touch,
    )


def block(name: str, x: float, y: float, z: float) -> ModelPart:
    """Return an upright block of 0.5 x 0.2 x 0.2 m."""
    size = read_only_copy((0.5, 0.2, 0.2))
    return ModelPart(name, size, 10.0, read_only_copy(translation(x, y, z)))


def test_a_tower_is_a_chain() -> None:
    graph = graph_of(tower(6))
    for k in range(1, 7):
        near = {f"beam{j}" for j in (k - 1, k + 1) if 1 <= j <= 6}
        assert graph.neighbours[f"beam{k}"] == near
        assert graph.carriers[f"beam{k}"] == ({f"beam{k - 1}"} if k > 1 else set())
    assert set(graph.ground) == {"beam1"}
    assert longest_chain(graph) == tuple(f"beam{k}" for k in range(1, 7))
    assert longest_chain(graph, carried=False) == longest_chain(graph)
    assert graph.placeable(["beam1", "beam2"]) == ("beam3",)


def test_a_brick_of_a_wall_rests_on_two_and_leans_on_none() -> None:
    graph = graph_of(wall(4, 3))
    assert graph.carriers["block2_2"] == {"block1_2", "block1_3"}
    around = ("block1_2", "block1_3", "block2_1", "block2_3", "block3_2", "block3_3")
    assert graph.neighbours["block2_2"] == set(around)
    assert set(graph.ground) == {f"block1_{k}" for k in range(1, 5)}
    assert graph.placeable([]) == tuple(f"block1_{k}" for k in range(1, 5))
    # One brick below is enough for the paper's rule, both are needed to rest on.
    assert "block2_2" in graph.placeable(["block1_2"], carried=False)
    assert "block2_2" not in graph.placeable(["block1_2"])
    assert graph.placed_neighbours("block2_2", ["block1_2", "block2_1"]) == 2
    assert len(longest_chain(graph)) == 3


def test_a_ring_closes() -> None:
    graph = graph_of(well(13, 2))
    for side in range(1, 14):
        ring = {f"stone1_{side % 13 + 1}", f"stone1_{(side - 2) % 13 + 1}"}
        assert ring <= graph.neighbours[f"stone1_{side}"]
        assert len(graph.carriers[f"stone2_{side}"]) == 2


def test_a_vault_rests_on_its_feet_and_holds_together() -> None:
    parts = pavilion((5, 6, 5))
    graph = graph_of(parts)
    feet = {part.name for part in parts if part.goal[2, 3] < 0.4}
    assert set(graph.ground) == feet
    assert len(feet) == 6
    assert graph.floating() == ()
    for first, second in combinations(range(1, 6), 2):
        touching = f"cassette1_{second}" in graph.neighbours[f"cassette1_{first}"]
        assert touching == (second == first + 1)
    assert graph.carriers["cassette1_2"] == {"cassette1_1"}
    assert graph.carriers["cassette1_4"] == {"cassette1_5"}


@given(
    st.lists(
        st.tuples(st.integers(-3, 3), st.integers(-1, 1), st.integers(0, 2)),
        min_size=2,
        max_size=7,
        unique=True,
    )
)
@settings(max_examples=60, deadline=None)
def test_contacts_of_a_grid_are_those_of_its_cells(
    cells: list[tuple[int, int, int]],
) -> None:
    # Half a block apart along x they overlap; a whole block along any axis they touch.
    parts = tuple(
        block(f"p{k}", 0.25 * x, 0.21 * y, 0.1 + 0.2 * z)
        for k, (x, y, z) in enumerate(cells)
    )
    apart = [np.abs(np.subtract(a, b)) for a, b in combinations(cells, 2)]
    if any(d[0] < 2 and d[1] == 0 and d[2] == 0 for d in apart):
        with pytest.raises(ConstructionError, match=r"p\d and p\d would overlap"):
            graph_of(parts)
        return
    graph = graph_of(parts)
    for i, j in permutations(range(len(cells)), 2):
        x, y, z = np.subtract(cells[i], cells[j])
        near = abs(x) <= 2 and abs(y) <= 1 and abs(z) <= 1
        assert (f"p{j}" in graph.neighbours[f"p{i}"]) == near
        if near and abs(x) < 2 and y == 0:
            assert (f"p{j}" in graph.carriers[f"p{i}"]) == (z == 1)
    assert set(graph.ground) == {f"p{k}" for k, cell in enumerate(cells) if not cell[2]}


def test_overlapping_goals_are_named() -> None:
    parts = (block("left", 0.0, 0.0, 0.1), block("right", 0.46, 0.0, 0.1))
    with pytest.raises(
        ConstructionError, match="left and right would overlap by 40 mm"
    ):
        graph_of(parts)
    sunk = (block("deep", 0.0, 0.0, 0.05),)
    with pytest.raises(
        ConstructionError, match="deep and ground would overlap by 50 mm"
    ):
        graph_of(sunk)


def test_what_nothing_connects_to_the_ground_floats() -> None:
    parts = (
        block("low", 0.0, 0.0, 0.1),
        block("high", 0.0, 0.0, 0.5),
        block("higher", 0.0, 0.0, 0.7),
    )
    graph = graph_of(parts)
    assert graph.floating() == ("high", "higher")
    assert graph_of(parts, touch=0.25).floating() == ()


def test_a_leaning_block_rests_on_what_is_below_it() -> None:
    leaning = ModelPart(
        "leaning",
        read_only_copy((0.5, 0.2, 0.2)),
        10.0,
        read_only_copy(from_rpy((0.0, 0.0, 0.42), (0.0, np.radians(20.0), 0.0))),
    )
    graph = graph_of((block("low", 0.0, 0.0, 0.1), leaning), touch=0.05)
    assert graph.carriers["leaning"] == {"low"}
    assert graph.carriers["low"] == frozenset()


@pytest.mark.parametrize("model", [tower, wall, well, pavilion])
def test_models_can_be_built_in_any_order_that_the_graph_allows(
    model: Callable[[], tuple[ModelPart, ...]],
) -> None:
    parts = model()
    graph = graph_of(parts)
    rng = np.random.default_rng(5)
    where = {part.name: part.goal[2, 3] for part in parts}
    for _ in range(4):
        placed: list[str] = []
        while possible := graph.placeable(placed):
            part = possible[int(rng.integers(len(possible)))]
            # It stands on the ground, or is joined to something that does, and what it rests
            # on is there and reaches below its middle.
            assert part in graph.ground or graph.placed_neighbours(part, placed)
            assert all(below in placed for below in graph.carriers[part])
            assert all(where[below] < where[part] for below in graph.carriers[part])
            placed.append(part)
        assert sorted(placed) == sorted(where)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000))
def test_piled_on_is_the_longest_path_up(seed: int) -> None:
    rng = np.random.default_rng(seed)
    names = [f"p{k}" for k in range(8)]
    carriers = {
        a: frozenset(b for b in names if b < a and rng.random() < 0.3) for a in names
    }
    graph = PartGraph({a: frozenset() for a in names}, {}, carriers)
    rests = nx.DiGraph((b, a) for a in names for b in carriers[a])
    rests.add_nodes_from(names)
    for part in names:
        above = rests.subgraph({part} | nx.descendants(rests, part))
        assert graph.piled_on[part] == nx.dag_longest_path_length(above)


@given(st.integers(0, 100_000), st.booleans())
@settings(max_examples=100, deadline=None)
def test_never_placeable_is_what_is_left_however_one_goes_on(
    seed: int, carried: bool
) -> None:
    rng = np.random.default_rng(seed)
    names = [f"p{k}" for k in range(rng.integers(1, 9))]
    pairs = [p for p in combinations(names, 2) if rng.random() < 0.4]
    near = {
        n: frozenset(b if a == n else a for a, b in pairs if n in (a, b)) for n in names
    }
    below = {
        n: frozenset(o for o in sorted(near[n]) if rng.random() < 0.3) for n in names
    }
    ground = {n: frozenset({"floor"}) for n in names if rng.random() < 0.4}
    graph = PartGraph(near, ground, below)
    placed: set[str] = set()
    while ready := graph.placeable(placed, carried=carried):
        placed.add(ready[int(rng.integers(len(ready)))])
    left = graph.never_placeable(carried=carried)
    assert set(left) == set(names) - placed


@given(st.integers(1, 12), st.integers(1, 5), st.integers(0, 1000), st.booleans())
@settings(max_examples=60, deadline=None)
def test_stacks_lie_one_part_on_the_next_the_first_on_top(
    count: int, high: int, seed: int, near: bool
) -> None:
    rng = np.random.default_rng(seed)
    parts = tuple(
        ModelPart(
            f"p{k}",
            read_only_copy(rng.uniform(0.1, 0.3, 3)),
            1.0,
            read_only_copy(
                translation(rng.uniform(-2.0, 2.0), rng.uniform(-2.0, 2.0), 0.1)
            ),
            faces=(str(rng.choice(["+x", "-y", "+z"])),),
        )
        for k in range(count)
    )
    objects = part_objects(parts, Spiral(turn=0.5, high=high), near=near)
    starts = {item.name: (item, item.start) for item in objects}
    found = parts_stacked_on(starts)
    for k in range(count):
        below = k + 1 if (k + 1) % high and k + 1 < count else None
        above = k - 1 if k % high else None
        assert found.get(f"p{k}", frozenset()) == (
            {f"p{above}"} if above is not None else set()
        )
        item, pose = starts[f"p{k}"]
        up = np.abs(pose[2, :3]) @ item.size
        bottom = pose[2, 3] - 0.5 * up
        if below is None:
            assert bottom == pytest.approx(0.0, abs=1e-12)
        else:
            under, at = starts[f"p{below}"]
            top = at[2, 3] + 0.5 * np.abs(at[2, :3]) @ under.size
            assert bottom == pytest.approx(top, abs=1e-12)


def test_a_part_waits_for_those_whose_way_in_leads_through_it() -> None:
    sides = {
        "left": (1.0, 0.0, 0.0),
        "right": (0.0, 0.0, -1.0),
        "far": (0.0, 0.0, -1.0),
    }
    parts = tuple(
        ModelPart(
            name,
            read_only_copy((0.3, 0.3, 0.1)),
            1.0,
            read_only_copy(translation(x, 0, 0.05)),
        )
        for name, x in (("left", 0.0), ("right", -0.3), ("far", 0.3))
    )
    objects = {item.name: item for item in part_objects(parts, Spiral())}
    items = {part.name: (objects[part.name], part.goal) for part in parts}
    graph = graph_of(parts)
    assert set(graph.carriers.values()) == {frozenset()}
    ways = {name: read_only_copy(way) for name, way in sides.items()}
    # The left one comes from where the right one will be.
    found = with_insertions(graph, items, ways, 0.1)
    assert found.carriers == {"left": set(), "right": {"left"}, "far": set()}
    assert found.never_placeable() == ()
    # Two that come through each other wait for each other.
    both = with_insertions(
        graph, items, {**ways, "right": read_only_copy((-1.0, 0.0, 0.0))}, 0.1
    )
    assert both.carriers["left"] == {"right"}
    assert set(both.never_placeable()) == {"left", "right"}

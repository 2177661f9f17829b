"""Plans one after another: the spliced graph is the one that is built of all nodes."""

from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.errors import PlanInvariantError
from planning.motion.motion_plan import MotionPlan, TaskMotion
from planning.tasks.task import Task, TaskKind
from planning.transforms import translation
from scheduling.build_nodes import build_nodes
from scheduling.build_tpg import build_tpg, connect_nodes
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.plan_files import load_plan, save_plan
from scheduling.graph.rollout import earliest_times
from scheduling.graph.temporal_plan_graph import (
    TemporalPlanGraph,
)
from scheduling.invariant import check_invariant
from scheduling.sequences.copies import copies_in_sequence
from scheduling.sequences.sequence import PlanSequence, SequencedPlan, SequenceNodes
from scheduling.sequences.splice import splice_plans
from tests.scheduling.line_world import line_plan, mixed_line
from tests.scheduling.mini_world import planar_cell, random_plan


def _leaves(tpg: TemporalPlanGraph) -> list[float]:
    """Return when each product has left [s]."""
    (chain,) = (
        k
        for k, c in enumerate(tpg.chains)
        if tpg.tasks[c.task[0]].kind == TaskKind.LEAVE
    )
    ends: list[float] = earliest_times(tpg).end[chain].tolist()
    return ends


@pytest.mark.parametrize("products", [1, 2, 4, 5, 9])
@pytest.mark.parametrize(
    ("every_s", "buffer"), [(0.0, None), (3.0, None), (3.0, 1), (3.0, 3)]
)
def test_shifted_copies_are_the_graph_of_all(
    products: int, every_s: float, buffer: int | None
) -> None:
    plan, pattern = line_plan(
        every_s=every_s, leave_s=0.5, products=products, buffer=buffer
    )
    quick = splice_plans(copies_in_sequence(build_tpg(plan), pattern))
    nodes = SequenceNodes(copies_in_sequence(build_nodes(plan), pattern)).graph()
    slow = connect_nodes(DerivedTpg(nodes))
    assert np.array_equal(quick.edges, slow.edges)
    assert np.array_equal(quick.cause, slow.cause)
    assert [task.index for task in quick.tasks] == list(range(len(quick.tasks)))
    assert quick.products.max() == products
    check_invariant(DerivedTpg(quick))


def test_a_conveyor_slower_than_the_robots_sets_the_pace() -> None:
    plan, pattern = line_plan(every_s=50.0, products=12)
    ends = _leaves(splice_plans(copies_in_sequence(build_tpg(plan), pattern)))
    assert np.allclose(np.diff(ends)[2:], 50.0)


def test_a_product_does_not_wait_for_the_whole_one_before() -> None:
    plan, pattern = line_plan(leave_s=0.5, products=10)
    alone = build_tpg(plan)
    takt = np.diff(_leaves(splice_plans(copies_in_sequence(alone, pattern))))
    assert np.allclose(takt[2:], takt[-1])
    in_turns = sum(float(chain.duration.sum()) for chain in alone.chains)
    assert takt[-1] < in_turns - 0.1


@pytest.mark.parametrize("every_s", [0.0, 2.0, 7.5])
def test_the_takt_is_the_greatest_cycle_mean(every_s: float) -> None:
    """Of all ways from a node to the same node of later products: time over products."""
    plan, pattern = line_plan(every_s=every_s, leave_s=1.25, products=40)
    tpg = splice_plans(copies_in_sequence(build_tpg(plan), pattern))
    ends = _leaves(tpg)
    lengths = [len(c) // 40 if k < 2 else 1 for k, c in enumerate(tpg.chains)]
    graph: nx.MultiDiGraph[tuple[int, int]] = nx.MultiDiGraph()
    for k, chain in enumerate(tpg.chains):
        for node in range(lengths[k]):
            after = (node + 1) % lengths[k]
            lag = int(node + 1 == lengths[k])
            graph.add_edge(
                (k, node), (k, after), time=chain.duration[node], products=lag
            )
    for r, u, s, v in tpg.edges.tolist():
        if v // lengths[s] != 20:
            continue
        lag = 20 - u // lengths[r]
        source = r, u % lengths[r]
        time = tpg.chains[r].duration[u]
        graph.add_edge(source, (s, v % lengths[s]), time=time, products=lag)
    best = 0.0
    simple: nx.DiGraph[tuple[int, int]] = nx.DiGraph(graph)
    for cycle in nx.simple_cycles(simple):
        time = products = 0.0
        for u, v in zip(cycle, [*cycle[1:], cycle[0]], strict=True):
            edge = max(graph[u][v].values(), key=lambda e: (-e["products"], e["time"]))
            time, products = time + edge["time"], products + edge["products"]
        best = max(best, time / products)
    assert np.diff(ends)[-1] == pytest.approx(best)


def _returning(plan: MotionPlan) -> MotionPlan | None:
    """Return a random plan whose robots go home at the end, None where one would not."""
    tasks, motions = list(plan.tasks), list(plan.motions)
    for robot in plan.cell.robots:
        own = [m for t, m in zip(tasks, motions, strict=True) if t.robot == robot.name]
        if own and np.any(own[-1].path[-1] != own[0].path[0]):
            end = motions[-1].time[-1]
            path = np.stack([own[-1].path[-1], own[0].path[0]])
            kind = len(tasks), robot.name, "transit", 1, "home", path[1:]
            tasks.append(Task(*kind))
            motions.append(TaskMotion(path, end + np.array([0.0, 1.0])))
    whole = replace(plan, tasks=tuple(tasks), motions=tuple(motions))
    try:
        build_tpg(whole)
    except PlanInvariantError:
        return None
    return whole


def _require_graph_of_all(sequence: PlanSequence) -> None:
    """Require that the spliced graph is the one that is built of all nodes."""
    quick = splice_plans(sequence)
    slow = connect_nodes(DerivedTpg(SequenceNodes(sequence).graph()))
    assert np.array_equal(quick.edges, slow.edges)
    assert np.array_equal(quick.cause, slow.cause)
    check_invariant(DerivedTpg(quick))


@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    robots=st.integers(2, 3),
    order=st.lists(st.integers(0, 1), max_size=4),
)
def test_random_plans_one_after_another(
    seed: int, robots: int, order: list[int]
) -> None:
    cell = planar_cell(robots, np.random.default_rng(seed))
    drawn = (
        random_plan(robots, own, rounds=5, objects=0, cell=cell)
        for own in (seed, seed + 1)
    )
    plans = [build_tpg(plan) for plan in map(_returning, drawn) if plan is not None]
    plans = [plan for plan in plans if plan.chains]
    if len(plans) == 2:
        products = [np.full(len(plan.tasks), 1) for plan in plans]
        segments = tuple(SequencedPlan(k, {}, products[k]) for k in (*order, 0, 1))
        none = np.empty((0, 4), dtype=np.int64)
        _require_graph_of_all(PlanSequence(tuple(plans), segments, none))


@settings(max_examples=12, deadline=None)
@given(
    variants=st.lists(st.booleans(), min_size=2, max_size=6),
    slots=st.integers(1, 2),
)
def test_a_mix_is_the_graph_of_all(variants: list[bool], slots: int) -> None:
    _require_graph_of_all(mixed_line(variants, slots))


def test_a_plan_that_does_not_begin_where_the_one_before_ends_is_refused() -> None:
    sequence = mixed_line([True, True], slots=2)
    again = replace(
        sequence.segments[1], plan=0, names={"box.1": "box.2", "box.2": "x"}
    )
    with pytest.raises(PlanInvariantError, match=r"plan 2 (lacks|begins with) 'box"):
        SequenceNodes(
            PlanSequence(
                sequence.plans[:1], (sequence.segments[0], again), sequence.waits
            )
        ).graph()


def test_what_only_other_plans_handle_is_in_nobody_s_way() -> None:
    """A box of the tray that the first plan leaves there, in the way of its arm."""
    sequence = mixed_line([True, True], slots=2)
    first, second = sequence.plans
    own, other = first.cell.objects
    pose = own.start @ translation(0.0, 0.03, 0.0)
    moved = [
        replace(
            plan,
            cell=replace(
                plan.cell,
                objects=tuple(
                    replace(x, start=pose) if x.name == other.name else x
                    for x in plan.cell.objects
                ),
            ),
        )
        for plan in (first, second)
    ]
    with pytest.raises(PlanInvariantError, match=r"runs into 'box.2' at rest"):
        splice_plans(replace(sequence, plans=tuple(moved)))


def test_what_does_not_return_is_refused() -> None:
    plan, pattern = line_plan(products=3)
    tpg = build_tpg(plan)
    chains = (tpg.chains[0].cut(0, len(tpg.chains[0]) - 1), *tpg.chains[1:])
    with pytest.raises(PlanInvariantError, match="away from where it begins"):
        SequenceNodes(copies_in_sequence(replace(tpg, chains=chains), pattern))


def test_a_repeated_plan_comes_back_from_its_files(tmp_path) -> None:  # type: ignore[no-untyped-def]
    plan, pattern = line_plan(every_s=3.0, products=7)
    tpg = splice_plans(copies_in_sequence(build_tpg(plan), pattern))
    save_plan(tpg, tmp_path)
    models = {robot.model.name: robot.model for robot in tpg.cell.robots}
    loaded = load_plan(tmp_path, models)
    assert np.array_equal(loaded.products, tpg.products)
    assert [m.name for m in loaded.cell.machines] == ["belt", "stop", "outfeed"]
    assert np.array_equal(loaded.edges, tpg.edges)
    check_invariant(DerivedTpg(loaded))

"""A better order of tasks: against every order there is, the rebuilt graph and the slow proof; and plans in slots as in the paper."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.errors import PlanInvariantError
from planning.geometry.exact import TOLERANCE
from planning.motion.motion_plan import MotionPlan
from planning.motion.sequential import MotionSettings
from planning.motion.speed import L1Speed
from planning.tasks.task import TaskKind, TimeWindow
from scheduling.build_tpg import build_tpg, connect_nodes
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.barriers import with_barriers
from scheduling.graph.rollout import earliest_times
from scheduling.graph.temporal_plan_graph import NodeChain, TemporalPlanGraph
from scheduling.graph.windows import plan_cost
from scheduling.ordering.beam_search import TaskOrderSearch
from scheduling.ordering.known_edges import connect_in_order
from scheduling.ordering.relations import TaskRelations
from scheduling.ordering.reordering import (
    find_blocks,
    put_in_order,
    reorder_tasks,
    straight_durations,
)
from scheduling.shortcuts.candidates import find_spans
from scheduling.synchronous import synchronous_plan as synchronous
from scheduling.synchronous.synchronous_plan import (
    SynchronousPlan,
    TaskConflicts,
    plan_synchronous,
)
from scheduling.verification.verify import verify_plan
from tests.scheduling.algorithm_one import PlainGraph, check_conflicts_are_ordered
from tests.scheduling.mini_world import random_plan
from tests.scheduling.random_dispatch import run_at_random
from tests.scheduling.two_arms import random_turns
from tests.shipped_runs import ShippedRuns
from twin.verification.standing_states import audit_standing_states


def _parts(
    tpg: TemporalPlanGraph,
) -> tuple[TaskRelations, list[tuple[int, ...]], TaskOrderSearch]:
    relations = TaskRelations(DerivedTpg(tpg))
    blocks = find_blocks(tpg.chains, relations)
    return relations, blocks, TaskOrderSearch(relations, blocks)


def _connected(
    tpg: TemporalPlanGraph, chains: tuple[NodeChain, ...]
) -> TemporalPlanGraph:
    return connect_nodes(DerivedTpg(replace(tpg, chains=chains)))


def _interleavings(own: Sequence[Sequence[int]]) -> Iterator[list[int]]:
    """Yield every way to mix sequences without changing the order within one."""
    if not any(own):
        yield []
    for k, sequence in enumerate(own):
        if sequence:
            rest = [s[1:] if i == k else s for i, s in enumerate(own)]
            for tail in _interleavings(rest):
                yield [sequence[0], *tail]


def _makespan(
    tpg: TemporalPlanGraph, relations: TaskRelations, order: Sequence[tuple[int, ...]]
) -> float | None:
    """Return the makespan of the graph built for an order, None where that is not safe."""
    done: set[int] = set()
    for block in order:
        if any(not relations.before[unit] <= done for unit in block):
            return None
        done.update(block)
    chains = put_in_order(tpg.chains, relations, order)
    try:
        return float(earliest_times(_connected(tpg, chains)).makespan)
    except PlanInvariantError:
        return None


@pytest.mark.parametrize(
    ("robots", "seed"),
    [(3, 13), *(pytest.param(2, s, marks=pytest.mark.nightly) for s in (17, 43))],
)
def test_no_safe_order_is_better(robots: int, seed: int) -> None:
    tpg = build_tpg(random_plan(robots, seed, rounds=4, step=0.5))
    relations, blocks, search = _parts(tpg)
    found = [blocks[b] for b in search.best_path(width=50).order()]
    every = [
        _makespan(tpg, relations, [(unit,) for unit in order])
        for order in _interleavings(relations.of_chain)
    ]
    safe = [makespan for makespan in every if makespan is not None]
    assert _makespan(tpg, relations, found) == pytest.approx(min(safe))
    assert min(safe) < 0.97 * earliest_times(tpg).makespan


@pytest.mark.parametrize(("seed", "ago"), [(10, None), (43, None), (43, 0.1)])
def test_windows_of_time_come_before_the_makespan(seed: int, ago: float | None) -> None:
    """Those that were open before the plan begins, so long ago, as well."""
    plain = build_tpg(random_plan(2, seed, rounds=3, step=0.5))
    units = TaskRelations(DerivedTpg(plain)).units
    better = 0
    pairs = [
        (a.task, b.task)
        for a, b in combinations(sorted(units, key=lambda u: u.task), 2)
        if a.chain != b.chain
    ]
    for done, due in pairs[1::2]:
        needs = np.array([[done, due]], dtype=np.int64)
        free = _connected(replace(plain, dependencies=needs), plain.chains)
        window = TimeWindow(done, done, due, 0.0, 0.2, "")
        if ago is not None:
            window = replace(
                window, begun=TimeWindow.EARLIER, done=TimeWindow.EARLIER, ago=ago
            )
        tpg = replace(free, windows=(window,))
        relations, blocks, search = _parts(tpg)
        order = [blocks[b] for b in search.best_path(width=50).order()]
        found = _connected(tpg, put_in_order(tpg.chains, relations, order))
        every = []
        for mixed in _interleavings(relations.of_chain):
            single = [(unit,) for unit in mixed]
            if _makespan(tpg, relations, single) is not None:
                chains = put_in_order(tpg.chains, relations, single)
                every.append(plan_cost(_connected(tpg, chains)))
        assert plan_cost(found)[0] <= min(every)[0] + 1e-6
        again = reorder_tasks(free)
        better += (
            plan_cost(found)[0]
            < plan_cost(replace(again, windows=tpg.windows))[0] - 1e-6
        )
        assert plan_cost(reorder_tasks(tpg)) <= plan_cost(tpg)
    assert better


@pytest.mark.parametrize("seed", range(6))
def test_the_search_knows_when_everyone_will_be_done(seed: int) -> None:
    tpg = build_tpg(random_plan(2 + seed % 3, seed, rounds=8, step=0.5))
    relations, blocks, search = _parts(tpg)
    best = search.best_path(width=10)
    chains = put_in_order(tpg.chains, relations, [blocks[b] for b in best.order()])
    rollout = earliest_times(_connected(tpg, chains))
    assert best.clocks == pytest.approx([end[-1] for end in rollout.end])


@pytest.mark.parametrize("seed", range(4))
def test_an_order_for_straight_transits_is_the_best_there_is(seed: int) -> None:
    tpg = build_tpg(random_plan(2, 13 + seed, rounds=4, step=0.3))
    relations, blocks, _ = _parts(tpg)
    speeds = {robot.name: L1Speed() for robot in tpg.cell.robots}
    durations = straight_durations(relations.graph, speeds)
    for span in find_spans(relations.graph):
        nodes, own = tpg.chains[span.chain], durations[span.chain]
        start = nodes.waypoints[nodes.first[span.first] - 1]
        end = nodes.waypoints[nodes.first[span.last + 1] - 1]
        lasts = own[span.first : span.last + 1].sum()
        assert lasts == pytest.approx(np.abs(end - start).sum())
        assert lasts <= nodes.duration[span.first : span.last + 1].sum() + 1e-9

    def straight(order: Sequence[tuple[int, ...]]) -> float | None:
        if _makespan(tpg, relations, order) is None:
            return None
        graph = _connected(tpg, put_in_order(tpg.chains, relations, order))
        chains = zip(graph.chains, durations, strict=True)
        quick = tuple(replace(chain, duration=own) for chain, own in chains)
        return float(earliest_times(replace(graph, chains=quick)).makespan)

    best = TaskOrderSearch(relations, blocks, durations).best_path(width=50)
    found = straight([blocks[b] for b in best.order()])
    assert max(best.clocks) == pytest.approx(found)
    every = [
        straight([(unit,) for unit in order])
        for order in _interleavings(relations.of_chain)
    ]
    assert found == pytest.approx(min(each for each in every if each is not None))
    again = reorder_tasks(tpg, speeds)
    quick = tuple(
        replace(chain, duration=own)
        for chain, own in zip(again.chains, durations, strict=True)
    )
    assert earliest_times(replace(again, chains=quick)).makespan == pytest.approx(found)


def test_orders_get_better_at_all() -> None:
    plans = [random_turns(seed, 6, gap=0.62) for seed in range(4)]
    before = [earliest_times(build_tpg(plan)).makespan for plan in plans]
    after = [earliest_times(reorder_tasks(build_tpg(plan))).makespan for plan in plans]
    assert all(b <= a for a, b in zip(before, after, strict=True))
    assert sum(after) < 0.98 * sum(before)


@given(st.integers(2, 5), st.integers(0, 10_000))
@settings(max_examples=10, deadline=None)
def test_conflicting_nodes_stay_ordered_and_paths_stay_as_they_are(
    robots: int, seed: int
) -> None:
    before = build_tpg(random_plan(robots, seed, rounds=7, step=0.5))
    tpg = reorder_tasks(before)
    assert earliest_times(tpg).makespan <= earliest_times(before).makespan
    for old, new in zip(before.chains, tpg.chains, strict=True):
        assert np.array_equal(old.waypoints, new.waypoints)
        assert np.array_equal(old.duration, new.duration)
    check_conflicts_are_ordered(tpg)


@pytest.mark.parametrize("seed", [3])
def test_a_plan_in_another_order_is_proved_safe(seed: int) -> None:
    before = build_tpg(random_turns(seed, 6, gap=0.62))
    tpg = reorder_tasks(before)
    assert not np.array_equal(tpg.edges, before.edges)
    assert verify_plan(tpg).problems == ()
    assert audit_standing_states(tpg).violations == ()


def test_tasks_that_take_turns_node_by_node_stay_together() -> None:
    tpg = build_tpg(random_turns(2, 6, gap=0.62))
    relations, blocks, _ = _parts(tpg)
    assert all(len(block) == 1 for block in blocks)
    units = relations.units
    a, b = next(
        (a, b)
        for a in range(len(units))
        for b in range(len(units))
        if units[a].chain != units[b].chain and relations.stairs(a, b) is not None
    )
    # Let both start at once: neither could be complete before the other starts.
    chains = list(tpg.chains)
    for unit in (a, b):
        u = units[unit]
        start = chains[u.chain].planned_start.copy()
        start += 100.0 - start[u.first]
        chains[u.chain] = replace(chains[u.chain], planned_start=start)
    together = find_blocks(chains, relations)
    assert any({a, b} <= set(block) for block in together)
    flat = [unit for block in together for unit in block]
    assert sorted(flat) == list(range(len(units)))


def test_one_robot_is_left_alone() -> None:
    tpg = build_tpg(random_plan(2, 5, rounds=1, step=0.5))
    alone = replace(tpg, chains=tpg.chains[:1])
    assert reorder_tasks(alone) is alone


@pytest.mark.parametrize(
    "name",
    [
        "lego/cliff",
        "multi_arm/tray",
        pytest.param("multi_arm/assembly", marks=pytest.mark.nightly),
    ],
)
def test_edges_are_those_of_a_search_among_all_nodes(
    name: str, shipped: ShippedRuns
) -> None:
    planned = shipped(name).planned
    tpg = planned.turns or planned.tpg
    relations = TaskRelations(DerivedTpg(tpg))
    blocks = find_blocks(tpg.chains, relations)
    way = TaskOrderSearch(relations, blocks).best_path(8)
    order = [blocks[b] for b in way.order()]
    assert order != blocks
    chains = put_in_order(tpg.chains, relations, order)
    found = connect_in_order(chains, relations, order)
    searched = connect_nodes(DerivedTpg(replace(tpg, chains=chains)))
    assert np.array_equal(found.edges, searched.edges)
    makespan = float(DerivedTpg(found).rollout.makespan)
    assert makespan == pytest.approx(max(way.clocks), abs=1e-6)


def in_slots(plan: MotionPlan, seed: int = 0) -> SynchronousPlan:
    speeds = {robot.name: L1Speed(1.0) for robot in plan.cell.robots}
    return plan_synchronous(
        plan,
        MotionSettings({}, speeds, 0.15, {}, attempts=2, seed=seed),
        TaskConflicts(plan),
        always_jointly=True,
    )


def movers(turns: MotionPlan, plan: SynchronousPlan) -> dict[int, list[int]]:
    """Return the skills, and the transits that lead somewhere, by their slots."""
    found, free = defaultdict(list), transits(plan)
    for task, motion, slot in zip(
        turns.tasks, turns.motions, plan.slot_of_task.tolist(), strict=True
    ):
        if task.index not in free or np.any(np.diff(motion.path, axis=0)):
            found[slot].append(task.index)
    return found


def transits(plan: SynchronousPlan) -> set[int]:
    return {
        task.index
        for task in plan.motion_plan.tasks
        if task.kind == TaskKind.TRANSIT and not task.handlings
    }


@given(st.integers(2, 4), st.integers(0, 10_000))
@settings(max_examples=12, deadline=None)
def test_every_slot_in_which_several_move_is_planned_jointly(
    robots: int, seed: int
) -> None:
    plan = random_plan(robots, seed, rounds=6)
    found = in_slots(plan)
    joint, free = set(map(frozenset, found.jointly_planned)), transits(found)
    several = {frozenset(own) for own in movers(plan, found).values() if len(own) > 1}
    assert joint == {own & free for own in several if own & free}


@pytest.mark.nightly
@given(st.integers(2, 4), st.integers(0, 10_000))
@settings(max_examples=8, deadline=None)
def test_the_graph_keeps_the_guarantee_whatever_the_delays(
    robots: int, seed: int
) -> None:
    slots = in_slots(random_plan(robots, seed, rounds=6))
    tpg = build_tpg(slots.motion_plan)  # checks the invariant itself
    rng = np.random.default_rng(seed)
    run_at_random(tpg, PlainGraph(tpg, -TOLERANCE), rng, set())
    planned = max(float(m.time[-1]) for m in slots.motion_plan.motions)
    assert earliest_times(tpg).makespan <= planned + 1e-6
    barred = with_barriers(replace(tpg, slots=slots.slot_of_task))
    assert earliest_times(barred).makespan <= planned + 1e-6


def test_beside_a_skill_nothing_that_it_sweeps_is_touched_at_any_time() -> None:
    mixed = elsewhere = 0
    for seed in range(40):
        plan = random_plan(3, seed, rounds=8)
        slots = in_slots(plan)
        free = transits(slots)
        # Asked of the plan that came out, so that paths are the new ones.
        conflicts = TaskConflicts(slots.motion_plan)
        before = {t.index: m for t, m in zip(plan.tasks, plan.motions, strict=True)}
        after = dict(
            zip(before, slots.motion_plan.motions, strict=True)
        )  # in the order of the tasks
        for own in movers(plan, slots).values():
            for skill in set(own) - free:
                for transit in set(own) & free:
                    assert not conflicts.sweeps(skill, transit)
                    mixed += 1
                    a, b = before[transit].path, after[transit].path
                    elsewhere += a.shape != b.shape or not np.allclose(a, b)
    assert mixed > 20
    assert elsewhere > 5


def test_lock_step_is_kept_and_ends_are_those_of_the_sequential_plan() -> None:
    several = 0
    for seed in range(6):
        plan = random_plan(3, seed, rounds=10, objects=0)
        slots = in_slots(plan)
        at = {task.index: k for k, task in enumerate(plan.tasks)}
        motions = slots.motion_plan.motions
        for group in slots.jointly_planned:
            times = [motions[at[task]].time for task in group]
            assert all(np.array_equal(times[0], other) for other in times)
            several += len(group) > 1
        for before, after in zip(plan.motions, motions, strict=True):
            assert np.allclose(before.path[0], after.path[0])
            assert np.allclose(before.path[-1], after.path[-1])
    assert several > 10


def test_who_cannot_be_planned_with_the_others_comes_later(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plan = random_plan(3, 2, rounds=10, objects=0)
    robot = {task.index: task.robot for task in plan.tasks}
    real = synchronous._Planner._plan_composite

    def without_arm1(self, indices, *rest):  # type: ignore[no-untyped-def]
        alone = {robot[i] for i in (*indices, *rest[1])} - {"arm1"}
        if alone and any(robot[i] == "arm1" for i in indices):
            return None
        return real(self, indices, *rest)

    monkeypatch.setattr(synchronous._Planner, "_plan_composite", without_arm1)
    slots = in_slots(plan)
    assert sorted(m for own in movers(plan, slots).values() for m in own) == sorted(
        task.index
        for task, motion in zip(plan.tasks, plan.motions, strict=True)
        if task.kind != TaskKind.TRANSIT or np.any(np.diff(motion.path, axis=0))
    )
    free, pairs = transits(slots), 0
    for own in movers(plan, slots).values():
        if len(own) > 1:
            assert all(robot[i] != "arm1" for i in own if i in free)
            pairs += len({robot[i] for i in own if i in free}) > 1
    assert pairs > 0
    build_tpg(slots.motion_plan)


def test_the_same_seed_gives_the_same_paths() -> None:
    plan = random_plan(3, 2, rounds=10)
    first, second = in_slots(plan), in_slots(plan)
    for a, b in pairwise((first.motion_plan, second.motion_plan)):
        for one, other in zip(a.motions, b.motions, strict=True):
            assert np.array_equal(one.path, other.path)

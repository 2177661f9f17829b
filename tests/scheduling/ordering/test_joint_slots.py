"""Plans in slots as in the paper: all that move for a transit in a slot are planned as one robot."""

from collections import defaultdict
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.geometry.exact import TOLERANCE
from planning.motion.known_motions import MotionPlan
from planning.motion.sequential import MotionSettings
from planning.motion.speed import L1Speed
from planning.tasks.task import TRANSIT
from scheduling.build_tpg import build_tpg
from scheduling.graph.dispatcher import earliest_times
from scheduling.graph.task_edges import with_barriers
from scheduling.ordering import synchronous
from scheduling.ordering.synchronous import (
    SynchronousPlan,
    TaskConflicts,
    plan_synchronous,
)
from tests.scheduling.algorithm_one import PlainGraph
from tests.scheduling.mini_world import random_plan
from tests.scheduling.random_dispatch import run_at_random


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
        if task.kind == TRANSIT and not task.handlings
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
        if task.kind != TRANSIT or np.any(np.diff(motion.path, axis=0))
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

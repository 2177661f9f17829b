"""The invariant holds for what is built, and its breaches are found and named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planning.cell.shape import box_shape
from planning.cell.workcell import CellObject
from planning.errors import PlanInvariantError
from planning.motion.known_motions import MotionPlan
from planning.tasks.task import AllowedContact, Handling
from planning.transforms import translation
from scheduling.build_tpg import build_tpg
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.invariant import check_invariant
from tests.scheduling.algorithm_one import PlainGraph
from tests.scheduling.corner_arms import one_joint_plan
from tests.scheduling.mini_world import random_plan
from tests.scheduling.random_dispatch import run_at_random


@pytest.mark.parametrize(("robots", "seed"), [(2, 0), (2, 4), (3, 5), (3, 11), (4, 1)])
def test_no_delay_brings_two_robots_together(robots: int, seed: int) -> None:
    plan = random_plan(robots, seed, rounds=7, step=0.5)
    tpg = build_tpg(plan)
    plain = PlainGraph(tpg)
    rng = np.random.default_rng(seed)
    met: set[tuple[object, object]] = set()
    for _ in range(6):
        run_at_random(tpg, plain, rng, met)
    assert len(met) > 100


def test_a_dropped_edge_is_noticed() -> None:
    tpg = build_tpg(random_plan(3, 5))
    assert len(tpg.edges) > 10
    missed = 0
    for k in range(len(tpg.edges)):
        less = replace(
            tpg, edges=np.delete(tpg.edges, k, 0), cause=np.delete(tpg.cause, k)
        )
        try:
            check_invariant(DerivedTpg(less))
        except PlanInvariantError:
            continue
        missed += tpg.cause[k] == 1
    # Every edge of a motion conflict is needed: the graph is reduced. The decision is made
    # with a little less clearance than edges are drawn with, hence "hardly any".
    assert missed <= 1


def test_a_robot_that_stands_in_the_way_is_named() -> None:
    # The right arm goes to the corner and stays; the left one sweeps through it meanwhile.
    plan = one_joint_plan(
        ("right", [1.5, 0.0]), ("left", [1.5, 0.0, -1.5]), ("right", [0.0, 1.5])
    )
    with pytest.raises(
        PlanInvariantError,
        match=r"node 1 of robot 'left' \(task 1, move 1\) runs into robot 'right', which"
        r" stands between node 0 of robot 'right' .* and node 1 of robot 'right'",
    ):
        build_tpg(plan)


def test_robots_that_stand_before_or_after_all_their_nodes_count() -> None:
    before = one_joint_plan(("left", [1.5, 0.0, 1.5]), ("right", [0.0, 1.5]))
    with pytest.raises(
        PlanInvariantError, match="stands before node 0 of robot 'right'"
    ):
        build_tpg(before)
    after = one_joint_plan(("right", [1.5, 0.0]), ("left", [1.5, 0.0, 1.5]))
    with pytest.raises(
        PlanInvariantError, match="stands after node 0 of robot 'right'"
    ):
        build_tpg(after)
    # HOME of the right arm is in the corner, and it has no node at all.
    never = one_joint_plan(("left", [1.5, 0.0, 1.5]))
    with pytest.raises(PlanInvariantError, match="'right', which stands at HOME"):
        build_tpg(never)


def _with_box(plan: MotionPlan, x: float, y: float, **changes: object) -> MotionPlan:
    box = CellObject(
        "box",
        "box",
        box_shape("box", (0.04, 0.04, 0.04)),
        translation(x, y, 0.0),
    )
    cell = replace(plan.cell, objects=(box,))
    return replace(plan, cell=cell, **changes)  # type: ignore[arg-type]


def _pick_at_the_first_waypoint() -> tuple[Handling, ...]:
    return (Handling("box", 1, "left", translation(0.0, 0.1, 0.0)),)


def test_a_box_at_rest_that_is_in_the_way_is_named() -> None:
    # The right arm sweeps over where the box lies until the left one picks it up.
    plan = one_joint_plan(
        ("right", [1.5, -1.5]), ("left", [1.5, 1.4, 1.5]), ("right", [-1.5, 1.5])
    )
    tasks = list(plan.tasks)
    tasks[1] = replace(tasks[1], kind="pick", handlings=_pick_at_the_first_waypoint())
    allowed = (AllowedContact("left/tool", "box", frozenset([1])),)
    plan = _with_box(plan, 0.25, 0.0, tasks=tuple(tasks), allowed=allowed)
    with pytest.raises(
        PlanInvariantError,
        match=r"node 0 of robot 'right' .* runs into 'box' at rest before node 0 of robot"
        r" 'left'",
    ):
        build_tpg(plan)


def test_what_sweeps_the_place_of_a_box_waits_until_it_is_gone() -> None:
    plan = one_joint_plan(("left", [1.5, 1.4, 1.5]), ("right", [1.5, -1.5]))
    tasks = list(plan.tasks)
    tasks[0] = replace(tasks[0], kind="pick", handlings=_pick_at_the_first_waypoint())
    allowed = (AllowedContact("left/tool", "box", frozenset([0])),)
    plan = _with_box(plan, 0.25, 0.0, tasks=tuple(tasks), allowed=allowed)
    assert build_tpg(plan).edges.tolist() == [[0, 0, 1, 0]]
    # Without the box the two motions have nothing to do with each other.
    assert build_tpg(one_joint_plan(*_moves(plan))).edges.tolist() == []


def _moves(plan: MotionPlan) -> list[tuple[str, list[float]]]:
    return [
        (task.robot, motion.path[:, 0].tolist())
        for task, motion in zip(plan.tasks, plan.motions, strict=True)
    ]


def test_a_handover_without_a_dependency_is_refused() -> None:
    plan = one_joint_plan(
        ("left", [1.5, 1.4, 1.5]), ("left", [1.5, 1.5]), ("right", [1.5, 1.45])
    )
    hand_over = Handling("box", 1, "right", translation(0.6, 0.1, 0.0))
    tasks = list(plan.tasks)
    tasks[0] = replace(tasks[0], kind="pick", handlings=_pick_at_the_first_waypoint())
    tasks[1] = replace(tasks[1], kind="handover", handlings=(hand_over,))
    every = frozenset([0, 1, 2])
    allowed = tuple(
        AllowedContact(f"{r}/tool", "box", every) for r in ("left", "right")
    )
    plan = _with_box(plan, 0.25, 0.0, tasks=tuple(tasks), allowed=allowed)
    with pytest.raises(
        PlanInvariantError,
        match=r"node 0 of robot 'right' .* handles 'box' but does not wait for node 1 of"
        r" robot 'left'",
    ):
        build_tpg(plan)
    tpg = build_tpg(replace(plan, dependencies=np.array([[1, 2]])))
    assert tpg.edges.tolist() == [[0, 1, 1, 0]]

"""The invariant holds for what is built, and its breaches are found and named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planning.errors import PlanInvariantError
from planning.geometry.cover import box_body
from planning.motion_plan import MotionPlan
from planning.task_graph import AllowedContact, Handling
from planning.transforms import translation
from planning.workcell import CellObject
from scheduling.construction import build_tpg
from scheduling.dispatcher import Dispatcher
from scheduling.invariant import check_invariant
from scheduling.temporal_plan_graph import TemporalPlanGraph
from tests.scheduling.algorithm_one import Piece, PlainGraph
from tests.scheduling.mini_world import random_plan
from tests.scheduling.test_construction import one_joint_plan


def _random_point(
    plain: PlainGraph, robot: int, node: int, rng: np.random.Generator
) -> list[tuple[Piece, np.ndarray]]:
    """Bodies of a node, each somewhere on its motion (a skill node: in any of its parts)."""
    share = rng.random()
    path = plain.path((robot, node))
    k = int(rng.integers(len(path) - 1))
    q = path[k] + share * (path[k + 1] - path[k])
    out = []
    for piece in plain.pieces[(robot, node)]:
        if piece.solid.carrier is None or (
            np.array_equal(piece.q_a, path[k])
            and np.array_equal(piece.q_b, path[k + 1])
        ):
            out.append((piece, q))
    return out


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


def run_at_random(
    tpg: TemporalPlanGraph,
    plain: PlainGraph,
    rng: np.random.Generator,
    met: set[tuple[object, object]],
) -> None:
    """Start and complete nodes in any order the dispatcher allows; look at every pair."""
    dispatcher = Dispatcher(tpg)
    active: dict[int, int] = {}
    favourite = int(rng.integers(len(tpg.chains)))
    while not dispatcher.finished:
        ready = [n for n in dispatcher.ready() if n[0] not in active]
        moves = [("start", n) for n in ready]
        moves += [("complete", (r, n)) for r, n in active.items()]
        assert moves, "deadlock"
        # One robot is much quicker than the others, so delays are long.
        quick = [m for m in moves if m[1][0] == favourite]
        if quick and rng.random() < 0.8:
            moves = quick
        elif rng.random() < 0.1:
            favourite = int(rng.integers(len(tpg.chains)))
        what, (robot, node) = moves[int(rng.integers(len(moves)))]
        if what == "complete":
            del active[robot]
            dispatcher.complete(robot, node)
            continue
        active[robot] = node
        for other in range(len(tpg.chains)):
            if other == robot:
                continue
            if other in active:
                key = ((other, active[other]), (robot, node))
                if key not in met:
                    met.add(key)
                    u, v = sorted(key, key=plain.place.__getitem__)
                    assert (u, v) not in plain.conflicts
            else:
                hold = dispatcher.completed(other) - 1
                key = (("hold", other, hold), (robot, node))
                if key not in met:
                    met.add(key)
                    _check_hold(plain, other, hold, (robot, node), rng)


def _check_hold(
    plain: PlainGraph,
    other: int,
    hold: int,
    node: tuple[int, int],
    rng: np.random.Generator,
) -> None:
    stands = plain.stands(other, hold)
    tasks = plain.tpg.chains[other].task
    near = {int(tasks[k]) for k in (hold, hold + 1) if 0 <= k < len(tasks)}
    for _ in range(2):
        for piece, q in _random_point(plain, *node, rng):
            for still in plain.hold_pieces(other, hold):
                if any(
                    plain.may_touch(piece.entity, still.entity, (plain.task(node), t))
                    for t in near
                ):
                    continue
                assert not plain.overlap(piece, q, still, stands)


def test_a_dropped_edge_is_noticed() -> None:
    tpg = build_tpg(random_plan(3, 5))
    assert len(tpg.edges) > 10
    missed = 0
    for k in range(len(tpg.edges)):
        less = replace(
            tpg, edges=np.delete(tpg.edges, k, 0), cause=np.delete(tpg.cause, k)
        )
        try:
            check_invariant(less)
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
        np.full(3, 0.04),
        translation(x, y, 0.0),
        box_body("box", (0.04, 0.04, 0.04)),
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

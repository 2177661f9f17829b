"""Whole constructions: orders, sequences of actions, rounds of tries, and plans that keep what they promise."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from itertools import combinations, permutations
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.construction.fine_check.check import check_construction
from benchmarks.construction.fixed_time import FixedTimeSolver
from planning.construction.candidates import (
    earliest_placement_time,
    rank_parts,
    robot_groups,
    skeletons,
)
from planning.construction.motion_plan_export import motion_plan
from planning.construction.planner import (
    ConstructionSearch,
    PlacementRound,
    PlacementRounds,
    plan_construction,
    plan_with_solver,
)
from planning.construction.problem.models import tower
from planning.construction.problem.problem import Part
from planning.construction.problem.reach_bounds import ReachBounds
from planning.construction.problem.settings import PlannerSettings, SearchSettings
from planning.construction.problem.supply_layout import Spiral
from planning.construction.subproblem import Attempt, Solution, SubproblemSolver
from planning.construction.world.fixed_world import BuildState, initial_build_state
from planning.contacts.precedence import PartGraph
from planning.errors import ConstructionError
from tests.planning.construction.toy_sites import (
    CHEST,
    handover_plan,
    slab_digest,
    toy_part,
    toy_problem,
)

ROOT = Path(__file__).parents[3]


class _Able(ReachBounds):
    """Says that every robot reaches everything, and hands over to any other."""

    def able_alone(self, part: Part) -> tuple[str, ...]:
        return self.problem.team

    def can_hand_over(
        self, giver: str, taker: str, part: Part, *, first: bool = True
    ) -> bool:
        return True


def test_one_robot_comes_before_two_and_each_has_the_part_once() -> None:
    problem = toy_problem(CHEST, 3)
    found = list(
        skeletons(_Able(problem), initial_build_state(problem), problem.parts[0])
    )
    assert found[:3] == [(robot,) for robot in problem.team]
    assert sorted(found[3:]) == sorted(permutations(problem.team, 2))


_SEVEN = toy_problem(
    tuple(toy_part(f"p{k}", (0.2, 0.1, 0.1), (float(k), 0.0, 0.1)) for k in range(7)), 1
)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000))
def test_order_of_parts_is_that_of_eq_6(seed: int) -> None:
    rng = np.random.default_rng(seed)
    names = [f"p{k}" for k in range(7)]
    touch = {
        frozenset((a, b)) for a in names for b in names if a < b and rng.random() < 0.4
    }
    near = {a: frozenset(b for b in names if frozenset((a, b)) in touch) for a in names}
    carriers = {
        a: frozenset(b for b in near[a] if b < a and rng.random() < 0.5) for a in names
    }
    ground = {a: frozenset(("ground",)) for a in names if rng.random() < 0.3}
    problem = replace(_SEVEN, graph=PartGraph(near, ground, carriers))
    placed = {n: float(rng.random()) for n in names if rng.random() < 0.5}
    ranked = rank_parts(problem, placed, {}, rng)
    possible = {
        n
        for n in names
        if n not in placed
        and (n in ground or any(p in near[n] for p in placed))
        and all(c in placed for c in carriers[n])
    }
    assert set(ranked) == possible
    counts = [sum(p in near[n] for p in placed) for n in ranked]
    assert counts == sorted(counts, reverse=True)
    for n in ranked:
        assert all(
            earliest_placement_time(problem, n, placed) >= placed[c]
            for c in carriers[n]
        )


def test_parts_that_would_wall_others_in_wait() -> None:
    problem = toy_problem(CHEST, 1)
    placed = {"post1": 1.0, "post2": 2.0}
    rng = np.random.default_rng(0)
    assert rank_parts(problem, placed, {}, rng)[0] == "slab"
    walls = {"chest": {frozenset(("post1", "post2", "slab"))}}
    assert rank_parts(problem, placed, walls, rng) == ["chest"]


def test_robots_that_are_free_earliest_come_first() -> None:
    problem = toy_problem(CHEST, 3)
    world = initial_build_state(problem)
    busy = world.moved(
        "robot1", np.array([0.0, 4.0]), np.tile(problem.cell.robots[0].home, (2, 1))
    )
    busy = busy.moved(
        "robot2", np.array([0.0, 2.0]), np.tile(problem.cell.robots[1].home, (2, 1))
    )
    assert robot_groups(busy, problem.team, 1) == [
        ("robot3",),
        ("robot2",),
        ("robot1",),
    ]
    assert robot_groups(busy, problem.team, 2)[0] == ("robot2", "robot3")


ONCE = replace(
    PlannerSettings(), search=replace(PlannerSettings().search, attempts=1, tries=1)
)
"""Nothing is tried twice before something else is."""


@pytest.mark.parametrize(
    "effort",
    [ONCE, pytest.param(PlannerSettings(), marks=pytest.mark.nightly)],
    ids=["once", "usual"],
)
def test_placements_are_taken_back_for_a_part_that_was_built_in(
    effort: PlannerSettings,
) -> None:
    plan = plan_construction(toy_problem(CHEST, 2, seed=3), effort)
    order = [str(w.object) for w in plan.building.work if w.holder is None]
    assert sorted(order) == ["chest", "post1", "post2", "slab"]
    assert plan.rewound >= 1
    assert {f.part.name for f in plan.failures} == {"chest"}
    assert order.index("chest") < order.index("slab")
    assert check_construction(plan).faults == ()


@pytest.mark.parametrize("approach", [0.05, 0.15])
def test_a_handover_is_found_where_nobody_can_do_it_alone(approach: float) -> None:
    plan = handover_plan(approach)
    work = sorted(plan.building.work, key=lambda w: w.start)
    assert [(w.kind, w.robot, w.holder) for w in work] == [
        ("pick", "arm", "arm"),
        ("handover", "arm", "crane"),
        ("place-down", "crane", None),
    ]
    assert check_construction(plan).faults == ()
    assert motion_plan(plan.problem, plan.building).tasks
    # One alone was never tried: the bounds say that it is no use.
    assert all(len(f.robots) == 2 for f in plan.failures)


def test_of_two_that_may_give_the_one_that_is_free_earlier_does() -> None:
    world = initial_build_state(toy_problem(CHEST, 3))
    for robot, end in (("robot1", 4.0), ("robot2", 5.0), ("robot3", 2.0)):
        home = world.world.cell.robot(robot).home
        world = world.moved(robot, np.array([0.0, end]), np.tile(home, (2, 1)))
    groups = robot_groups(world, ("robot1", "robot2", "robot3"), 2)
    assert groups == [
        ("robot1", "robot3"),
        ("robot2", "robot3"),
        ("robot1", "robot2"),
    ]


@pytest.mark.nightly
def test_two_processes_make_the_same_plan() -> None:
    code = (
        "from tests.planning.construction.toy_sites import slab_digest;"
        "print(hash('robot1'), slab_digest())"
    )
    # Sets of names are gone through in another order in each process.
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONHASHSEED": "1", "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
    )
    other, found = done.stdout.split()
    assert int(other) != hash("robot1")
    assert found == slab_digest()


@pytest.mark.parametrize("fixed", [False, True])
def test_a_way_that_loses_too_much_is_of_no_use(fixed: bool) -> None:
    problem = toy_problem(tower(2), 2)
    bounds = ReachBounds(problem)
    args = (bounds, PlannerSettings().subproblem)
    solver = FixedTimeSolver(*args) if fixed else SubproblemSolver(*args)
    building = initial_build_state(problem)
    for part, robot in zip(problem.parts, problem.team, strict=True):
        attempt = Attempt(part, (robot,), [1])
        found = solver.solve(building, attempt)
        assert found is not None
        assert found.lost >= 0.0
        assert solver.solve(building, replace(attempt, lost=0.0)) is None
        other = solver.solve(building, replace(attempt, lost=found.lost))
        assert other is None or other.lost < found.lost
        building = found.building


@pytest.mark.nightly
def test_parts_without_joints_come_one_after_another_where_they_touch() -> None:
    boxes = tuple(
        toy_part(f"p{k}", (0.3, 0.2, 0.08), (0.3 * k - 0.45, 0.0, 0.04))
        for k in range(4)
    )
    problem = toy_problem(boxes, 3)
    plan = plan_construction(problem)
    assert check_construction(plan).faults == ()
    placed = [w for w in plan.building.work if w.holder is None]
    for first, second in combinations(placed, 2):
        if abs(int(str(first.object)[1:]) - int(str(second.object)[1:])) == 1:
            assert second.start >= first.end - 1e-9
    # Whenever what touches it was planned to come.
    solver = SubproblemSolver(ReachBounds(problem), PlannerSettings().subproblem)
    late = replace(initial_build_state(problem), placed={"p1": 100.0})
    ready = [solver.earliest_times(late, part).place for part in problem.parts]
    assert ready == [100.0, 100.0, 100.0, 0.0]


@pytest.mark.nightly
def test_stacks_are_taken_from_the_top() -> None:
    boxes = tuple(
        toy_part(f"p{k}", (0.3, 0.2, 0.1), (0.5 * k - 0.75, 0.0, 0.05))
        for k in range(4)
    )
    problem = toy_problem(boxes, 2, supply=Spiral(turn=2.0, high=2))
    assert problem.graph.covers == {"p1": {"p0"}, "p3": {"p2"}}
    plan = plan_construction(problem)
    assert check_construction(plan).faults == ()
    picks = {w.object: w for w in plan.building.work if w.kind == "pick"}
    # However late tasks come, they keep that order.
    motions = motion_plan(problem, plan.building)
    label = {task.label: task.index for task in motions.tasks}
    order = {tuple(pair) for pair in motions.dependencies.tolist()}
    for above, below in (("p0", "p1"), ("p2", "p3")):
        assert picks[below].start >= picks[above].end - 1e-9
        assert (label[f"pick {above}"], label[f"pick {below}"]) in order
    swapped = {"p0": "p1", "p1": "p0"}
    work = tuple(
        replace(w, object=swapped.get(str(w.object), w.object))
        for w in plan.building.work
    )
    wrong = replace(plan, building=replace(plan.building, work=work))
    words = {fault.words for fault in check_construction(wrong).faults}
    assert "p1 is picked while p0 lies on it" in words


@pytest.mark.nightly
def test_robots_at_one_stack_keep_clear_of_what_others_have_just_taken() -> None:
    boxes = tuple(
        toy_part(f"p{k}", (0.3, 0.2, 0.1), (0.5 * k - 1.25, 0.0, 0.05))
        for k in range(6)
    )
    problem = toy_problem(boxes, 3, supply=Spiral(high=6))
    plan = plan_construction(problem)
    assert check_construction(plan).faults == ()
    picks = sorted((w.start, w.object) for w in plan.building.work if w.kind == "pick")
    assert [part for _, part in picks] == [part.name for part in boxes]
    motion_plan(problem, plan.building)  # refuses what comes too close


class _Told(SubproblemSolver):
    """Says what a test wants of every part that is to be placed easily, see ``tell``."""

    low_effort = True
    """Whether ways are in fact only looked for where they are easy to find."""

    def tell(
        self, building: BuildState, part: Part, robot: str, found: Solution | None
    ) -> Solution | None:
        """Return what is said in place of what was found."""
        raise AssertionError("each test has its own")

    def solve(self, building: BuildState, attempt: Attempt) -> Solution | None:
        assert attempt.low_effort
        found = super().solve(
            building, replace(attempt, low_effort=self.low_effort, lost=np.inf)
        )
        part = attempt.part
        assert found is None or found.building.placed[part.name] <= attempt.latest
        told = self.tell(building, part, attempt.robots[0], found)
        return None if told is None or told.lost >= attempt.lost else told


class _Late(_Told):
    """Says of every part that it is late, and notes who was asked and when each could be done."""

    asked: dict[str, dict[str, float]]

    def tell(
        self, building: BuildState, part: Part, robot: str, found: Solution | None
    ) -> Solution | None:
        ends = self.asked.setdefault(part.name, {})
        ends[robot] = np.inf
        if found is None:
            return None
        ends[robot] = found.building.placed[part.name]
        return replace(found, late=100.0)


def test_where_a_robot_is_late_others_are_asked_and_the_soonest_does_it() -> None:
    problem = toy_problem(CHEST[:3], 4)  # two parts at a time for four robots
    bounds, settings = ReachBounds(problem), PlannerSettings()
    solver = _Late(bounds, settings.subproblem)
    solver.asked = {}
    once = replace(settings.search, tries=1)
    plan = plan_with_solver(solver, once, lambda done, total: None)
    who = {w.object: w.robot for w in plan.building.work if w.holder is None}
    for part, ends in solver.asked.items():
        assert who[part] == min(ends, key=lambda r: ends[r])
    assert max(len(ends) for ends in solver.asked.values()) > 1
    # Who is not late does it, and nobody else is asked.
    plain = plan_construction(problem)
    first = min(problem.team, key=problem.team.index)
    assert plain.building.work[0].robot == first


class _Jealous(SubproblemSolver):
    """Of two parts whichever comes first keeps the other from its place."""

    def solve(self, building: BuildState, attempt: Attempt) -> Solution | None:
        return None if building.placed else super().solve(building, attempt)


def test_parts_that_keep_each_other_from_their_places_end_the_search() -> None:
    boxes = (
        toy_part("left", (0.2, 0.1, 0.1), (-0.5, 0.0, 0.05)),
        toy_part("right", (0.2, 0.1, 0.1), (0.5, 0.0, 0.05)),
    )
    problem = toy_problem(boxes, 1)
    bounds, settings = ReachBounds(problem), PlannerSettings()
    solver = _Jealous(bounds, settings.subproblem)
    with pytest.raises(ConstructionError, match=r"to place both (left|right) and"):
        plan_with_solver(
            solver,
            replace(settings.search, tries=1, returns=2),
            lambda done, total: None,
        )


class _Lossy(_Told):
    """Says of every part that so much time is lost with it, and notes what was tried."""

    low_effort = False  # it is of no interest here what is easy
    losses: dict[str, float]
    tried: dict[int, list[str]]

    def tell(
        self, building: BuildState, part: Part, robot: str, found: Solution | None
    ) -> Solution | None:
        if part.name != "p0":
            assert robot == min(self.problem.team, key=building.world.free_from)
        self.tried.setdefault(building.step, []).append(part.name)
        assert found is not None
        return replace(found, lost=self.losses[part.name])


def test_where_a_robot_loses_time_it_places_the_part_with_which_it_loses_least() -> (
    None
):
    boxes = tuple(
        toy_part(f"p{k}", (0.2, 0.1, 0.1), (0.5 * k - 1.0, 0.0, 0.05)) for k in range(5)
    )
    problem = toy_problem(boxes, 2)
    bounds, settings = ReachBounds(problem), PlannerSettings()
    solver = _Lossy(bounds, settings.subproblem)
    # With p0 more is always lost than with another one; p1 is good enough.
    solver.losses = {"p0": 50.0, "p1": 1.0, "p2": 5.0, "p3": 4.0, "p4": 7.0}
    solver.tried = {}
    once = replace(settings.search, tries=1)
    plan = plan_with_solver(solver, once, lambda done, total: None)
    placed = [w.object for w in plan.building.work if w.holder is None]
    assert placed[-1] == "p0"
    for step, tried in solver.tried.items():
        assert len(tried) <= settings.search.parts
        assert placed[step - 1] == min(tried, key=lambda p: solver.losses[p])
        # What is good enough ends it, and nothing else does while there are others.
        assert "p1" not in tried[:-1]
        left = 5 - (step - 1)
        assert tried[-1] == "p1" or len(tried) == min(left, 3) or left == 1


PARTS = 7
PROBLEM = toy_problem(
    tuple(
        toy_part(f"p{k}", (0.2, 0.1, 0.1), (float(k), 0.0, 0.1)) for k in range(PARTS)
    ),
    3,
)


class Told:
    """Places parts in their order, with losses from a table; NaN where it cannot.

    Args:
        losses: by step and turn, shape (parts, turns) [s].
    """

    problem = PROBLEM

    def __init__(self, losses: np.ndarray) -> None:
        self.losses = losses
        self.spent = 0
        self.spent_again = 0

    def next_parts(self, building: BuildState) -> list[Part]:
        return list(PROBLEM.parts[len(building.placed) :])

    def place_next(
        self, building: BuildState, parts: list[Part], turn: int, most_loss: float
    ) -> Solution | None:
        self.spent += 1
        self.spent_again += turn > 0
        loss = float(self.losses[len(building.placed), turn])
        if not loss < most_loss:
            return None
        placed = {**building.placed, parts[0].name: 1.0 + len(building.placed)}
        return Solution(replace(building, placed=placed), 0.0, loss)


def rounds_of(told: Told, search: SearchSettings) -> PlacementRounds:
    """Return rounds that ask a table instead of a search."""
    return PlacementRounds(cast(ConstructionSearch, told), search)


def planned(told: Told, search: SearchSettings) -> list[PlacementRound]:
    """All rounds, up to one in which a part could not be placed."""
    rounds, now, out = rounds_of(told, search), initial_build_state(PROBLEM), []
    while len(now.placed) < PARTS:
        out.append(rounds.next(now))
        if out[-1].stuck is not None:
            break
        now = out[-1].states[-1]
    return out


def losses_of(seed: int, turns: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    losses = rng.uniform(0.0, 10.0, (PARTS, turns))
    losses[rng.random(losses.shape) < 0.15] = np.nan
    return losses


@given(st.integers(0, 2**31), st.integers(1, 4), st.floats(0.0, 8.0))
@settings(max_examples=200, deadline=None)
def test_a_round_is_the_best_of_its_tries(
    seed: int, tries: int, acceptable: float
) -> None:
    losses = losses_of(seed, tries)
    search = SearchSettings(
        round=5, tries=tries, acceptable_loss_s=acceptable, again=1e9
    )
    first = 0
    # Three robots make rounds of three; the last one takes what is left.
    for found, size in zip(planned(Told(losses), search), (3, 4), strict=False):
        steps = slice(first, first + size)
        totals = losses[steps].sum(axis=0)  # NaN where a part cannot be placed
        if np.isnan(totals[0]):
            assert found.stuck == PROBLEM.parts[first + len(found.states)]
            assert np.isnan(losses[first + len(found.states), 0])
            return
        best = totals[0]
        for total in totals[1:]:
            if best <= acceptable * size:
                break
            best = min(best, total) if not np.isnan(total) else best
        assert found.stuck is None
        assert len(found.states) == size
        np.testing.assert_allclose(found.lost, best)
        first += size
    assert first == PARTS


@given(st.integers(0, 2**31), st.floats(0.0, 6.0))
@settings(max_examples=100, deadline=None)
def test_no_more_is_spent_on_tries_than_allowed(seed: int, again: float) -> None:
    told = Told(np.nan_to_num(losses_of(seed, 4), nan=5.0))
    search = SearchSettings(round=5, tries=4, acceptable_loss_s=0.0, again=again)
    planned(told, search)
    # The try with which the allowance ends may overdraw it, by less than a round.
    assert told.spent_again < again * PARTS / 3 + 4
    assert told.spent_again > 0 or again == 0.0


def test_robots_with_nothing_left_to_do_lose_time() -> None:
    stand = np.array([0.0, 4.0])
    home = np.tile(PROBLEM.cell.robots[0].home, (2, 1))
    start = initial_build_state(PROBLEM).moved(PROBLEM.team[0], stand, home)
    told = Told(np.zeros((PARTS, 1)))
    rounds = rounds_of(told, SearchSettings(tries=1))
    first = rounds.next(start)
    assert first.lost == 0.0
    last = rounds.next(first.states[-1])
    assert last.lost == 8.0  # two robots have been free since 0 s, one since 4 s

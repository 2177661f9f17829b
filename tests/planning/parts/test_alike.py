"""Parts that are alike are shared out over goals: as every way to do so says, and so that all can be done."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import permutations, product

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from planning.cell.workcell import Workcell
from planning.errors import InfeasibleStepError
from planning.grips.grip import GripRules
from planning.parts.alike import (
    PartAllocation,
    find_alike_candidates,
    goal_turns,
    with_renamed_parts,
)
from planning.parts.assembly import PartAssembly, PartHandling, PlacePart
from planning.parts.candidates import PartCandidates, find_candidates
from planning.parts.order import find_ordered_candidates, order_steps_by_search
from planning.steps.skill import joint_distance
from planning.tasks.assignment import TaskPlan
from planning.tasks.highs_solver import assign_steps
from planning.transforms import from_rpy, translation
from tests.planning.parts.boxes import part, two_arms
from tests.planning.tasks.plan_oracle import plan_violations

Spot = tuple[float, float, float]
ONE_GRIP = PartHandling(GripRules(positions=1))
LOW = 0.0125


def bars(
    starts: Sequence[Spot], goals: Sequence[Spot], yaw: float = 0.0
) -> tuple[Workcell, PartAssembly]:
    """Return two arms with bars that are alike: bar.1, ... at some places, and goals for the first ones."""
    names = [f"bar.{k}" for k in range(1, len(starts) + 1)]
    objects = tuple(
        part(name, (0.1, 0.024, 0.024), translation(*at), 0.05)
        for name, at in zip(names, starts, strict=True)
    )
    turned = [from_rpy(at, (0.0, 0.0, yaw)) for at in goals]
    named = dict(zip(names, turned, strict=False))
    steps = tuple(PlacePart(part=name, name=f"to {name}") for name in named)
    assembly = PartAssembly(named, steps, usual=ONE_GRIP, alike=(tuple(names),))
    return replace(two_arms(), objects=objects), assembly


def chosen(found: PartCandidates) -> TaskPlan:
    plan = assign_steps(found.problem)
    assert plan_violations(found.problem, plan) == []
    return plan


def filled(listed: PartAssembly, found: PartCandidates) -> dict[str, str]:
    """Return which part comes to which goal, by the name that the list has for the goal."""
    goals = {pose.tobytes(): name for name, pose in listed.goals.items()}
    return {goals[pose.tobytes()]: n for n, pose in found.assembly.goals.items()}


def oracle(cell: Workcell, assembly: PartAssembly) -> dict[tuple[str, ...], float]:
    """Return the least of (1) of each way to share parts out, all of them planned one by one.

    With two robots, windows are of two steps, and one that does both of them pays two tasks' worth.
    """
    goals, (group,) = list(assembly.goals), assembly.alike
    least: dict[tuple[str, ...], list[dict[str, float]]] = {}
    for names in permutations(group, len(goals)):
        found = find_candidates(
            cell, with_renamed_parts(assembly, dict(zip(goals, names, strict=True)))
        )
        costs: list[dict[str, float]] = [{} for _ in goals]
        for item, (pick, place) in found.paths.unpaired.items():
            home = cell.robot(item.robot).home
            stops = home, pick.contact, place.contact, home
            way = sum(
                joint_distance(*ends) for ends in zip(stops, stops[1:], strict=False)
            )
            own = costs[item.step - 1]
            own[item.robot] = min(way, own.get(item.robot, np.inf))
        if all(costs):
            least[names] = costs
    cheapest = [
        min(min(costs[k].values()) for costs in least.values())
        for k in range(len(goals))
    ]
    weight = sum(cheapest) / len(goals)
    return {
        names: min(
            sum(own[robot] for own, robot in zip(costs, robots, strict=True))
            + 2.0
            * weight
            * sum(a == b for a, b in zip(robots, robots[1:], strict=False))
            for robots in product(*costs)
        )
        for names, costs in least.items()
    }


def apart(count: int, x: float, y: float, step: float) -> list[Spot]:
    return [(x + k * step, y, LOW) for k in range(count)]


@pytest.mark.parametrize(
    ("starts", "goals"),
    [
        (apart(3, -0.2, -0.35, 0.2), apart(3, -0.2, 0.3, 0.2)),
        # One to spare, and all that lies to the west is nearer to the goals.
        (apart(4, -0.25, -0.3, 0.15), [(-0.3, 0.3, LOW), (0.0, 0.3, LOW)]),
        # One each that only one arm reaches.
        (
            [(-0.85, 0.35, LOW), (0.85, 0.35, LOW), (0, -0.4, LOW)],
            apart(3, -0.2, 0.3, 0.2),
        ),
    ],
    ids=["in a row", "one to spare", "at the ends"],
)
def test_the_choice_is_the_best_of_all_ways(
    starts: Sequence[Spot], goals: Sequence[Spot]
) -> None:
    cell, assembly = bars(starts, goals)
    sharing = PartAllocation(cell, assembly)
    problem, parts = sharing.problem(), sharing.parts()
    known = oracle(cell, assembly)
    assert list(parts) == list(assembly.goals)
    own = known[tuple(parts.values())]
    assert own == pytest.approx(min(known.values()), abs=1e-6)
    assert problem.needs_support == (False,) * len(goals)


def test_every_goal_is_filled_by_the_arms_in_turns() -> None:
    """The west arm alone reaches the first three goals, the east arm the others."""
    ends = [(x, y, LOW) for x in (-0.9, 0.9) for y in (0.2, 0.3, 0.4)]
    cell, assembly = bars([(x * 0.7, -y, z) for x, y, z in ends], ends)
    plan = chosen(find_alike_candidates(cell, assembly, find_candidates))
    assert [c.robot for c in plan.choices] == ["west", "east"] * 3
    assert sorted(c.object for c in plan.choices) == sorted(assembly.goals)
    listed = [step.name for step in PartAllocation(cell, assembly).in_turns().steps]
    assert listed == [f"to bar.{k}" for k in (1, 4, 2, 5, 3, 6)]


def test_what_rests_on_other_goals_comes_after_them_whoever_fills_it() -> None:
    goals = [
        (0.0, -0.05, LOW),
        (0.0, 0.05, LOW),
        (0.0, -0.05, 3 * LOW - 0.0005),
        (0.0, 0.05, 3 * LOW - 0.0005),
    ]
    cell, assembly = bars(apart(4, -0.3, -0.4, 0.2), goals)
    found = find_alike_candidates(cell, assembly, find_candidates)
    names = filled(assembly, found)
    order = list(found.assembly.placed)
    for low, high in (("bar.1", "bar.3"), ("bar.2", "bar.4")):
        assert order.index(names[low]) < order.index(names[high])
    listed = replace(assembly, steps=assembly.steps[::-1])
    found = find_alike_candidates(
        cell, listed, find_ordered_candidates, order_steps_by_search
    )
    order = list(found.assembly.placed)
    for low, high in (("bar.1", "bar.3"), ("bar.2", "bar.4")):
        names = filled(listed, found)
        assert order.index(names[low]) < order.index(names[high])
    chosen(found)


def test_turns_leave_what_lies_below_before_what_lies_on_it() -> None:
    """The lower goal is nearer to the east arm, whose turn comes after that of the west arm."""
    goals = [(0.03, 0.3, LOW), (-0.03, 0.3, 3 * LOW - 0.0005)]
    cell, assembly = bars(apart(2, -0.2, -0.3, 0.4), goals)
    sharing = PartAllocation(cell, assembly)
    assert goal_turns(np.array([sharing._nearness(k) for k in (1, 2)])) == [
        (0, 1),
        (0, 0),
    ]
    assert sharing.in_turns().steps == assembly.steps


def test_a_pile_is_taken_from_its_top() -> None:
    """Two piles of three; of each as many are taken as goals need, the top ones first."""
    piles = [(x, -0.35, LOW + k * 0.024) for x in (-0.2, 0.2) for k in range(3)]
    cell, assembly = bars(piles, apart(4, -0.3, 0.3, 0.2))
    found = find_alike_candidates(cell, assembly, find_candidates)
    taken = [choice.object for choice in chosen(found).choices]
    for pile in (["bar.3", "bar.2", "bar.1"], ["bar.6", "bar.5", "bar.4"]):
        own = [name for name in taken if name in pile]
        assert own == pile[: len(own)]
        assert own


def test_a_part_on_which_something_else_lies_is_left() -> None:
    """A slab lies on one end of bar.2, which is nearest to the goal, and stays there."""
    cell, assembly = bars(apart(3, -0.2, -0.3, 0.2), [(0.0, 0.3, LOW)])
    slab = part("slab", (0.02, 0.024, 0.02), translation(0.04, -0.3, 0.0345), 0.05)
    free = find_alike_candidates(cell, assembly, find_candidates)
    assert filled(assembly, free) == {"bar.1": "bar.2"}
    covered = replace(cell, objects=(*cell.objects, slab))
    found = find_alike_candidates(covered, assembly, find_candidates)
    assert filled(assembly, found)["bar.1"] in ("bar.1", "bar.3")
    chosen(found)


def test_goals_may_be_where_others_of_the_kind_lie() -> None:
    """All move up by one place: whoever lies in a goal goes before that is filled."""
    starts = apart(3, -0.1, 0.3, 0.15)
    cell, assembly = bars(starts, [starts[1], starts[2], (0.35, 0.3, LOW)])
    for item in PartAllocation(cell, assembly).problem().primaries:
        lying = {1: "bar.2", 2: "bar.3"}.get(item.step, item.object)
        assert lying in {item.object, *item.after}
    found = find_alike_candidates(cell, assembly, find_candidates)
    there = {tuple(np.round(at, 3)): f"bar.{k}" for k, at in enumerate(starts, start=1)}
    gone = set()
    for choice, step in zip(chosen(found).choices, found.steps, strict=True):
        gone.add(choice.object)
        assert there.get(tuple(np.round(step.place[:3, 3], 3)), choice.object) in gone


def test_where_nobody_reaches_a_goal_the_assignment_says_so() -> None:
    cell, assembly = bars(apart(2, -0.2, 0.3, 0.4), [(0.0, 0.3, LOW), (0.0, 0.95, LOW)])
    found = find_alike_candidates(cell, assembly, find_candidates)
    said = r"step 2 \(pick and place bar\.[12]\): no robot, object and grasp can do it\n.*out of reach"
    with pytest.raises(InfeasibleStepError, match=said):
        assign_steps(found.problem)


WEST, EAST = ((-0.9, 0.2, LOW), (-0.9, 0.3, LOW)), ((0.9, 0.2, LOW), (0.9, 0.3, LOW))


@pytest.mark.parametrize(
    ("starts", "goals"),
    [
        (WEST, [(-0.7, -0.4, LOW), EAST[0]]),
        # Each goal alone could be filled by the west arm; there is one part for both.
        ([WEST[0], EAST[0]], [(-0.7, -0.4, LOW), (-0.8, -0.4, LOW)]),
    ],
    ids=["a goal out of reach", "a part out of reach"],
)
def test_arms_that_share_nothing_lay_parts_down_for_each_other(
    starts: Sequence[Spot], goals: Sequence[Spot]
) -> None:
    cell, assembly = bars(starts, goals)
    found = find_alike_candidates(cell, assembly, find_candidates)
    relays = [found.paths.relays.get(c.primary) for c in chosen(found).choices]
    assert sum(relay is not None for relay in relays) == 1


SPOTS = st.lists(
    st.tuples(st.integers(-4, 4), st.integers(2, 4)),
    unique=True,
    min_size=1,
    max_size=5,
)


@settings(max_examples=12, deadline=None, phases=[Phase.explicit, Phase.generate])
@given(starts=SPOTS, goals=SPOTS, quarter=st.sampled_from([0.0, np.pi / 2]))
def test_each_goal_is_filled_once_by_one_of_its_kind(
    starts: list[tuple[int, int]], goals: list[tuple[int, int]], quarter: float
) -> None:
    goals = goals[: len(starts)]
    cell, assembly = bars(
        [(0.12 * x, -0.11 * y, LOW) for x, y in starts],
        [(0.12 * x, 0.11 * y, LOW) for x, y in goals],
        quarter,
    )
    found = find_alike_candidates(cell, assembly, find_candidates)
    names = filled(assembly, found)
    (group,) = assembly.alike
    assert names.keys() == assembly.goals.keys()
    assert len(set(names.values())) == len(goals)
    assert set(names.values()) <= set(group)
    plan = chosen(found)
    assert sorted(c.object for c in plan.choices) == sorted(names.values())
    again = find_alike_candidates(cell, assembly, find_candidates)
    assert assign_steps(again.problem) == plan


WAYS = st.integers(1, 3).flatmap(
    lambda robots: st.lists(
        st.lists(
            st.sampled_from([1.0, 2.0, 5.0, np.inf]), min_size=robots, max_size=robots
        ),
        min_size=1,
        max_size=5,
    )
)


@given(WAYS)
def test_turns_are_the_cheapest_with_loads_that_rise(ways: list[list[float]]) -> None:
    """Every way to share goals out over robots; one more for a robot costs as much as it has by then."""
    known = [way for own in ways for way in own if np.isfinite(way)]
    load = float(np.mean(known)) if known else 1.0

    def cost(robots: Sequence[int]) -> float:
        total = sum(min(ways[k][r], 1e6) for k, r in enumerate(robots))
        counts = [robots.count(r) for r in set(robots)]
        return total + load * sum(n * (n - 1) / 2 for n in counts)

    found = goal_turns(np.array(ways))
    own = tuple(robot for _, robot in found)
    every = product(range(len(ways[0])), repeat=len(ways))
    assert cost(own) == pytest.approx(min(cost(robots) for robots in every))
    counts: Mapping[int, list[int]] = {r: [n for n, k in found if k == r] for r in own}
    assert all(own == list(range(len(own))) for own in counts.values())

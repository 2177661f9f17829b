"""The integer program against trying every plan there is, and window by window."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise, permutations, product
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from planning.errors import InfeasibleStepError
from planning.tasks import highs_solver, rolling_horizon
from planning.tasks.assignment import (
    NO_TOOLS,
    AssignmentProblem,
    PrimaryCandidate,
    Rejection,
    StepChoice,
    SupportCandidate,
    TaskPlan,
    alternative_choices,
    step_choices,
)
from planning.tasks.highs_solver import assign_steps
from planning.tasks.rolling_horizon import needs_rolling_horizon, solve_in_windows
from tests.planning.tasks.plan_oracle import objective, plan_violations

ROBOTS = ("ada", "bob", "cy")
TOOLS = ("awl", "bit", "cup")


@st.composite
def problems(draw: st.DrawFn) -> AssignmentProblem:
    """Small problems with every feature; many are infeasible."""
    robots = ROBOTS[: draw(st.integers(2, 3))]
    # Some robots have two or three tools that they change, and each candidate one of them.
    own = {r: TOOLS[: draw(st.integers(2, 3))] for r in robots if draw(st.booleans())}
    ways = {tool: float(draw(st.integers(0, 8))) for tool in TOOLS}

    def tools_of(*names: str | None) -> frozenset[tuple[str, str]]:
        return frozenset((r, draw(st.sampled_from(own[r]))) for r in names if r in own)

    count = draw(st.integers(1, 4))
    objects = [f"o{k}" for k in range(draw(st.integers(count, 5)))]
    costs = st.integers(0, 20).map(float)
    needs = draw(st.lists(st.booleans(), min_size=count, max_size=count))
    primaries, supports = [], []
    for step in range(1, count + 1):
        for _ in range(draw(st.integers(1, 4))):
            robot = draw(st.sampled_from(robots))
            item = draw(st.sampled_from(objects))
            others = [r for r in robots if r != robot]
            partner = None
            if draw(st.booleans()):
                partner = draw(st.sampled_from(others))
            after = draw(st.sets(st.sampled_from(objects), max_size=1))
            if draw(st.integers(0, 3)) or item in after:
                after = set()
            primaries.append(
                PrimaryCandidate(
                    step,
                    robot,
                    item,
                    draw(st.integers(0, 2)),
                    draw(costs),
                    partner,
                    frozenset(after),
                    tools_of(robot, None if needs[step - 1] else partner),
                )
            )
        if needs[step - 1]:
            for pose in range(draw(st.integers(1, 3))):
                robot = draw(st.sampled_from(robots))
                supports.append(
                    SupportCandidate(step, robot, pose, draw(costs), tools_of(robot))
                )
    # Candidates are different ways: by two that are equal nothing could tell which one was taken.
    primaries = list(dict.fromkeys(primaries))
    pairs = [
        (p, s)
        for p, primary in enumerate(primaries)
        for s, support in enumerate(supports)
        if primary.step == support.step
    ]
    clashes = draw(st.sets(st.sampled_from(pairs), max_size=3)) if pairs else set()
    unlimited = draw(st.sets(st.sampled_from(objects), max_size=1))
    for primary in primaries:
        unlimited -= primary.after
    return AssignmentProblem(
        robots,
        tuple(f"step number {k}" for k in range(1, count + 1)),
        tuple(needs),
        tuple(primaries),
        tuple(supports),
        frozenset(clashes),
        frozenset(unlimited),
        draw(st.sampled_from([0.0, 0.3, 1.0, 5.0])),
        {robot: draw(st.sampled_from(tools)) for robot, tools in own.items()},
        {
            (robot, old, new): ways[old] + ways[new]
            for robot, tools in own.items()
            for old, new in permutations(tools, 2)
        },
        draw(st.booleans()),
    )


def every_plan(problem: AssignmentProblem) -> Iterator[TaskPlan]:
    """Yield all plans that obey the rules, written down anew from the paper."""
    ways: list[list[StepChoice]] = []
    for step, needs in enumerate(problem.needs_support, start=1):
        here = []
        for p, primary in enumerate(problem.primaries):
            if primary.step != step:
                continue
            if not needs:
                here.append(StepChoice(primary))
                continue
            for s, support in enumerate(problem.supports):
                if (
                    support.step == step
                    and support.robot != primary.robot
                    and primary.partner in (None, support.robot)
                    and (p, s) not in problem.incompatible
                ):
                    here.append(StepChoice(primary, support))
        ways.append(here)
    for choices in product(*ways):
        used: set[str] = set()
        for choice in choices:
            twice = choice.object in used and choice.object not in problem.unlimited
            if twice or not choice.primary.after <= used:
                break
            used.add(choice.object)
        else:
            yield TaskPlan(choices)


def plain(*primaries: PrimaryCandidate, **rest: Any) -> AssignmentProblem:
    """Return a problem of two robots in which no step needs a support."""
    count = max(item.step for item in primaries)
    names = tuple(f"step number {k}" for k in range(1, count + 1))
    problem = AssignmentProblem(ROBOTS[:2], names, (False,) * count, primaries)
    return replace(problem, **rest)


_AWL = frozenset({("bob", "awl")})
GIVEN_UP = plain(
    PrimaryCandidate(1, "ada", "o2", 0, 0.0),
    PrimaryCandidate(2, "ada", "o0", 0, 0.0, tools=_AWL),
    PrimaryCandidate(2, "ada", "o0", 0, 0.0),
    PrimaryCandidate(2, "ada", "o3", 0, 0.0),
    PrimaryCandidate(3, "ada", "o0", 0, 0.0),
    PrimaryCandidate(3, "bob", "o3", 0, 0.0, tools=_AWL),
    PrimaryCandidate(3, "ada", "o3", 0, 0.0, "bob", tools=_AWL),
    PrimaryCandidate(4, "ada", "o1", 0, 2.0),
    PrimaryCandidate(4, "ada", "o0", 0, 1.0),
    PrimaryCandidate(4, "ada", "o0", 0, 0.0, "bob"),
    needs_support=(True, False, False, False),
    supports=(SupportCandidate(1, "bob", 0, 0.0, _AWL),),
    balance=0.0,
    mounted={"bob": "awl"},
    changes={("bob", "awl", "bit"): 1.0, ("bob", "bit", "awl"): 1.0},
)
"""A program that HiGHS 1.15.1 gives up on while it presolves."""


def in_turns_for(cost: float) -> AssignmentProblem:
    """Return a problem of two steps that either robot does, the other one the second for a cost."""
    return plain(
        PrimaryCandidate(1, "ada", "o0", 0, 1.0),
        PrimaryCandidate(2, "ada", "o1", 0, 1.0),
        PrimaryCandidate(2, "bob", "o1", 0, 1.0 + cost),
        balance=1.0,
    )


@settings(max_examples=150, deadline=None)
@given(problems())
@example(GIVEN_UP)
# What turns may cost is told by the whole spread of what robots do, not by who does most.
@example(in_turns_for(0.7))
@example(in_turns_for(1.4))
def test_solver_finds_what_trying_everything_finds(problem: AssignmentProblem) -> None:
    plans = list(every_plan(problem))
    if not plans:
        with pytest.raises(InfeasibleStepError, match="step"):
            assign_steps(problem)
        return
    best = min(objective(problem, plan) for plan in plans)
    found = assign_steps(problem)
    assert plan_violations(problem, found) == []
    assert objective(problem, found) == pytest.approx(best, abs=1e-6)


@settings(max_examples=80, deadline=None)
@given(problems(), st.data())
def test_violations_and_alternatives_agree_with_all_plans(
    problem: AssignmentProblem, data: st.DataObject
) -> None:
    plans = list(every_plan(problem))
    if not plans:
        return
    plan = data.draw(st.sampled_from(plans))
    assert plan_violations(problem, plan) == []
    step = data.draw(st.integers(1, len(plan.choices)))
    expected = {
        other[step]
        for other in plans
        if other != plan
        and all(a == b or a.step == step for a, b in _pairs(other, plan))
    }
    offered = alternative_choices(problem, plan, step)
    assert set(offered) == expected
    for choice in offered:
        assert plan_violations(problem, plan.with_choice(choice)) == []


def _pairs(a: TaskPlan, b: TaskPlan) -> Iterator[tuple[StepChoice, StepChoice]]:
    return zip(a.choices, b.choices, strict=True)


def test_two_steps_that_compete_for_one_brick_are_named() -> None:
    problem = plain(
        PrimaryCandidate(1, "ada", "only", 0, 1.0),
        PrimaryCandidate(2, "bob", "only", 0, 1.0),
        balance=0.0,
    )
    with pytest.raises(InfeasibleStepError) as caught:
        assign_steps(problem)
    text = str(caught.value)
    assert "only by step" in text
    assert "step 1" in text
    assert "step 2" in text
    plan = assign_steps(replace(problem, unlimited=frozenset({"only"})))
    assert [c.object for c in plan.choices] == ["only", "only"]


def test_a_step_without_candidates_lists_the_reasons() -> None:
    problem = plain(
        PrimaryCandidate(1, "ada", "a", 0, 1.0),
        steps=("the first", "the second"),
        needs_support=(False, False),
        rejections=(
            Rejection(2, "ada picks b", "attach is out of reach"),
            Rejection(2, "bob picks b", "attach is out of reach"),
            Rejection(2, "ada picks c", "ada/tool and d overlap by 2.0 mm"),
        ),
    )
    with pytest.raises(InfeasibleStepError) as caught:
        assign_steps(problem)
    text = str(caught.value)
    assert "step 2 (the second)" in text
    assert "attach is out of reach: ada picks b, bob picks b" in text
    assert "overlap by 2.0 mm: ada picks c" in text


def test_a_brick_below_another_is_used_later() -> None:
    problem = plain(
        PrimaryCandidate(1, "ada", "lower", 0, 1.0, after=frozenset({"upper"})),
        PrimaryCandidate(1, "ada", "upper", 0, 9.0),
        PrimaryCandidate(2, "ada", "lower", 0, 1.0, after=frozenset({"upper"})),
        PrimaryCandidate(2, "ada", "upper", 0, 1.0),
        balance=0.0,
    )
    plan = assign_steps(problem)
    assert [c.object for c in plan.choices] == ["upper", "lower"]


def test_balance_makes_robots_take_turns() -> None:
    ways = product(range(1, 5), {"ada": 1.0, "bob": 1.5}.items())
    problem = plain(
        *(PrimaryCandidate(k, name, f"o{k}", 0, cost) for k, (name, cost) in ways)
    )
    turns = [c.robot for c in assign_steps(problem).choices]
    assert all(a != b for a, b in pairwise(turns))
    alone = assign_steps(replace(problem, balance=0.0))
    assert {c.robot for c in alone.choices} == {"ada"}


def test_same_problem_same_plan() -> None:
    ways = product((1, 2, 3), ROBOTS[:2], range(4))
    problem = plain(*(PrimaryCandidate(k, r, f"o{n}", 0, 1.0) for k, r, n in ways))
    assert len({assign_steps(problem) for _ in range(3)}) == 1


@settings(max_examples=80, deadline=None)
@given(problems(), st.data())
def test_one_more_robot_never_makes_a_plan_worse(
    problem: AssignmentProblem, data: st.DataObject
) -> None:
    """Worth of a step kept: whoever can do nothing changes nothing, any other only helps."""
    try:
        alone = assign_steps(problem)
    except InfeasibleStepError:
        return
    idle = replace(problem, robots=(*problem.robots, "dan"))
    assert objective(problem, assign_steps(idle)) == pytest.approx(
        objective(problem, alone)
    )
    choice = data.draw(st.sampled_from(alone.choices)).primary
    cost = float(data.draw(st.integers(0, 20)))
    extra = replace(
        choice, robot="dan", cost=cost, partner=None, tools=NO_TOOLS, after=frozenset()
    )
    more = replace(idle, primaries=(*problem.primaries, extra), balance=1.0)
    if more.balance_weight > 0.0:
        more = replace(more, balance=problem.balance_weight / more.balance_weight)
    better = assign_steps(more)
    assert objective(more, better) <= objective(more, alone) + 1e-6


@settings(max_examples=80, deadline=None)
@given(problems(), st.data())
def test_the_plans_of_a_crew_are_those_in_which_the_others_do_nothing(
    problem: AssignmentProblem, data: st.DataObject
) -> None:
    crew = data.draw(st.sets(st.sampled_from(problem.robots), min_size=1))
    theirs = problem.among(crew)
    assert set(every_plan(theirs)) == {
        plan
        for plan in every_plan(problem)
        if all(choice.robots <= crew for choice in plan.choices)
    }
    choices = list(step_choices(problem))
    for step in range(1, len(problem.steps) + 1):
        assert (theirs.lacking(step) is None) == any(
            choice.robots <= crew for choice in choices if choice.step == step
        )


def test_robots_take_turns_whoever_else_is_there() -> None:
    """An arm that can do one step of eight only leaves the others to take turns."""
    ways = [
        PrimaryCandidate(step, robot, f"{robot}{step}", 0, 1.0 + (robot == second))
        for step in range(1, 9)
        for robot, second in (("ada", "ada" if step % 4 in (0, 3) else "bob"),)
        for robot in ("ada", "bob")
    ]
    third = PrimaryCandidate(5, "cy", "cy5", 0, 100.0)
    problem = replace(plain(*ways, third), robots=ROBOTS)
    names = [choice.robot for choice in assign_steps(problem).choices]
    assert all(a != b for a, b in pairwise(names)), names


ARMS = ("left", "right")


def stacks_problem(seed: int, steps: int, stock: int, stack: int) -> AssignmentProblem:
    """Objects in stacks along a line between two robots; every third step needs a support."""
    rng = np.random.default_rng(seed)
    goal, base = rng.uniform(0.0, 1.0, steps), {"left": 0.0, "right": 1.0}
    source = np.repeat(rng.uniform(0.0, 1.0, stock), stack)[:stock]
    primaries: list[PrimaryCandidate] = []
    supports: list[SupportCandidate] = []
    clashing: list[tuple[int, int]] = []
    for step in range(1, steps + 1):
        for robot, x in base.items():
            supports.append(
                SupportCandidate(step, robot, 0, 1.0 + abs(goal[step - 1] - x))
            )
            for k in range(stock):
                far = abs(goal[step - 1] - x) + abs(source[k] - x)
                covered = (k + 1) % stack and k + 1 < stock
                after = frozenset({f"o{k + 1}"} if covered else ())
                cost = float(2.0 + 3.0 * far + rng.uniform(0.0, 0.2))
                item = PrimaryCandidate(step, robot, f"o{k}", 0, cost, None, after)
                if rng.uniform() < 0.1:
                    clashing.append((len(primaries), len(supports) - 1))
                primaries.append(item)
    return AssignmentProblem(
        ARMS,
        tuple(f"s{k}" for k in range(steps)),
        tuple(k % 3 == 2 for k in range(steps)),
        tuple(primaries),
        tuple(supports),
        frozenset(clashing),
    )


@pytest.mark.nightly
@pytest.mark.parametrize("stack", [1, 3])
@pytest.mark.parametrize("surplus", [0, 10])
@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(k, marks=pytest.mark.nightly) for k in (2, 3))]
)
def test_windows_cost_within_two_percent_of_the_whole(
    seed: int, surplus: int, stack: int
) -> None:
    problem = stacks_problem(seed, 26, 26 + surplus, stack)
    windows = solve_in_windows(problem, highs_solver._solved)
    whole = highs_solver._solved(problem)
    assert windows is not None
    assert whole is not None
    assert plan_violations(problem, windows) == plan_violations(problem, whole) == []
    least = objective(problem, whole)
    assert least - 1e-6 <= objective(problem, windows) <= 1.02 * least


@pytest.mark.nightly
def test_windows_take_what_a_whole_problem_offers() -> None:
    """The same problem gives the same plan, made of the problem's own candidates."""
    problem = stacks_problem(7, 40, 60, 4)
    first = solve_in_windows(problem, highs_solver._solved)
    assert first is not None
    assert plan_violations(problem, first) == []
    assert first == solve_in_windows(problem, highs_solver._solved)


def _last_needs_the_best(steps: int) -> AssignmentProblem:
    """Every step likes the object best that only the last one cannot do without."""
    primaries = [
        PrimaryCandidate(step, robot, f"o{k}", 0, 1.0 + k)
        for step in range(1, steps + 1)
        for robot in ARMS
        for k in range(steps)
        if step < steps or k == 0
    ]
    names = tuple(f"s{k}" for k in range(steps))
    return AssignmentProblem(ARMS, names, (False,) * steps, tuple(primaries))


def test_what_windows_cannot_do_the_whole_program_does(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem = _last_needs_the_best(40)
    assert solve_in_windows(problem, highs_solver._solved) is None
    monkeypatch.setattr(rolling_horizon, "MOST_CONTESTED", 0)
    plan = assign_steps(problem)
    assert plan_violations(problem, plan) == []
    assert plan[40].object == "o0"


def test_competition_is_named_as_before(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rolling_horizon, "MOST_CONTESTED", 0)
    problem = stacks_problem(0, 20, 19, 1)
    with pytest.raises(InfeasibleStepError, match="cannot be done along with"):
        assign_steps(problem)


def test_endless_supplies_are_assigned_as_a_whole() -> None:
    problem = stacks_problem(0, 60, 60, 1)
    names = frozenset(item.object for item in problem.primaries)
    assert needs_rolling_horizon(problem)
    assert not needs_rolling_horizon(replace(problem, unlimited=names))

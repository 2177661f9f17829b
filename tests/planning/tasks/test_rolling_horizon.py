"""Assignment window by window: plans that keep every rule, and cost hardly more than the whole."""

from dataclasses import replace

import numpy as np
import pytest

from planning.errors import InfeasibleStepError
from planning.tasks import highs_solver, rolling_horizon
from planning.tasks.assignment import (
    AssignmentProblem,
    PrimaryCandidate,
    SupportCandidate,
)
from planning.tasks.highs_solver import assign_steps
from planning.tasks.rolling_horizon import is_large, solve_in_windows
from tests.planning.tasks.plan_oracle import objective, plan_violations

ROBOTS = ("left", "right")


def stacks_problem(seed: int, steps: int, stock: int, stack: int) -> AssignmentProblem:
    """Objects in stacks along a line between two robots; every third step needs a support."""
    rng = np.random.default_rng(seed)
    goal, base = rng.uniform(0.0, 1.0, steps), {"left": 0.0, "right": 1.0}
    source = np.repeat(rng.uniform(0.0, 1.0, stock), stack)[:stock]
    primaries, supports, clashing = [], [], []
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
        ROBOTS,
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
        for robot in ROBOTS
        for k in range(steps)
        if step < steps or k == 0
    ]
    names = tuple(f"s{k}" for k in range(steps))
    return AssignmentProblem(ROBOTS, names, (False,) * steps, tuple(primaries))


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
    assert is_large(problem)
    assert not is_large(replace(problem, unlimited=names))

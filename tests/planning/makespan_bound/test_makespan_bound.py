"""The lower bound of the makespan against every choice, simulated clock by clock."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import planning.makespan_bound.makespan_bound as module
from planning.cell.motion_limits import MotionLimits
from planning.makespan_bound.choice_times import NEVER, ChoiceTimes, least_seconds
from planning.makespan_bound.makespan_bound import PricedSchedules, raised_bound
from planning.motion.speed import LimitedSpeed
from planning.tasks.assignment import PrimaryCandidate, StepChoice
from planning.transforms import Array
from tests.shipped_runs import ShippedRuns

ROBOTS = 3
HOMES = [np.array([float(k)]) for k in range(ROBOTS)]
OBJECTS = "pqrst"

xs = st.integers(0, 12).map(lambda n: 0.5 * n)


@dataclass(frozen=True)
class Job:
    """A step done by a robot on a line, with another one beside it as the object is placed."""

    step: int
    robot: int
    pick: float
    place: float
    pick_s: float
    place_s: float
    helper: int | None
    stand: float
    object: str


@st.composite
def jobs(draw: st.DrawFn) -> list[Job]:
    out = []
    for step in range(1, draw(st.integers(1, 4)) + 1):
        for _ in range(draw(st.integers(1, 3))):
            robot = draw(st.integers(0, ROBOTS - 1))
            helpers = st.sampled_from([k for k in range(ROBOTS) if k != robot])
            helper = draw(st.none() | helpers)
            pick, place, pick_s, place_s, stand = (draw(xs) for _ in range(5))
            about = step, robot, pick, place, pick_s, place_s, helper, stand
            out.append(Job(*about, draw(st.sampled_from(OBJECTS))))
    return out


def _simulated(chosen: Sequence[Job]) -> float:
    """Return when all robots are back at HOME."""
    at = {k: float(home[0]) for k, home in enumerate(HOMES)}
    clock = dict.fromkeys(at, 0.0)
    placed = 0.0
    for job in chosen:
        clock[job.robot] += abs(job.pick - at[job.robot]) + job.pick_s
        clock[job.robot] += abs(job.place - job.pick)
        begin = max(clock[job.robot], placed)
        if job.helper is not None:
            clock[job.helper] += abs(job.stand - at[job.helper])
            begin = max(begin, clock[job.helper])
            at[job.helper] = job.stand
            clock[job.helper] = begin + job.place_s
        placed = clock[job.robot] = begin + job.place_s
        at[job.robot] = job.place
    return max(clock[k] + abs(at[k] - float(HOMES[k][0])) for k in at)


def _times(job: Job) -> ChoiceTimes:
    """Return the same as a matrix."""
    matrix = np.where(np.eye(1 + ROBOTS, dtype=np.bool_), 0.0, NEVER)
    ready = np.full(1 + ROBOTS, NEVER)
    ready[0] = 0.0
    ready[1 + job.robot] = job.pick_s + abs(job.place - job.pick)
    start, end = {job.robot: job.pick}, {job.robot: job.place}
    if job.helper is not None:
        ready[1 + job.helper] = 0.0
        start[job.helper] = end[job.helper] = job.stand
        matrix[1 + job.helper] = ready + job.place_s
    matrix[0] = matrix[1 + job.robot] = ready + job.place_s
    choice = StepChoice(PrimaryCandidate(job.step, str(job.robot), job.object, 0, 0.0))
    at = [{k: np.array([x]) for k, x in ends.items()} for ends in (start, end)]
    return ChoiceTimes(choice, matrix, *at)


def _seconds(_robot: int, apart: Array) -> Array:
    return np.asarray(np.abs(apart).sum(axis=-1))


def _schedules(found: list[Job]) -> PricedSchedules:
    return PricedSchedules([_times(job) for job in found], HOMES, _seconds)


def _bound(found: list[Job], unlimited: str = OBJECTS) -> float:
    return raised_bound(_schedules(found), frozenset(unlimited))


def _makespans(found: list[Job], *, once: bool = False) -> list[float]:
    steps = sorted({job.step for job in found})
    every = product(*([job for job in found if job.step == s] for s in steps))
    return [
        _simulated(chosen)
        for chosen in every
        if not once or len({job.object for job in chosen}) == len(chosen)
    ]


@given(jobs(), st.lists(st.floats(0.0, 9.0), min_size=5, max_size=5))
@settings(max_examples=40, deadline=None)
def test_a_bound_holds_for_all_prices(found: list[Job], prices: list[float]) -> None:
    schedules, given_prices = _schedules(found), np.array(prices)
    bound, uses = schedules.shortest(given_prices[: len(schedules.objects)], 2)
    assert uses.sum() == len({job.step for job in found})
    assert all(bound <= plan + 1e-6 for plan in _makespans(found, once=True))


@given(jobs())
@settings(max_examples=15, deadline=None)
def test_prices_raise_the_bound_up_to_plans_that_use_objects_once(
    found: list[Job],
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_ROUNDS", 9)
        bound = _bound(found, unlimited="")
    assert bound >= _bound(found) - 1e-6
    assert all(bound <= plan + 1e-6 for plan in _makespans(found, once=True))


def test_a_scarce_object_raises_the_bound() -> None:
    # The object beside HOME can be used in one of the two steps only.
    found = [
        Job(step, 0, at, 0.0, 0.0, 1.0, None, 0.0, name)
        for step in (1, 2)
        for name, at in (("p", 0.0), ("q", 5.0))
    ]
    assert _bound(found) == pytest.approx(2.0)
    assert 6.0 < _bound(found, unlimited="q") <= min(_makespans(found, once=True))


@given(jobs())
@settings(max_examples=40, deadline=None)
def test_the_bound_is_the_least_makespan_of_any_choice(found: list[Job]) -> None:
    assert _bound(found) == pytest.approx(min(_makespans(found)), abs=1e-6)


@given(jobs())
@settings(max_examples=40, deadline=None)
def test_merged_labels_keep_the_bound_valid(found: list[Job]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_MOST_LABELS", 2)
        patch.setattr(module, "_MOST_ALIKE", 1)
        bound = _bound(found)
    assert 0.0 <= bound <= min(_makespans(found)) + 1e-6


def test_no_motion_within_limits_is_faster_than_its_bound() -> None:
    limits = MotionLimits(np.array([2.0, 1.0]), np.array([5.0, 8.0]), np.full(2, 80.0))
    travel = np.random.default_rng(0).uniform(-2.0, 2.0, (20, 2))
    travel *= np.geomspace(1e-3, 1.0, 20)[:, None]
    speed, turning = LimitedSpeed(limits), np.ones(2, dtype=np.bool_)
    least = least_seconds(speed, turning, travel)
    assert np.all(least > 0.0)
    assert np.all(least <= speed.durations(travel))
    assert least_seconds(speed, turning, travel + 2.0 * np.pi) == pytest.approx(least)


@pytest.mark.nightly
@pytest.mark.parametrize(
    "name",
    [
        "lego/cliff",
        "lego/stairs",
        "lego/faucet",
        "assembly/gearbox",
        "assembly/gluing",
        "multi_arm/assembly",
        "multi_arm/tray",
    ],
)
def test_no_plan_of_a_shipped_scenario_is_below_its_bound(
    name: str, shipped: ShippedRuns
) -> None:
    plan = shipped(name).planned
    assert plan.makespan_bound_s is not None
    assert 0.0 < plan.makespan_bound_s <= plan.makespan_s

"""Predicted makespans against longest paths in Python, and the search against trying every assignment."""

from collections import defaultdict
from collections.abc import Iterator
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from planning.assignment_search.operations import list_operations
from planning.assignment_search.prediction_tables import PredictionModel, build_model
from planning.assignment_search.rollout import predict_makespan
from planning.assignment_search.search import anneal, list_neighbours
from planning.makespan_bound.makespan_bound import makespan_bound_s
from planning.motion.full_turns import without_turns
from planning.tasks.assembly import Assembly
from planning.tasks.assignment import TaskPlan, step_choices
from planning.tasks.found_assignment import FoundAssignment
from planning.transforms import Array, Indices
from scheduling.graph.plan_files import plan_sha256
from scheduling.planned_motions import PlannedMotions
from tests.twin.planning.facing_arms import FACING_ARMS
from tests.twin.written import loaded
from twin.host.progress import StageWatch
from twin.planning.pipeline import plan_motions
from twin.trial.planning import plan_scenario

SCENARIO = (
    FACING_ARMS
    + """\
  stock:
    - {name: left_a, brick: 2x4, at: [2, 30, 1]}
    - {name: left_b, brick: 2x4, at: [2, 30, 2]}
    - {name: right_a, brick: 2x4, at: [44, 30, 1]}
    - {name: right_b, brick: 2x4, at: [40, 30, 1]}
  steps:
    - {brick: 2x4, at: [23, 15, 1]}
    - {brick: 2x4, at: [23, 25, 1]}
    - {brick: 2x4, at: [23, 15, 2]}
"""
)


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> PlannedMotions:
    folder = tmp_path_factory.mktemp("three")
    return plan_motions(loaded(folder, SCENARIO), folder, StageWatch())


@pytest.fixture(scope="module")
def model(first: PlannedMotions) -> PredictionModel:
    work = _work(first)
    choices = list(step_choices(work.problem))
    return build_model(first.cell, work, first.task_plan, choices, first.settings)


def _work(first: PlannedMotions) -> Assembly:
    assert first.work is not None
    return first.work


def _of_steps(model: PredictionModel) -> list[list[int]]:
    """Return the numbers of the choices of each step."""
    steps: dict[int, list[int]] = defaultdict(list)
    for k, choice in enumerate(model.choices):
        steps[choice.step].append(k)
    return [steps[step] for step in sorted(steps)]


def _numbers(*chosen: int) -> Indices:
    return np.array(chosen, dtype=np.int64)


def _valid(model: PredictionModel) -> Iterator[Indices]:
    """Yield every assignment that uses each object once, and none before what lies on it."""
    for chosen in product(*_of_steps(model)):
        used: list[str] = []
        for k in chosen:
            choice = model.choices[k]
            if choice.object in used or not choice.primary.after <= set(used):
                break
            used.append(choice.object)
        else:
            yield _numbers(*chosen)


def _longest_path(first: PlannedMotions, plan: TaskPlan) -> float:
    """Return the makespan where no robot is ever in another's way [s]."""
    work, cell, settings = _work(first), first.cell, first.settings
    at = {robot.name: robot.home for robot in cell.robots}
    clock = dict.fromkeys(at, 0.0)
    placed = 0.0

    def seconds(robot: str, start: Array, end: Array) -> float:
        turning = ~cell.robot(robot).model.chain.prismatic
        travel = without_turns(end - start, turning)
        return settings.speeds[robot].duration(np.zeros_like(travel), travel)

    for choice in plan.choices:
        done: list[float] = []
        tasks = work.expand(plan, choice.step, 0)
        for item in list_operations(cell, tasks, settings):
            begin = clock[item.robot]
            begin += seconds(item.robot, at[item.robot], item.path[0])
            begin = max([begin, *(done[k] for k in item.after)])
            if item.kind in ("place-down", "place-up"):
                begin = max(begin, placed)
                placed = begin + item.seconds
            done.append(begin + item.seconds)
            clock[item.robot], at[item.robot] = done[-1], item.path[-1]
    return max(
        clock[robot.name] + seconds(robot.name, at[robot.name], robot.home)
        for robot in cell.robots
    )


def test_no_assignment_is_below_the_bound_of_the_makespan(
    first: PlannedMotions, model: PredictionModel
) -> None:
    work = _work(first)
    bound = makespan_bound_s(first.cell, work, first.task_plan, first.settings)
    assert bound is not None
    every = [_numbers(*chosen) for chosen in product(*_of_steps(model))]
    repeated, once = (
        min(predict_makespan(model, chosen, conflicts=False) for chosen in found)
        for found in (every, _valid(model))
    )
    # Prices raise the bound from that of plans which use objects several times.
    assert repeated < once
    assert repeated - 1e-6 <= bound <= once + 1e-6


def test_prediction_without_conflicts_is_the_longest_path(
    first: PlannedMotions, model: PredictionModel
) -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        chosen = _numbers(*(rng.choice(found) for found in _of_steps(model)))
        plan = TaskPlan(tuple(model.choices[k] for k in chosen))
        predicted = predict_makespan(model, chosen, conflicts=False)
        assert predicted == pytest.approx(_longest_path(first, plan), abs=1e-9)
        whole = predict_makespan(model, chosen)
        assert whole >= predicted - 1e-9
        assert predict_makespan(model, chosen, most=whole) == whole
        assert predict_makespan(model, chosen, most=whole - 1e-6) == np.inf


def test_bounds_of_volumes_are_tight(model: PredictionModel) -> None:
    volumes = model.volumes
    first, ends, radius, box = (
        volumes.first,
        volumes.ends,
        volumes.radius,
        volumes.box,
    )
    for k in range(len(box)):
        own = slice(first[k], first[k + 1])
        thick = radius[own, None, None]
        assert box[k, :3] == pytest.approx((ends[own] - thick).min(axis=(0, 1)))
        assert box[k, 3:] == pytest.approx((ends[own] + thick).max(axis=(0, 1)))


def test_search_finds_the_best_of_all_assignments(
    first: PlannedMotions, model: PredictionModel
) -> None:
    problem = _work(first).problem
    number = {choice: k for k, choice in enumerate(model.choices)}
    start = _numbers(*(number[choice] for choice in first.task_plan.choices))
    least = min(predict_makespan(model, chosen) for chosen in _valid(model))
    neighbours = list_neighbours(model, problem)
    tries = [anneal(model, neighbours, start, 20_000, seed) for seed in range(5)]
    found, best = min(tries, key=lambda found: found[0])
    assert found == pytest.approx(least, abs=1e-9)
    assert predict_makespan(model, best) == pytest.approx(found, abs=1e-9)


def test_a_search_makes_this_plan_no_longer(tmp_path: Path) -> None:
    text = SCENARIO + "planning: {shortcut_candidates: 30, %s}\n"
    paper, search, again = (
        plan_scenario(loaded(tmp_path, text % how))
        for how in ("assignment: paper", *2 * ["assignment_moves: 700"])
    )
    assert search.makespan_s <= paper.makespan_s + 1e-6
    assert paper.search is None
    gain = search.search
    assert gain is not None
    assert gain.moves == 700
    assert gain.predicted_s <= gain.predicted_start_s
    assert gain == again.search
    assert plan_sha256(search.tpg) == plan_sha256(again.tpg)


@pytest.mark.parametrize(("predicted_s", "rates"), [(50.0, True), (99.5, False)])
def test_what_only_the_prediction_promises_is_not_taken(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    model: PredictionModel,
    predicted_s: float,
    rates: bool,
) -> None:
    longest = max(_valid(model), key=partial(predict_makespan, model))
    slow = TaskPlan(tuple(model.choices[k] for k in longest))
    found = FoundAssignment(((predicted_s, slow),), 100.0, 1)
    module = "planning.assignment_search.search.search_assignments"
    monkeypatch.setattr(module, lambda *_: found)
    text = SCENARIO + "planning: {shortcut_candidates: 30}\n"
    search = plan_scenario(loaded(tmp_path, text))
    gain = search.search
    assert gain is not None
    assert not gain.taken
    assert (gain.rated_s is not None) == rates
    paper = plan_motions(loaded(tmp_path, text), tmp_path, StageWatch())
    assert search.motions.task_plan == paper.task_plan

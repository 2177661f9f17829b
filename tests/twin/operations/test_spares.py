"""Spare ones come to the place of parts and bricks that are lost, and of products that are not made whole."""

from __future__ import annotations

import json
import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import twin
from benchmarks.operate import audited
from planning.lego.bricks.brick_world import station_of
from planning.tasks.task import TaskKind
from tests.twin.operations.operated import (
    CLIFF,
    FEW,
    STACK,
    at_the_end,
    gone,
    lost,
    operated,
    operated_by_program,
    planned,
    require_own_contacts,
    require_resumed,
    require_safe,
)
from twin.operations.operation import Operation, operate
from twin.operations.replicated.hindsight import Hindsight
from twin.trial.loaded_scenario import load
from twin.trial.plan_result import PlanResult
from twin.trial.planning import plan_scenario
from twin.trial.simulation import scenario_execution

MAGAZINE = Path(__file__).parents[3] / "scenarios" / "assembly" / "magazine.yaml"
GOALS, PINS = 4, 7


IN_TWO_LAYERS = ", ".join(
    f"{{xyz_m: [{x}, 0.26, {z}]}}" for z in (0.06, 0.12) for x in (-0.1, 0.05)
)


@pytest.fixture(
    scope="module", params=["beside", pytest.param("above", marks=pytest.mark.nightly)]
)
def file(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """Four goals, beside or above each other, and seven pins in two rows."""
    before, goals = MAGAZINE.read_text("utf-8").split("       goals: ", 1)
    line, after = goals.split("\n", 1)
    line = line.replace("counts: [6, 2]", "counts: [2, 2]")
    if request.param == "above":
        line = f"[{IN_TWO_LAYERS}]}}"
    before = before.replace("counts: [6, 2]", "counts: [4, 2]")
    before = before.replace("count: 12", f"count: {PINS}")
    out = tmp_path_factory.mktemp("spares") / "magazine.yaml"
    out.write_text(f"{before}       goals: {line}\n{after}", "utf-8")
    return out


@pytest.fixture(scope="module")
def plan(file: Path) -> PlanResult:
    return planned(file)


def filled(done: Operation, plan: PlanResult) -> int:
    """Return how many goals have a pin each, and no goal two."""
    state = at_the_end(done)
    goals = list(plan.motions.assembly.goals.values())
    assert len(goals) == GOALS
    pins = [at.pose for name, at in state.items() if name.startswith("pin")]
    there = [sum(np.allclose(pin, goal, atol=1e-6) for pin in pins) for goal in goals]
    assert max(there) <= 1
    return sum(there)


@settings(max_examples=2, deadline=None)
@given(seed=st.integers(0, 10_000), rate=st.sampled_from([0.2, 0.3]))
def test_a_lost_pin_is_replaced_while_there_are_others(
    plan: PlanResult, seed: int, rate: float
) -> None:
    done, _ = operated(plan, seed, **lost(rate))
    require_safe(done.tpg)
    tried = [t.object for t in done.tpg.tasks if t.kind == TaskKind.FAILED]
    beside = len({goal[2, 3] for goal in plan.motions.assembly.goals.values()}) == 1
    # What failed was lost, or was tried in vain: each time one pin less at most.
    if beside and PINS - len(set(tried)) >= GOALS:
        assert all("times" in why for why in done.given_up.values())
    assert filled(done, plan) == GOALS - len(done.given_up)


SURE = {"failures.pick": {"probability": 0.3, "retries": 0, "loses": 1.0}}


def test_what_would_be_lost_can_be_known_beforehand(plan: PlanResult) -> None:
    done, _ = operated(plan, 1, **SURE)
    assert any(task.kind == TaskKind.FAILED for task in done.tpg.tasks)
    assert not done.given_up
    case = plan.scenario.varied(SURE)
    model = scenario_execution(case.sections, case.folder)
    knew = Hindsight(case.sections, plan.motions, plan.tpg, model).makespan_ns(done)
    assert knew is not None
    assert knew < 1.5 * done.record.makespan_ns


def test_it_is_audited_and_what_is_left_knows_the_spares_that_were_used(
    file: Path, tmp_path: Path
) -> None:
    run = twin.operate(
        load(file).varied({**FEW, **SURE, "seed": 1}),
        out=tmp_path / "run",
        recording=False,
    )
    assert run.outcome == "completed"
    assert run.summary["audit"]["violations"] == []
    lost_ones = {t.object for t in run.tpg.tasks if t.kind == TaskKind.FAILED}
    assert lost_ones
    left = twin.plan(world=f"{run.files}@{0.8 * run.makespan_s}")
    require_safe(left.tpg)
    placed = {t.object for t in run.tpg.tasks if t.kind == "place-down"}
    assert {t.object for t in left.tpg.tasks if t.kind == "pick"} <= placed


@pytest.fixture(scope="module")
def fed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The cliff of bricks from feeding stations, one of each kind for each arm."""
    text = re.sub(r"    - \{name: \w+_2x4_[b-f].*\n", "", CLIFF.read_text("utf-8"))
    stock = r"(name: (?:left|right)_2x\w+, brick: \w+, at: \[.*?\])"
    text, stations = re.subn(stock, r"\1, station: true", text)
    assert stations == 6
    out = tmp_path_factory.mktemp("fed") / "cliff.yaml"
    out.write_text(text, "utf-8")
    return out


@pytest.fixture(scope="module")
def fed_stack(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The stack of bricks from one feeding station for each arm."""
    text = re.sub(r"    - \{name: \w+_[b-e], .*\n", "", STACK)
    text, stations = re.subn(
        r"(_a, brick: 2x4, at: \[.*?\])", r"\1, station: true", text
    )
    assert stations == 2
    out = tmp_path_factory.mktemp("fed") / "stack.yaml"
    out.write_text(text, "utf-8")
    return out


@pytest.fixture(scope="module")
def presented(fed_stack: Path) -> PlanResult:
    return planned(fed_stack)


@pytest.fixture(scope="module")
def shortened(fed: Path) -> PlanResult:
    return plan_scenario(load(fed), keep=True)


def spoiled(chance: float, loses: float, wrong: float, slips: float) -> dict[str, Any]:
    """Return the values by which bricks are lost, wrong or slip in the hand, and are tried ever again."""
    item = {"probability": chance, "retries": 0, "loses": loses}
    return {
        "failures.pick": {**item, "wrong": wrong},
        "failures.place-down": {**item, "slips": slips},
        "recovery.again": 100,
    }


def require_presented(plan: PlanResult, done: Operation) -> None:
    """Check that all is built, and of bricks that a station presented one after another."""
    assert done.record.outcome == "completed", done.given_up
    require_safe(done.tpg)
    require_own_contacts(done.tpg)
    assert audited(done, plan.scenario) == []
    names = [item.name for item in done.tpg.cell.objects]
    assert len(names) == len(set(names))
    places = {t.step: t.object for t in done.tpg.tasks if t.kind.startswith("place")}
    assert len(places) == len(plan.motions.task_plan.choices)
    assert gone(done).isdisjoint(places.values())
    assert plan.motions.work is not None
    stations = plan.motions.work.problem.unlimited
    for station in stations:
        own = {name for name in names if station_of(name, stations) == station}
        used = [
            (n, int(n.rpartition(".")[2]))
            for n in own & {*gone(done), *places.values()}
        ]
        numbers = sorted(number for _, number in used)
        assert numbers == [*range(1, len(numbers) + 1)]


@settings(max_examples=2, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    chance=st.sampled_from([0.15, 0.3]),
    loses=st.sampled_from([0.5, 1.0]),
    wrong=st.sampled_from([0.0, 0.4]),
    slips=st.sampled_from([0.0, 0.3]),
)
def test_a_station_presents_another_brick_for_one_that_is_lost(
    presented: PlanResult,
    seed: int,
    chance: float,
    loses: float,
    wrong: float,
    slips: float,
) -> None:
    done, _ = operated(presented, seed, **spoiled(chance, loses, wrong, slips))
    require_presented(presented, done)


def test_what_a_station_presents_may_fail_by_the_name_of_the_station(
    presented: PlanResult,
) -> None:
    item = {"probability": 0.0, "retries": 0, "loses": 1.0}
    fails = {"failures.pick": {**item, "parts": {"left_a": 0.7}}}
    done, _ = operated(presented, 1, **fails, **{"recovery.again": 100})
    require_presented(presented, done)
    tried = [t.object for t in done.tpg.tasks if t.kind == TaskKind.FAILED]
    assert len(tried) > 1
    assert {str(name).rpartition(".")[0] for name in tried} == {"left_a"}


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("seed", "loses", "wrong", "slips"),
    [
        (26, 0.5, 0.4, 0.0),  # who supports has gone aside
        (35, 1.0, 0.4, 0.3),  # a hand is emptied later than planned
    ],
)
def test_half_of_all_that_a_station_presents_may_be_lost(
    shortened: PlanResult, seed: int, loses: float, wrong: float, slips: float
) -> None:
    done, _ = operated(shortened, seed, **spoiled(0.5, loses, wrong, slips))
    require_presented(shortened, done)


@pytest.mark.nightly
def test_who_is_out_does_nothing_under_the_number_of_another_task(
    shortened: PlanResult,
) -> None:
    outages = [{"robot": "left", "at_s": 178.0}]
    done, _ = operated(shortened, 54, **spoiled(0.15, 0.5, 0.4, 0.0), outages=outages)
    require_safe(done.tpg)
    assert audited(done, shortened.scenario) == []


def test_what_would_rest_on_a_brick_that_no_station_has_presented_is_given_up(
    fed: Path,
) -> None:
    """Though nobody has planned the steps after it by then."""
    plan = planned(fed, window={"steps": 1, "least": 0})
    never = {"probability": 1.0, "retries": 0}
    done, _ = operated(plan, 0, **{"failures.place-down": never, "recovery.again": 0})
    assert sorted(done.given_up) == list(range(1, 12))
    assert done.given_up[1].endswith("failed 1 times")
    whys = [done.given_up[step] for step in range(2, 12)]
    assert all(why.startswith("it rests on step ") for why in whys)


def test_what_is_left_goes_on_with_what_a_station_presents_by_then(
    fed_stack: Path, tmp_path: Path
) -> None:
    case = load(fed_stack).varied({**FEW, **spoiled(0.3, 1.0, 0.0, 0.0), "seed": 2})
    run = twin.operate(case, out=tmp_path / "run", recording=False, audit=False)
    assert run.outcome == "completed"
    assert any(task.kind == TaskKind.FAILED for task in run.tpg.tasks)
    left = twin.plan(world=f"{run.files}@{0.7 * run.makespan_s}")
    require_own_contacts(left.tpg)
    require_safe(left.tpg)
    picks = {t.object for t in left.tpg.tasks if t.kind == "pick"}
    done = {t.object for t in run.tpg.tasks if t.kind == "place-down"}
    assert picks
    assert picks - done <= {
        t.object for t in run.tpg.tasks if t.kind == TaskKind.FAILED
    }


WANTED, SPARE, STEPS = 2, 2, 5
"""Products of a mill and a washer, those for which there are blanks besides, and steps of each."""

TENDED = {
    "assembly.products": {"count": WANTED, "spare": SPARE, "leave_s": 5},
    "machines": {},
}


@pytest.fixture(scope="module")
def line() -> PlanResult:
    return planned(MAGAZINE.with_name("machine_tending.yaml"), **TENDED)


def made(done: Operation) -> set[int]:
    """Return the products that are whole, and check that of no other one more is told than was done."""
    tasks = {t.step for t in done.tpg.tasks if t.kind in ("place-down", "washing")}
    scrapped, dropped = (
        {(step - 1) // STEPS + 1 for step in some}
        for some in (done.given_up, done.dropped)
    )
    numbers = {(step - 1) // STEPS + 1 for step in tasks} - scrapped - dropped
    for number in numbers:
        steps = range((number - 1) * STEPS + 1, number * STEPS + 1)
        assert {step for step in steps if step in tasks} >= {
            steps[0],
            steps[3],
            steps[4],
        }
    assert {*done.scrapped} == scrapped
    return numbers


@settings(max_examples=2, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    rate=st.sampled_from([0.1, 0.3]),
    more=st.integers(0, 1),
)
@pytest.mark.nightly
def test_a_product_is_made_in_place_of_one_that_is_not_whole(
    line: PlanResult, seed: int, rate: float, more: int
) -> None:
    changes = {"changes": [{"at_s": 20.0, "more": more}]} if more else {}
    done, _ = operated(line, seed, **lost(rate), **changes)
    require_safe(done.tpg)
    whole = made(done)
    # As many are begun as are wanted and not made, and no more than there are.
    begun = min(WANTED + more + len(done.scrapped), WANTED + SPARE)
    assert {*whole, *done.scrapped} == set(range(1, begun + 1))
    assert (done.record.outcome == "completed") == (len(whole) >= WANTED + more)


def test_what_is_planned_from_can_be_sent_to_another_process(line: PlanResult) -> None:
    sent = pickle.loads(pickle.dumps(line.motions))
    assert sent.ahead is not None
    for work in (sent.work, sent.ahead.first(STEPS)):
        assert work is not None
        assert pickle.loads(pickle.dumps(work)).problem == work.problem


@pytest.mark.nightly
def test_a_study_in_processes_of_its_own_makes_as_many(
    line: PlanResult, tmp_path: Path
) -> None:
    case = line.scenario.varied(lost(0.3))
    twin.study(case, replications=3, operate=True, out=tmp_path / "study")
    table = pq.read_table(tmp_path / "study" / "replications.parquet")
    model = scenario_execution(case.sections, case.folder)
    for k, makespan_s in enumerate(table["makespan_s"].to_pylist()):
        about = case.sections, line.motions, line.tpg, model
        done = operate(*about, seed=case.sections.seed, replication=k)
        assert makespan_s == pytest.approx(done.record.makespan_s)


def test_products_that_nobody_needs_are_not_made(line: PlanResult) -> None:
    done, _ = operated(line, 0)
    assert made(done) == {1, 2}
    assert done.record.outcome == "completed"
    assert not done.versions
    more, _ = operated(
        line, 0, changes=[{"at_s": 1.0, "more": 1}, {"at_s": 9.0, "more": 1}]
    )
    assert made(more) == {1, 2, 3, 4}
    assert [v.cause.partition(";")[0] for v in more.versions] == [
        "1 more product wanted"
    ] * 2
    other, _ = operated(line, 0, changes=[{"at_s": 1.0, "drop": [6], "more": 1}])
    assert made(other) == {1, 3}
    assert other.record.outcome == "completed"


def test_what_a_machine_spoils_is_replaced_until_nothing_is_left(
    line: PlanResult,
) -> None:
    spoils = {"failures.washing": {"probability": 1.0, "retries": 0, "then": "scrap"}}
    done, _ = operated(line, 3, **spoils)
    assert done.scrapped == (1, 2, 3, 4)
    assert made(done) == set()
    assert done.record.outcome == "failed"


@pytest.mark.nightly
def test_the_program_tells_which_products_were_replaced(tmp_path: Path) -> None:
    file, out = MAGAZINE.with_name("machine_tending.yaml"), tmp_path / "run"
    products = {"count": 2, "spare": 2, "due": [90, 150], "leave_s": 5}
    settings = {
        "assembly.products": json.dumps(products),
        "execution.failures.pick": "{probability: 0.2, retries: 0, loses: 1}",
    }
    sets = [word for k, v in settings.items() for word in ("--set", f"{k}={v}")]
    printed, summary = operated_by_program(file, out, "--seed", "1", *sets)
    assert "products scrapped" in printed
    assert summary["outcome"] == "completed"
    assert summary["line"]["products"] == 2
    assert summary["operation"]["scrapped"]
    require_resumed(out)
    left = twin.plan(world=f"{out}@{0.9 * summary['makespan_s']}")
    require_safe(left.tpg)
    first = max(summary["operation"]["scrapped"]) * STEPS + 1
    assert all(t.step >= first for t in left.tpg.tasks if t.kind == "place-down")

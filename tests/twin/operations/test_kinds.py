"""Kinds of failures: what slips in the hand or is a wrong part is of no use, and a process says what follows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from benchmarks.operate import audited
from planning.tasks.task import TaskKind
from tests.twin.operations.operated import (
    at_the_end,
    gone,
    operated,
    planned,
    require_safe,
    tasks_of,
)
from tests.twin.operations.random_operations import plan_of
from twin.operations.operation import Operation
from twin.trial.loaded_scenario import load
from twin.trial.plan_result import PlanResult
from twin.trial.planning import plan_scenario

SCENARIOS = Path(__file__).parents[3] / "scenarios"
TENDING = SCENARIOS / "assembly" / "machine_tending.yaml"


def fails(plan: PlanResult, skill: str, **values: Any) -> tuple[Operation, list[str]]:
    """Operate until something fails for good, and return what became of it."""
    own = {"probability": 0.3, "retries": 0, "loses": 1.0, **values}
    for seed in range(30):
        done, events = operated(plan, seed, **{f"failures.{skill}": own})
        words = [e.detail for e in events if e.kind == "recovered"]
        if len(words) == 1:
            require_safe(done.tpg)
            return done, words
    raise AssertionError("nothing failed once")


def test_what_has_slipped_is_brought_to_a_person(plan: PlanResult) -> None:
    done, words = fails(plan, "place-down", slips=1.0)
    (tried,) = tasks_of(done, TaskKind.FAILED)
    assert words == [
        f"step {tried.step} is begun anew: {tried.object} has slipped in the hand"
    ]
    # It stays in the hand, and leaves it at HOME.
    assert tried.handlings == ()
    (taken,) = tasks_of(done, TaskKind.TAKEN_OUT)
    assert (taken.robot, taken.object) == (tried.robot, tried.object)
    placed = {t.step: t.object for t in done.tpg.tasks if t.kind == "place-down"}
    assert sorted(placed) == [1, 2, 3, 4]
    assert placed[tried.step] != tried.object
    assert done.record.outcome == "completed"


def test_a_wrong_part_stays_where_it_lies(plan: PlanResult) -> None:
    done, words = fails(plan, "pick", wrong=1.0)
    (tried,) = tasks_of(done, TaskKind.FAILED)
    assert words == [f"step {tried.step} is begun anew: {tried.object} is a wrong part"]
    state = at_the_end(done)
    start = done.tpg.cell.object(str(tried.object)).start
    assert (state[str(tried.object)].pose == start).all()
    assert not gone(done)
    assert tried.object not in {t.object for t in done.tpg.tasks if t.kind == "pick"}
    assert done.record.outcome == "completed"


@pytest.fixture(scope="module")
def inspected(tmp_path_factory: pytest.TempPathFactory) -> PlanResult:
    """Two products that are inspected where they were milled."""
    text = TENDING.read_text()
    for old, new in (
        (
            "    mill: {door: {size_m: [0.44, 0.44, 0.012], pose: {xyz_m: [0, 0.62, 0.807]}}}",
            "    mill: {}\n    gauge: {}",
        ),
        (
            "    washing: {",
            "    inspecting: {duration: {kind: fixed, value_s: 3}, machine: gauge}\n    washing: {",
        ),
        (
            "    - {process: milling, at: {part: blank}}\n",
            "    - {process: milling, at: {part: blank}}\n    - {process: inspecting, at: {part: blank}}\n",
        ),
        ("count: 24, places: {counts: [2, 2]", "count: 2, places: {counts: [1, 1]"),
        ("    mill: {breakdowns: {mtbf_s: 1800, mttr_s: 120}}\n", "    mill: {}\n"),
        ("tools/gripper.urdf", f"{TENDING.parent}/tools/gripper.urdf"),
    ):
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    file = tmp_path_factory.mktemp("inspected") / "inspected.yaml"
    file.write_text(text)
    return planned(file)


def test_what_is_rejected_is_worked_at_again(inspected: PlanResult) -> None:
    done, (words,) = fails(inspected, "inspecting", loses=0.0, then="rework")
    (tried,) = tasks_of(done, TaskKind.FAILED)
    name = tried.object
    assert words == f"milling {name} is done again, and then inspecting {name}"
    order = [t.kind for t in done.tpg.tasks if t.object == name]
    assert order.count("milling") == 2
    assert order.count("inspecting") == 1
    # The second inspection comes after the second time that it was milled.
    ends = {
        task: end_ns
        for chain, own in zip(done.tpg.chains, done.record.end_ns, strict=True)
        for task, end_ns in zip(chain.task.tolist(), own.tolist(), strict=True)
    }
    milled = [
        ends[t.index] for t in done.tpg.tasks if (t.kind, t.object) == ("milling", name)
    ]
    seen = [
        ends[t.index]
        for t in done.tpg.tasks
        if (t.kind, t.object) == ("inspecting", name)
    ]
    assert max(milled) < min(seen)
    assert done.record.outcome == "completed"


def works_of(done: Operation) -> list[tuple[int, str, str]]:
    """Return step, kind and robot of what was done to the cover besides placing it, in order."""
    kinds = "clean", "screw", "inspect", TaskKind.FAILED
    begins = {
        task: start
        for chain, own in zip(done.tpg.chains, done.record.start_ns, strict=True)
        for task, start in zip(
            chain.task.tolist()[::-1], own.tolist()[::-1], strict=True
        )
    }
    tasks = sorted(tasks_of(done, *kinds), key=lambda t: begins[t.index])
    return [(t.step, t.kind, t.robot) for t in tasks]


def test_all_that_was_done_to_a_part_since_it_came_is_done_again() -> None:
    """Two arms work at it; what was done before it came to its place is not done again."""
    plan = plan_of("reworked")
    done, (words,) = fails(plan, "inspect", loses=0.0, then="rework")
    assert words == (
        "screw cover/hole1, screw cover/hole2 and clean cover/middle are done again,"
        " and then inspect cover/middle"
    )
    before = [(3, "screw", "left"), (4, "screw", "right"), (5, "clean", "right")]
    first, failed, last = (
        (1, "clean", "left"),
        (6, TaskKind.FAILED, "left"),
        (6, "inspect", "left"),
    )
    assert works_of(done) == [first, *before, failed, *before, last]
    assert done.record.outcome == "completed"


def test_what_is_given_up_is_not_done_again_with_the_rest() -> None:
    """The second screw always fails, and is given up: the inspection waits for none of it."""
    plan, never = plan_of("reworked"), {"probability": 1.0, "retries": 0}
    values = {
        "failures.inspect": {**never, "then": "rework"},
        "failures.clean": {"probability": 0.0},
        "failures.screw": never,
        "recovery.again": 0,
    }
    done, events = operated(plan, 1, **values)
    assert done.given_up.keys() >= {3, 4, 6}
    words = [e.detail for e in events if e.kind == "recovered"]
    assert not [said for said in words if "screw" in said and "done again" in said]
    assert events[-1].detail == done.record.outcome == "failed"


def test_what_is_rejected_is_scrapped(inspected: PlanResult) -> None:
    done, (words,) = fails(inspected, "inspecting", loses=0.0, then="scrap")
    (tried,) = tasks_of(done, TaskKind.FAILED)
    assert words == f"step {tried.step} is given up: {tried.object} is scrapped"
    assert done.given_up[tried.step] == f"{tried.object} is scrapped"
    (taken,) = tasks_of(done, TaskKind.TAKEN_OUT)
    assert taken.object == tried.object


@pytest.mark.nightly
def test_what_a_step_that_is_begun_anew_waited_for_is_no_reason_to_give_up() -> None:
    plan = plan_scenario(load(TENDING.parents[1] / "lego" / "cliff.yaml"), keep=True)
    own = {"probability": 0.15, "retries": 1, "loses": 0.5}
    kinds = {
        "failures.place-down": {**own, "slips": 0.6},
        "failures.pick": {**own, "wrong": 0.6},
    }
    more = {"failures.place-up": own, "failures.handover": own}
    done, _ = operated(plan, 0, **kinds, **more)
    assert not [words for words in done.given_up.values() if "depends on" in words]
    require_safe(done.tpg)


@pytest.mark.nightly
def test_a_robot_leaves_the_rack_of_its_tools_as_it_would_have() -> None:
    """It has taken the driver there for a screw of a cover that is lost meanwhile."""
    plan = plan_scenario(load(SCENARIOS / "assembly" / "gearbox.yaml"), keep=True)
    fails = {"probability": 0.25, "retries": 0, "loses": 1.0, "slips": 0.5}
    done, _ = operated(plan, 24, **{"failures.place-down": fails})
    taken = [t.index for t in done.tpg.tasks if t.kind == TaskKind.TAKE_TOOL]
    assert done.given_up
    assert taken
    ways = {t.index: t.label for t in done.tpg.tasks if t.robot == "right"}
    assert ways[taken[-1] + 1].startswith("out of the rack")
    require_safe(done.tpg)
    assert audited(done, plan.scenario) == []


@pytest.mark.nightly
def test_who_keeps_hold_goes_nowhere_while_what_it_waits_for_is_done_again() -> None:
    plan = plan_scenario(load(SCENARIOS / "assembly" / "truss.yaml"), keep=True)
    fails = {"failures.weld": {"probability": 0.3, "retries": 0}}
    done, _ = operated(plan, 0, **fails, **{"recovery.again": 9})
    assert done.versions
    require_safe(done.tpg)
    assert audited(done, plan.scenario) == []

"""Orders that change while robots work, and parts that are late, which nobody knows before somebody comes for them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from planning.errors import RequestError
from planning.tasks.task import TaskKind
from scheduling.motion_times import is_driven
from tests.twin.operations.operated import (
    STACK,
    came_at,
    gone,
    lost,
    operated,
    operated_by_program,
    placed,
    require_kept,
    require_resumed,
    require_safe,
    tasks_of,
)
from tests.twin.program import invoke
from twin.operations.operation import Operation
from twin.trial.loaded_scenario import load
from twin.trial.plan_result import PlanResult
from twin.trial.planning import plan_scenario


def dropping(at_s: float, *steps: int) -> dict[str, Any]:
    return {"changes": [{"at_s": at_s, "drop": list(steps)}]}


def first_skill_ns(done: Operation) -> Mapping[int, int]:
    """Return when a skill of each step that was begun was first started [ns]."""
    found: dict[int, int] = {}
    for chain, start in zip(done.tpg.chains, done.record.start_ns, strict=True):
        for node, task in enumerate(chain.task.tolist()):
            if chain.skill[node]:
                step = done.tpg.tasks[task].step
                found[step] = min(found.get(step, 10**18), int(start[node]))
    return found


@pytest.mark.nightly
@settings(max_examples=10, deadline=None)
@given(data=st.data())
def test_what_is_wanted_is_done_and_the_rest_is_said(
    plan: PlanResult, data: st.DataObject
) -> None:
    steps = data.draw(st.lists(st.integers(1, 4), min_size=1, max_size=3, unique=True))
    at_s = data.draw(st.sampled_from([0.0, 2.0, 8.0, 14.0, 22.0, 33.0, 44.0]))
    seed = data.draw(st.integers(0, 10_000))
    fails = data.draw(st.sampled_from([0.0, 0.2]))
    chances = lost(fails) if fails else {}
    patient = {"recovery.again": 100}
    done, events = operated(plan, seed, **dropping(at_s, *steps), **chances, **patient)
    require_kept(done)
    # Ten bricks are there for four steps; a draw that loses nearly all of them proves nothing.
    assume(sum(e.detail == "leaves the cell" for e in events) < 7)
    assert not done.given_up
    assert done.record.outcome == "completed"
    # Every step is done or said to be dropped, and none is both.
    assert sorted([*placed(done), *done.dropped]) == [1, 2, 3, 4]
    for step, why in done.dropped.items():
        if why == "it is not wanted any more":
            assert step in steps
        else:
            assert int(why.removeprefix("it rests on step ")) in done.dropped
    # What had not begun when the order changed was never begun, nor what rests on it.
    begun = first_skill_ns(done)
    for step in steps:
        if begun.get(step, 10**18) > (at_s + 1.0) * 1e9:
            assert step in done.dropped
    if done.dropped:
        assert placed(done) == list(range(1, min(done.dropped)))
    # Nothing stays in a hand.
    last: dict[str, str | None] = {}
    for handling in done.tpg.handlings:
        last[handling.object] = handling.holder
    assert {t.object for t in tasks_of(done, TaskKind.TAKEN_OUT)} <= gone(done)


def test_steps_that_have_begun_are_brought_to_an_end(plan: PlanResult) -> None:
    _, events = operated(plan, 0)
    picked = next(e for e in events if e.kind == "attached" and e.object == "left_a")
    done, others = operated(plan, 0, **dropping(picked.t_ns / 1e9 + 5.0, 2))
    assert done.dropped == {}
    assert others == events


def test_what_is_in_a_hand_and_rests_on_what_is_dropped_is_taken_out(
    plan: PlanResult,
) -> None:
    # The brick of step 1 is missed; while that is thought about, the one of step 2 is picked.
    late = {"late": [{"part": "right_a", "at_s": 1000.0}]}
    slow = {"recovery.planning_s": 20.0}
    done, events = operated(plan, 0, **late, **slow, **dropping(5.0, 1))
    assert [e.object for e in events if e.kind == "attached"] == ["left_a"]
    (out,) = tasks_of(done, TaskKind.TAKEN_OUT)
    assert out.object == "left_a"
    assert [e.object for e in events if e.detail == "leaves the cell"] == ["left_a"]
    assert done.record.outcome == "completed"
    assert done.dropped[1] == "it is not wanted any more"
    assert set(done.dropped.values()) == {done.dropped[1], "it rests on step 1"}
    assert placed(done) == []
    require_kept(done)


@pytest.mark.nightly
def test_the_program_says_what_is_dropped(tmp_path: Path) -> None:
    file = tmp_path / "stack.yaml"
    section = "  changes: [{at_s: 10, drop: [3]}]\n"
    file.write_text(STACK + "execution:\n" + section)
    out = tmp_path / "run"
    options = ("--failures", "0.2", "--seed", "4")
    printed, summary = operated_by_program(file, out, *options)
    assert "dropped" in printed
    assert summary["outcome"] == "completed"
    why = {"3": "it is not wanted any more", "4": "it rests on step 3"}
    assert summary["operation"]["dropped"] == why
    assert "not wanted any more: steps 3" in require_resumed(out, '"replanned"', 3)


NAMES = tuple(f"{side}_{letter}" for side in ("left", "right") for letter in "abcde")


def late(**times: float) -> dict[str, Any]:
    return {"late": [{"part": name, "at_s": at} for name, at in times.items()]}


def picked_at(done: Operation) -> dict[str, int]:
    """Return when the picks of what was picked began, by object [ns]."""
    found: dict[str, int] = {}
    for k, chain in enumerate(done.tpg.chains):
        for node, index in enumerate(chain.task.tolist()):
            task = done.tpg.tasks[index]
            if task.kind == "pick" and task.object is not None:
                found.setdefault(task.object, int(done.record.start_ns[k][node]))
    return found


@pytest.mark.nightly
@settings(max_examples=8, deadline=None)
@given(data=st.data())
def test_whatever_is_late_is_waited_for_or_replaced(
    plan: PlanResult, data: st.DataObject
) -> None:
    names = data.draw(st.lists(st.sampled_from(NAMES), min_size=1, unique=True))
    times = {name: data.draw(st.sampled_from([0.0, 1.3, 9.0, 70.0])) for name in names}
    seed = data.draw(st.integers(0, 10_000))
    fails = data.draw(st.sampled_from([0.0, 0.1]))
    chances = lost(fails, 1) if fails else {}
    patient = {"recovery.again": 100}
    done, events = operated(plan, seed, **late(**times), **chances, **patient)
    require_kept(done)
    # Nothing is given up: there are more bricks than can be lost.
    assert done.record.outcome == "completed", done.given_up
    came = came_at(events)
    for name, at in times.items():
        if name in came:
            assert came[name] == round(at * 1e9) or at == 0.0
        else:
            assert done.record.makespan_ns <= at * 1e9
            assert done.tpg.cell.object(name).later
    # Nobody takes what is not there, and what is missed has not come.
    picked = picked_at(done)
    assert all(picked[name] >= came[name] for name in times.keys() & picked.keys())
    for event in events:
        if event.detail.endswith("is not there"):
            name = event.detail.split()[-4]
            assert event.t_ns < times[name] * 1e9
    assert placed(done) == [1, 2, 3, 4]


def test_another_brick_is_taken_and_the_late_one_is_let_be(plan: PlanResult) -> None:
    first = next(t.object for t in plan.tpg.tasks if t.kind == "pick")
    done, events = operated(plan, 0, **late(**{str(first): 40.0}))
    (missed,) = [e for e in events if e.kind == "failed"]
    assert missed.detail == f"pick {first}: {first} is not there"
    assert missed.node >= 0
    (swap,) = [e for e in events if e.kind == "replanned"]
    assert f"{first} is not there" in swap.detail
    (cured,) = [e for e in events if e.kind == "recovered"]
    assert cured.detail == f"step 1 is begun anew: {first} has not come yet"
    assert first not in picked_at(done)
    (tried,) = tasks_of(done, TaskKind.FAILED)
    assert tried.object == first
    (brought,) = tasks_of(done, TaskKind.BROUGHT)
    assert brought.object == first
    assert came_at(events) == {first: 40_000_000_000}
    require_kept(done)


@pytest.mark.nightly
def test_where_there_is_no_other_one_it_is_waited_for(plan: PlanResult) -> None:
    done, events = operated(plan, 0, **late(**dict.fromkeys(NAMES, 200.0)))
    assert done.record.outcome == "completed"
    assert min(picked_at(done).values()) >= 200_000_000_000
    # None is missed twice: who knows that it has not come waits for it.
    missed = [e.detail for e in events if e.detail.endswith("is not there")]
    assert len(missed) == len(set(missed))
    require_kept(done)


def test_what_comes_after_the_end_is_no_part_of_the_run(plan: PlanResult) -> None:
    never = late(left_e=1e5)
    done, events = operated(plan, 0, **never)
    same, others = operated(plan, 0)
    assert events == others
    assert done.record.makespan_ns == same.record.makespan_ns
    assert [c.robot for c in done.tpg.chains] == [c.robot for c in same.tpg.chains]
    assert done.tpg.cell.object("left_e").later
    require_safe(done.tpg)


def test_what_nobody_picks_cannot_be_late(plan: PlanResult) -> None:
    motions = plan.motions
    assert motions.work is not None
    problem = motions.work.problem
    few = problem.of_candidates(lambda item: item.object != "left_e", lambda _: True)
    less = replace(motions, work=replace(motions.work, problem=few))
    with pytest.raises(RequestError, match="no step picks it"):
        operated(replace(plan, made_of=less), 0, **late(left_e=5.0))


@pytest.fixture(scope="module")
def limited(tmp_path_factory: pytest.TempPathFactory) -> PlanResult:
    file = tmp_path_factory.mktemp("limited") / "stack.yaml"
    few = "shortcut_candidates: 30, speed_model: limits, assignment: paper"
    file.write_text(STACK.replace("shortcut_candidates: 30", few))
    return plan_scenario(load(file), keep=True)


@pytest.mark.parametrize("seed", [1, 2])
def test_robots_within_limits_find_nothing_either(
    limited: PlanResult, seed: int
) -> None:
    assert is_driven(limited.tpg)
    times = late(right_a=20.0, left_a=3.0, left_b=200.0)
    slow = {"jitter": {"kind": "uniform", "low_s": 0, "high_s": 0.02}}
    chances = {**lost(0.2, 1), **slow, "latency_s": 0.05}
    done, events = operated(limited, seed, **times, **chances)
    assert done.record.outcome == "completed"
    assert sum(e.detail.endswith("is not there") for e in events) == 3
    require_kept(done)
    for k, stood in enumerate(done.record.stood_ns):
        took = done.record.end_ns[k] - done.record.start_ns[k]
        assert (stood >= 0).all()
        assert (took >= stood).all()
        assert done.record.wait_ns(k) >= 0


@pytest.mark.nightly
def test_the_program_operates_draws_audits_and_resumes(tmp_path: Path) -> None:
    file = tmp_path / "stack.yaml"
    section = "  late: [{part: right_a, at_s: 30}, {part: left_a, at_s: 30}]\n"
    file.write_text(STACK + "execution:\n" + section)
    out = tmp_path / "run"
    operated_by_program(file, out, "--failures", "0.1", "--seed", "3")
    followed = invoke("follow", out, out / "events.jsonl", "--every", 1000, code=0)
    assert "nothing forbidden" in followed.stdout
    assert "is not there" in require_resumed(out, "comes up", 1)

"""A person is asked before something is given up; everybody else goes on meanwhile."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

import twin
from planning.tasks.task import Handling
from tests.twin.operations.operated import (
    STACK,
    came_at,
    operated,
    operated_by_program,
    placed,
    require_kept,
    require_resumed,
)
from tests.twin.program import invoke
from tests.twin.scenarios.test_processes import SCENARIO as COVER
from twin.cli import app
from twin.operations.person import PERSON, Person, Question
from twin.scenario.sections.execution import AskSection
from twin.trial.loaded_scenario import load
from twin.trial.plan_result import PlanResult


def asking(
    picks: float = 0.75, *, helps: float = 1.0, times: int = 50, again: int = 100
) -> dict[str, Any]:
    """Return settings in which so many picks lose their brick that there are none left."""
    return {
        "failures.pick": {"probability": picks, "retries": 1, "loses": 1.0},
        "recovery.again": again,
        "recovery.ask": {"answer_s": 30.0, "helps": helps, "times": times},
    }


@pytest.mark.nightly
@settings(max_examples=5, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    helps=st.sampled_from([0.5, 1.0]),
    times=st.sampled_from([1, 50]),
    late=st.booleans(),
    planning_s=st.sampled_from([1.0, 25.0]),
)
def test_whatever_is_lost_somebody_brings_another_one(
    plan: PlanResult,
    seed: int,
    helps: float,
    times: int,
    planning_s: float,
    *,
    late: bool,
) -> None:
    more: dict[str, Any] = {"recovery.planning_s": planning_s}
    if late:
        more["late"] = [{"part": name, "at_s": 50.0} for name in ("left_a", "right_b")]
    done, events = operated(plan, seed, **asking(helps=helps, times=times), **more)
    require_kept(done)
    assert sorted([*placed(done), *done.given_up]) == [1, 2, 3, 4]
    if helps == 1.0 and times == 50:
        assert done.record.outcome == "completed", done.given_up
    for step in range(1, 5):
        assert sum(ask.step == step for ask in done.asks) <= times
    # What is brought was never there before, and lies where what was lost lay.
    cell, came = done.tpg.cell, came_at(events)
    brought = {t.object: t for t in done.tpg.tasks if t.robot == PERSON}
    fresh = {ask.fresh: ask for ask in done.asks if ask.helps}
    assert brought.keys() <= fresh.keys()
    for name in brought:
        item = cell.object(str(name))
        old = cell.object(str(fresh[name].object))
        assert item.later
        assert (item.kind, item.start.tolist()) == (old.kind, old.start.tolist())
        assert name in came
    left = [e.object for e in events if e.detail == "leaves the cell"]
    assert sorted(left) == sorted(
        h.object for h in done.tpg.handlings if h.holder == Handling.GONE
    )
    for ask in fresh.values():
        if ask.fresh in came:
            lost_at = [
                e.t_ns
                for e in events
                if e.object == ask.object and e.detail == "leaves the cell"
            ]
            assert lost_at
            assert came[str(ask.fresh)] >= lost_at[0] + 30_000_000_000


def seed_that_asks(plan: PlanResult, **values: Any) -> int:
    for seed in range(50):
        done, _ = operated(plan, seed, **values)
        if done.asks:
            return seed
    raise AssertionError("nobody is ever asked")


def test_who_is_asked_in_vain_changes_nothing_but_what_is_said(
    plan: PlanResult,
) -> None:
    never = asking(helps=0.0, times=1)
    seed = seed_that_asks(plan, **never)
    done, events = operated(plan, seed, **never)
    assert done.record.outcome == "failed"
    assert any(
        why.endswith("a person could not help") for why in done.given_up.values()
    )
    assert all(t.robot != PERSON for t in done.tpg.tasks)
    said = [e for e in events if "a person was asked: cannot help" in e.detail]
    assert said
    assert {e.kind for e in said} == {"replanned"}
    silent, _ = operated(plan, seed, **{**never, "recovery.ask": None})
    assert silent.given_up.keys() == done.given_up.keys()
    assert silent.record.makespan_ns == done.record.makespan_ns


def test_what_fails_again_and_again_is_seen_to(plan: PlanResult) -> None:
    often = asking(again=0)
    often["failures.pick"] = {"probability": 0.6, "retries": 0}
    seed = seed_that_asks(plan, **often)
    done, _ = operated(plan, seed, **often)
    seen = [t for t in done.tpg.tasks if t.robot == PERSON]
    assert seen
    assert all(t.object is None and t.label.startswith("see to step") for t in seen)
    assert done.record.outcome == "completed", done.given_up
    require_kept(done)
    # The step goes on when the person is done, and not before.
    waits = {(a, b) for a, b in done.tpg.dependencies.tolist()}
    for own in seen:
        picks = [t for t in done.tpg.tasks if t.kind == "pick" and t.step == own.step]
        assert any((own.index, t.index) in waits for t in picks)


def test_answers_are_named_so_they_are_the_same_again(plan: PlanResult) -> None:
    one, two = (operated(plan, 3, **asking(helps=0.5)) for _ in range(2))
    assert one[1] == two[1]
    assert one[0].asks == two[0].asks
    person = Person(AskSection(helps=0.5), 7)
    first = person.asked((), Question(3, 0, "", "a", "?"), ("a", "a.1"))
    assert first is not None
    assert first.fresh == "a.2"
    # What another step was asked for makes no difference.
    other = person.asked((), Question(2, 0, "pick", "b", "?"))
    assert other is not None
    again = person.asked((other,), Question(3, 0, "", "a", "?"), ("a", "a.1"))
    assert again == first
    second = person.asked((first,), Question(3, 1, "", "a", "?"), ("a", "a.1"))
    assert second is not None
    assert second.fresh == "a.3"
    question = Question(1, 0, "pick", "c", "?")
    people = [Person(AskSection(helps=0.3), seed) for seed in range(400)]
    helped = [person.asked((), question) for person in people]
    assert 80 <= sum(ask is not None and ask.helps for ask in helped) <= 160


@pytest.mark.nightly
def test_the_program_asks_audits_and_resumes(plan: PlanResult, tmp_path: Path) -> None:
    settings = asking()
    seed = seed_that_asks(plan, **settings)
    file, out = tmp_path / "stack.yaml", tmp_path / "run"
    failures = "  failures: {pick: {probability: 0.75, retries: 1, loses: 1.0}}\n"
    few = "  recovery: {shortcuts: 4, again: 100, ask: {answer_s: 30, times: 50}}\n"
    file.write_text(STACK + "execution:\n" + failures + few)
    _, summary = operated_by_program(file, out, "--seed", seed)
    assert "lacks an object" in summary["operation"]["asked"][0]["question"]
    require_resumed(out, "comes up")


@pytest.mark.nightly
def test_processes_are_done_at_what_was_brought(tmp_path: Path) -> None:
    file = tmp_path / "cover.yaml"
    file.write_text(COVER)
    lost = {
        "failures.pick": {"probability": 0.0, "loses": 1.0, "parts": {"cover": 0.7}}
    }
    case = load(file).varied({**asking(), **lost})
    run = twin.operate(case, out=tmp_path / "run", recording=False)
    assert run.outcome == "completed"
    assert run.summary["operation"]["asked"]
    assert run.summary["audit"]["violations"] == []


@pytest.mark.nightly
def test_somebody_answers_at_the_keyboard(plan: PlanResult, tmp_path: Path) -> None:
    settings = {**asking(), "recovery.ask": None}
    seed = seed_that_asks(plan, **asking())
    silent, _ = operated(plan, seed, **settings)
    assert silent.asks == ()
    file, out = tmp_path / "stack.yaml", tmp_path / "run"
    failures = "  failures: {pick: {probability: 0.75, retries: 1, loses: 1.0}}\n"
    file.write_text(STACK + f"execution:\n{failures}  recovery: {{again: 100}}\n")
    words = ["operate", str(file), "--seed", str(seed), "--no-recording", "--ask"]
    # Whatever is asked for is refused, each question once.
    refused = CliRunner().invoke(app, [*words, "--out", str(out)], input="n\n" * 20)
    assert refused.exit_code == 1, refused.output
    summary = json.loads((out / "summary.json").read_text())
    asked = summary["operation"]["asked"]
    assert refused.output.count("[y/N]") == len(asked) >= 1
    assert all(item["answer"].startswith("cannot help") for item in asked)
    given_up = {int(step) for step in summary["operation"]["given_up"]}
    assert given_up == silent.given_up.keys()
    (out / "summary.json").unlink()
    again = invoke("resume", out)
    assert again.exit_code != 0
    assert "may answer otherwise" in " ".join(again.output.split())
    # One who helps is asked in the same words.
    other = tmp_path / "other"
    helped = CliRunner().invoke(app, [*words, "--out", str(other)], input="y\n" * 90)
    assert "lacks an object" in helped.output
    summary = json.loads((other / "summary.json").read_text())
    assert summary["operation"]["asked"][0]["question"] == asked[0]["question"]
    assert "will bring" in summary["operation"]["asked"][0]["answer"]
    assert summary["audit"]["violations"] == []


@pytest.mark.nightly
def test_who_breaks_off_at_a_question_breaks_off_the_run(
    plan: PlanResult, tmp_path: Path
) -> None:
    seed = seed_that_asks(plan, **asking())
    file, out = tmp_path / "stack.yaml", tmp_path / "run"
    failures = "  failures: {pick: {probability: 0.75, retries: 1, loses: 1.0}}\n"
    file.write_text(STACK + f"execution:\n{failures}  recovery: {{again: 100}}\n")
    words = ["operate", str(file), "--seed", str(seed), "--no-recording", "--ask"]
    broken = CliRunner().invoke(app, [*words, "--out", str(out)], input="")
    assert broken.exit_code != 0
    assert '"aborted"' in (out / "events.jsonl").read_text().splitlines()[-1]

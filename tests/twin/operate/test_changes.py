"""Orders that change while robots work: what is not wanted any more is not begun."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.tasks.task import GONE, TAKEN_OUT
from tests.twin.operate.operated import STACK, lost, operated, stack
from tests.twin.operate.test_late import require_kept
from tests.twin.program import invoke
from twin.operate.operation import Operation
from twin.trial.plan_result import PlanResult


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> PlanResult:
    return stack(tmp_path_factory.mktemp("stack"))


def dropping(at_s: float, *steps: int) -> dict[str, Any]:
    return {"changes": [{"at_s": at_s, "drop": list(steps)}]}


def placed(done: Operation) -> list[int]:
    return sorted(t.step for t in done.tpg.tasks if t.kind == "place-down")


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
    done, _ = operated(plan, seed, **dropping(at_s, *steps), **chances, **patient)
    require_kept(done)
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
    out = {t.object for t in done.tpg.tasks if t.kind == TAKEN_OUT}
    gone = {h.object for h in done.tpg.handlings if h.holder == GONE}
    assert out <= gone


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
    (out,) = [t for t in done.tpg.tasks if t.kind == TAKEN_OUT]
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
    options = ("--failures", "0.2", "--seed", "4", "--no-recording")
    printed = invoke("operate", file, *options, "--out", out, code=0).stdout
    assert "dropped" in printed
    summary = json.loads((out / "summary.json").read_text())
    assert summary["outcome"] == "completed"
    assert summary["audit"]["violations"] == []
    why = {"3": "it is not wanted any more", "4": "it rests on step 3"}
    assert summary["operation"]["dropped"] == why
    invoke("verify", out, code=0)
    log = (out / "events.jsonl").read_text().splitlines(keepends=True)
    assert any("not wanted any more: steps 3" in line for line in log)
    swap = next(k for k, line in enumerate(log) if '"replanned"' in line)
    (out / "events.jsonl").write_text("".join(log[: swap + 3]))
    (out / "summary.json").unlink()
    invoke("resume", out, code=0)
    assert (out / "events.jsonl").read_text() == "".join(log)
    assert json.loads((out / "summary.json").read_text())["operation"]["dropped"] == why

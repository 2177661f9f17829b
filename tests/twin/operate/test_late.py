"""Parts that are late: nobody knows, whoever comes finds nothing, and nothing is given up for it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.errors import RequestError
from planning.tasks.task import BROUGHT, FAILED
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.invariant import check_invariant
from scheduling.motion_times import is_driven
from scheduling.verification.verify import verify_plan
from tests.twin.operate.operated import STACK, lost, operated, stack
from tests.twin.program import invoke
from twin.operate.operation import Operation
from twin.run.events import Event
from twin.trial.loaded_scenario import load
from twin.trial.plan_result import PlanResult
from twin.trial.planning import plan_to_operate

NAMES = tuple(f"{side}_{letter}" for side in ("left", "right") for letter in "abcde")


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> PlanResult:
    return stack(tmp_path_factory.mktemp("stack"))


def late(**times: float) -> dict[str, Any]:
    return {"late": [{"part": name, "at_s": at} for name, at in times.items()]}


def require_kept(done: Operation) -> None:
    """Require that the union keeps its invariant, and that what was executed keeps its edges."""
    check_invariant(DerivedTpg(done.tpg))
    assert verify_plan(done.tpg).problems == ()
    for k, u, i, v in done.tpg.edges.tolist():
        assert done.record.end_ns[k][u] <= done.record.start_ns[i][v]


def picked_at(done: Operation) -> dict[str, int]:
    """Return when the picks of what was picked began, by object [ns]."""
    found = {}
    for k, chain in enumerate(done.tpg.chains):
        for node, index in enumerate(chain.task.tolist()):
            task = done.tpg.tasks[index]
            if task.kind == "pick" and task.object is not None:
                found.setdefault(task.object, int(done.record.start_ns[k][node]))
    return found


def came_at(events: list[Event]) -> dict[str, int]:
    return {e.object: e.t_ns for e in events if e.detail.startswith("comes up")}


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
    done, events = operated(plan, seed, **late(**times), **chances)
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
    placed = sorted(t.step for t in done.tpg.tasks if t.kind == "place-down")
    assert placed == [1, 2, 3, 4]


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
    (tried,) = [t for t in done.tpg.tasks if t.kind == FAILED]
    assert tried.object == first
    (brought,) = [t for t in done.tpg.tasks if t.kind == BROUGHT]
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
    assert verify_plan(done.tpg).problems == ()


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
    few = "shortcut_candidates: 30, speed_model: limits"
    file.write_text(STACK.replace("shortcut_candidates: 30", few))
    return plan_to_operate(load(file))


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
    invoke("operate", file, "--failures", "0.1", "--seed", "3", "--out", out, code=0)
    summary = json.loads((out / "summary.json").read_text())
    assert summary["audit"]["violations"] == []
    invoke("verify", out, code=0)
    followed = invoke("follow", out, out / "events.jsonl", "--every", 1000, code=0)
    assert "nothing forbidden" in followed.stdout
    log = (out / "events.jsonl").read_text().splitlines(keepends=True)
    assert any("is not there" in line for line in log)
    coming = next(k for k, line in enumerate(log) if "comes up" in line)
    (out / "events.jsonl").write_text("".join(log[: coming + 1]) + log[coming + 1][:9])
    (out / "summary.json").unlink()
    invoke("resume", out, code=0)
    assert (out / "events.jsonl").read_text() == "".join(log)
    again = json.loads((out / "summary.json").read_text())
    assert again["audit"]["violations"] == []
    assert again["makespan_s"] == summary["makespan_s"]

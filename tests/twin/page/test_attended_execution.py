"""Orders and answers of somebody beside a live cell, without a page."""

import time
from typing import Any

import pytest

from tests.twin.operations.operated import stack
from tests.twin.page.beside import ASKS, Beside, failing_first_pick, robot
from twin.follow.state import FollowedRun
from twin.operations.operation import Operation
from twin.operations.recovery import Recovery
from twin.page.panel import Order
from twin.runs.events import Event
from twin.trial.plan_result import PlanResult

pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> PlanResult:
    return stack(tmp_path_factory.mktemp("stack"))


def placed(done: Operation) -> dict[int, str]:
    return {t.step: t.robot for t in done.tpg.tasks if t.kind == "place-down"}


def kinds(events: list[Event], name: str, *wanted: str) -> list[tuple[str, str]]:
    return [(e.kind, e.detail) for e in events if e.robot == name and e.kind in wanted]


def test_a_robot_that_is_held_stands_until_it_is_to_go_on(plan: PlanResult) -> None:
    run = Beside(plan).begin()
    run.until(
        lambda s: robot(s, "left").done > 20 and robot(s, "left").mode == "moving"
    )
    run.panel.orders.put(Order("hold", "left"))
    held = run.until(lambda s: robot(s, "left").mode == "held")
    time.sleep(0.6)
    shown = run.until(lambda s: s.t_s > held.t_s + 10.0)
    assert robot(shown, "left").done == robot(held, "left").done
    assert robot(shown, "left").held
    # The other robot may have finished meanwhile.
    own = [n.kind for n in shown.notices if n.robot == "left"]
    assert own[:2] == ["stopped", "ordered"]
    run.panel.orders.put(Order("go on", "left"))
    done = run.done()
    assert done.record.outcome == "completed"
    assert placed(done).keys() == {1, 2, 3, 4}
    told = kinds(run.events, "left", "ordered", "stopped", "resumed")
    assert told == [
        ("ordered", "hold"),
        ("stopped", "held"),
        ("ordered", "go on"),
        ("resumed", ""),
    ]
    events = [e for e in run.events if e.robot == "left"]
    first, last = (
        next(k for k, e in enumerate(events) if e.kind == kind)
        for kind in ("stopped", "resumed")
    )
    assert not [e for e in events[first:last] if e.kind in ("started", "completed")]
    assert run.panel.shown is not None
    assert run.panel.shown.outcome == "completed"
    assert run.panel.shown.steps_done == 4


def test_all_are_held_by_one_order_which_is_on_the_disk_before(
    plan: PlanResult,
) -> None:
    run = Beside(plan).begin()
    run.panel.orders.put(Order("hold"))
    run.until(lambda s: all(own.mode == "held" for own in s.robots))
    at = next(k for k, e in enumerate(run.events) if e.kind == "ordered")
    assert at + 1 in run.written
    # What is held already is not held again.
    run.panel.orders.put(Order("hold"))
    run.panel.orders.put(Order("go on"))
    assert run.done().record.outcome == "completed"
    assert kinds(run.events, "", "ordered") == [
        ("ordered", "hold"),
        ("ordered", "go on"),
    ]


@pytest.mark.parametrize("action", ["yes", "no"])
def test_time_goes_on_while_a_question_is_open(plan: PlanResult, action: str) -> None:
    arms = {"left": failing_first_pick(40.0)}
    run = Beside(plan, arms=arms, values=ASKS).begin()
    asked = run.until(lambda s: s.question != "")
    assert "will you see to step" in asked.question
    run.panel.orders.put(Order("no", "", asked.asked + 1))
    later = run.until(
        lambda s: (
            s.t_s > asked.t_s + 15.0
            and robot(s, "right").done > robot(asked, "right").done
        )
    )
    assert later.question == asked.question
    assert robot(later, "left").waits == "waits for an answer"
    run.panel.orders.put(Order(action, "", asked.asked))  # type: ignore[arg-type]
    done = run.done()
    step = int(asked.question.rstrip("?").split()[-1])
    assert kinds(run.events, "", "asked", "ordered") == [
        ("asked", asked.question),
        ("ordered", f"{action}: {asked.question}"),
    ]
    if action == "yes":
        assert done.record.outcome == "completed"
        assert placed(done).keys() == {1, 2, 3, 4}
    else:
        assert step in done.given_up
        assert run.panel.shown is not None
        assert run.panel.shown.given_up == done.given_up
    assert [(ask.step, ask.helps) for ask in done.asks] == [(step, action == "yes")]


def test_who_holds_while_something_is_planned_is_obeyed_at_once(
    plan: PlanResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    planned = Recovery.recover

    def slowly(self: Recovery, *about: Any) -> Any:
        time.sleep(2.0)
        return planned(self, *about)

    monkeypatch.setattr(Recovery, "recover", slowly)
    run = Beside(plan, arms={"left": failing_first_pick(40.0)}).begin()
    run.until(lambda s: s.planning)
    run.panel.orders.put(Order("hold"))
    run.until(lambda s: all(own.mode == "held" for own in s.robots))
    run.panel.orders.put(Order("go on"))
    assert run.done().record.outcome == "completed"
    when = {e.kind: e.t_ns for e in reversed(run.events)}
    assert when["failed"] < when["ordered"] < when["stopped"] < when["replanned"]


def test_a_robot_that_is_taken_out_does_no_more_at_once(plan: PlanResult) -> None:
    run = Beside(plan).begin()
    shown = run.until(lambda s: robot(s, "left").done > 20 and s.t_s > 8.0)
    run.panel.orders.put(Order("out", "left"))
    run.panel.orders.put(Order("out", "left"))
    done = run.done()
    assert done.out == {"left"}
    (order,) = (e for e in run.events if e.kind == "ordered")
    (out,) = (e for e in run.events if e.detail == "is out for good")
    assert (order.robot, order.detail) == ("left", "out")
    # Not twice as late.
    assert shown.t_s * 1e9 <= order.t_ns <= out.t_ns < order.t_ns + 2e9
    later = [e for e in run.events if e.t_ns > out.t_ns and e.robot == "left"]
    assert not [e for e in later if e.kind == "released"]
    assert {*placed(done), *done.given_up} >= {1, 2, 3, 4}


def test_two_that_fail_at_once_are_asked_of_one_after_the_other(
    plan: PlanResult,
) -> None:
    arms = {name: failing_first_pick(40.0) for name in ("left", "right")}
    run = Beside(plan, arms=arms, values=ASKS).begin()
    run.until(lambda s: len([n for n in s.notices if n.kind == "failed"]) == 2)
    asked = []
    for number, answer in ((1, "yes"), (2, "no")):
        shown = run.until(lambda s, n=number: s.asked == n and s.question != "")  # type: ignore[misc]
        asked.append(shown.question)
        run.panel.orders.put(Order(answer, "", number))  # type: ignore[arg-type]
    done = run.done()
    assert len(set(asked)) == 2
    assert [ask.helps for ask in done.asks] == [True, False]
    steps = [int(words.rstrip("?").split()[-1]) for words in asked]
    assert steps[1] in done.given_up
    assert steps[0] not in done.given_up or "rests" in done.given_up[steps[0]]


def test_what_forecasts_are_made_of_is_what_the_log_tells(plan: PlanResult) -> None:
    run = Beside(plan, pace=10.0).begin()
    run.until(lambda s: s.t_s > 30.0)
    so_far = run.panel.so_far
    assert so_far is not None
    run.panel.orders.put(Order("out", "left"))  # sooner over
    run.done()
    told = FollowedRun(plan.tpg)
    for event in run.events:
        if event.t_ns <= so_far.now_ns:
            told.apply(event)
    assert not told.violations
    found = so_far.followed()
    assert found.now_ns == so_far.now_ns
    assert found.nodes_done > 20
    for one, other in zip(found.robots, told.robots, strict=True):
        # What happens while it is looked at may be told of already.
        done = one.completed
        assert done <= other.completed <= done + 2
        # It is told of once a driver has reported it.
        assert (one.start_ns[:done] <= other.start_ns[:done]).all()
        assert (one.end_ns[:done] <= other.end_ns[:done]).all()
        assert (one.end_ns[done:] < 0).all()
        assert (one.start_ns[done + 1 :] < 0).all()

"""Every operation comes to an end, and says truly what was done: a measure goes down with every new plan."""

from __future__ import annotations

from itertools import product
from typing import Any

import pytest

from scheduling.graph.plan_files import plan_sha256
from tests.twin.operations.operated import lost, operated
from tests.twin.operations.random_operations import CELLS, plan_of, problems_of
from twin.operations.failure_triage import FailureTriage
from twin.operations.operation import Operation
from twin.operations.step_window import StepWindow
from twin.operations.termination import NO_PROGRESS, RevisionMeasure
from twin.runs.events import Event
from twin.trial.plan_result import PlanResult

BY_DAY = {
    "stack": 2,
    "stack in windows of one": 2,
    "stack in windows of two": 2,
    "stack of stations": 2,
    "reworked": 2,
    "rejecting": 1,
    "tower": 2,
    "gluing": 1,
    "tending": 1,
}
"""How many drawn operations of each cell are tried by day: those that are cheap."""

AT_NIGHT = 10
"""Of each cell."""

KNOWN = {
    "mix": [9010, 9031, 9037],  # a product left without what was on it
    "tools in a line": [9011],  # a flange was bare
    # What a person brought was not cleaned as the lost one was; a late part was not there.
    "reworked": [9011, 9119],
    # A part that was scrapped was worked at, and one that was late.
    "rejecting": [9010, 9031, 9037, 9115],
    "rejecting to a person": [9007],
}
"""Operations with findings in the past."""


@pytest.mark.parametrize(
    ("cell", "seed"), [(cell, k) for cell, n in BY_DAY.items() for k in range(n)]
)
def test_a_drawn_operation_ends_and_tells_the_truth(cell: str, seed: int) -> None:
    found, _ = problems_of(cell, seed, audit=seed == 0)
    assert found == []


@pytest.mark.nightly
@pytest.mark.parametrize("cell", CELLS)
def test_drawn_operations_of_every_kind_end_and_tell_the_truth(cell: str) -> None:
    wrong = {}
    for seed in (*range(100, 100 + AT_NIGHT), *KNOWN.get(cell, ())):
        found, _ = problems_of(cell, seed)
        if found:
            wrong[seed] = found
    assert wrong == {}


def test_a_measure_is_below_another_one_in_the_order_of_its_causes() -> None:
    values = [RevisionMeasure(*own) for own in product(range(-1, 3), repeat=4)]
    for one, other in product(values[::7], values[::5]):
        first = next(
            (a - b for a, b in zip(one, other, strict=True) if a != b), 0
        )  # the first difference decides
        assert one.is_below(other) == (first < 0 and all(part >= 0 for part in one))


def require_ended(done: Operation, events: list[Event], most: int) -> None:
    assert done.record.outcome == "failed"
    assert events[-1].detail == "failed"
    assert NO_PROGRESS in done.given_up.values()
    assert len(done.versions) <= most


ALWAYS = {"probability": 1.0, "retries": 0}


def test_failures_that_nobody_counts_do_not_go_on_for_ever(
    plan: PlanResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A planner that forgets how often a skill has failed would try it for ever."""
    judged = FailureTriage.decide

    def forgetful(self: FailureTriage, *about: Any) -> Any:
        found = judged(self, *about)
        self.ledger.tries.clear()
        self.ledger.given_up.clear()
        self.ledger.unpickable.clear()
        return found

    monkeypatch.setattr(FailureTriage, "decide", forgetful)
    done, events = operated(plan, 1, **{"failures.pick": ALWAYS})
    require_ended(done, events, 3)


def test_a_window_that_brings_no_steps_does_not_come_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A window that is due though it brings nothing would be planned once a second."""
    plan = plan_of("stack in windows of one")
    monkeypatch.setattr(StepWindow, "after", lambda _, planned, __: planned)
    done, events = operated(plan, 3)
    require_ended(done, events, 1)
    assert sorted(done.given_up) == [2, 3, 4]


@pytest.mark.parametrize("seed", [3, 8])
def test_a_plan_that_changes_nothing_is_not_issued(plan: PlanResult, seed: int) -> None:
    whole, _ = operated(plan, seed)
    ends = {
        chain.robot: int(own[-1])
        for chain, own in zip(whole.tpg.chains, whole.record.end_ns, strict=True)
    }
    first = min(ends, key=lambda name: ends[name])
    at_s = (ends[first] + 1_000_000) / 1e9
    done, events = operated(plan, seed, outages=[{"robot": first, "at_s": at_s}])
    assert done.out == {first}
    assert done.record.outcome == "completed"
    hashes = [
        plan_sha256(graph) for graph in (plan.tpg, *(v.tpg for v in done.versions))
    ]
    assert all(a != b for a, b in zip(hashes, hashes[1:], strict=False))
    assert sum(e.kind == "replanned" for e in events) == len(done.versions)


@pytest.mark.parametrize(("again", "times"), [(0, 1), (1, 2)])
def test_what_always_fails_is_tried_as_often_as_is_said(
    plan: PlanResult, again: int, times: int
) -> None:
    """Somebody sees to it as often as may be asked, and it fails ``again + 1`` times before each answer."""
    values = {
        "failures.place-down": ALWAYS,
        "recovery.again": again,
        "recovery.ask": {"answer_s": 1.0, "times": times},
    }
    done, events = operated(plan, 5, **values)
    assert done.record.outcome == events[-1].detail == "failed"
    failed = sum(event.kind == "failed" for event in events)
    assert failed == (again + 1) * (times + 1)
    assert done.given_up.keys() == {1, 2, 3, 4}


def test_the_last_event_is_the_outcome(plan: PlanResult) -> None:
    for seed in (1, 2, 3):
        done, events = operated(plan, seed, **lost(0.6), **{"recovery.again": 0})
        assert events[-1].kind == "finished"
        assert events[-1].detail == done.record.outcome
        assert (done.record.outcome == "failed") == bool(done.given_up)

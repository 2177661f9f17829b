"""What fails is planned anew while the others go on, and all that was executed keeps its guarantee."""

from __future__ import annotations

import json
import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.errors import RequestError
from planning.tasks.task import TaskKind
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.invariant import check_invariant
from scheduling.verification.verify import verify_plan
from tests.twin.operations.operated import (
    CLIFF,
    STACK,
    gone,
    lost,
    operated,
    operated_by_program,
    placed,
    require_kept,
    require_own_contacts,
    require_resumed,
    require_safe,
    require_same_run,
    tasks_of,
)
from tests.twin.scenarios.test_processes import SCENARIO as COVER
from twin.operations.operation import Operation, operate
from twin.trial.loaded_scenario import load
from twin.trial.plan_result import PlanResult
from twin.trial.planning import plan_scenario
from twin.trial.simulation import scenario_execution


def test_without_failures_it_is_the_run(plan: PlanResult) -> None:
    assert require_same_run(plan).versions == ()


@settings(max_examples=6, deadline=None)
@given(seed=st.integers(0, 10_000), retries=st.integers(0, 1))
def test_whatever_fails_the_union_keeps_the_invariant(
    plan: PlanResult, seed: int, retries: int
) -> None:
    # However often something fails, it is tried again: what is given up cannot be done.
    patient = {"recovery.again": 100}
    done, events = operated(plan, seed, **lost(0.25, retries), **patient)
    assert done.record.outcome in ("completed", "failed")
    assert (done.record.outcome == "failed") == bool(done.given_up)
    # Searched anew, not taken from the edges that the extension was made of.
    require_kept(done)
    require_own_contacts(done.tpg)
    # Nothing is done twice: each goal is placed at most once, and lost bricks are used no more.
    assert len(placed(done)) == len(set(placed(done)))
    assert not gone(done) & {t.object for t in tasks_of(done, "place-down")}
    left = {e.object for e in events if e.detail == "leaves the cell"}
    assert left == gone(done)
    failures = [e for e in events if e.kind == "failed"]
    assert len([e for e in events if e.kind == "recovered"]) == len(failures)
    assert len(tasks_of(done, TaskKind.FAILED)) == len(failures)
    if len(gone(done)) < 4:
        assert done.record.outcome == "completed", done.given_up


@pytest.mark.nightly
@settings(max_examples=6, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_what_is_planned_and_does_not_take_over_leaves_nothing_behind(
    plan: PlanResult, seed: int
) -> None:
    """More fails while a plan is made, so that it is made once more."""
    slow = {"recovery.planning_s": 40.0, "recovery.again": 1}
    done, events = operated(plan, seed, **lost(0.35), **slow)
    check_invariant(DerivedTpg(done.tpg))
    assert len(placed(done)) == len(set(placed(done)))
    assert sorted({*placed(done), *done.given_up}) == [1, 2, 3, 4]
    assert not set(placed(done)) & done.given_up.keys()
    failures = [e for e in events if e.kind == "failed"]
    assert len([e for e in events if e.kind == "recovered"]) == len(failures)
    assert len(done.versions) <= len(failures)
    # What has failed once is counted once, however often it is planned for.
    kinds = {e.task: e.detail.split("(")[1].split()[0] for e in failures}
    steps = {t.index: t.step for t in done.tpg.tasks}
    often = Counter((steps[task], kind) for task, kind in kinds.items())
    for step, why in done.given_up.items():
        if why.endswith(" times"):
            kind = why.split()[0]
            assert f"failed {often[step, kind]} times" in why


def tries(done: Operation) -> dict[tuple[int, str], list[int]]:
    """Return how many attempts failed in each try at each skill of a step."""
    found: dict[tuple[int, str], list[int]] = {}
    for task in done.tpg.tasks:
        kind = task.label.split()[0] if task.kind == TaskKind.FAILED else task.kind
        if kind in ("pick", "place-down"):
            k = done.tpg.chain_index[task.robot]
            (node, *_) = np.flatnonzero(done.tpg.chains[k].task == task.index)
            skill = done.tpg.chains[k].skill
            node += int(np.argmax(skill[node:]))
            own = [s.node for s in done.record.standstills[k] if s.cause == "retry"]
            found.setdefault((task.step, kind), []).append(own.count(int(node)))
    return found


@pytest.mark.nightly
@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_luck_is_that_of_the_step_however_it_is_planned_anew(
    plan: PlanResult, seed: int
) -> None:
    one, other = (
        operated(plan, seed, halting, **lost(0.3, 1), **{"recovery.again": 100})
        for halting in (False, True)
    )
    if not one[0].given_up and not other[0].given_up:
        assert tries(one[0]) == tries(other[0])


def test_what_cannot_be_put_down_is_taken_from_the_hand(plan: PlanResult) -> None:
    never = {"probability": 1.0, "retries": 0}
    done, events = operated(
        plan, 0, **{"failures.place-down": never, "recovery.again": 0}
    )
    assert done.given_up[1].endswith("failed 1 times")
    assert {done.given_up[step] for step in (2, 3, 4)} == {"it rests on step 1"}
    taken = {t.object for t in done.tpg.tasks if t.kind == TaskKind.TAKEN_OUT}
    assert taken == {e.object for e in events if e.kind == "attached"}
    for chain in done.tpg.chains:
        home = done.tpg.cell.robot(chain.robot).home
        assert np.allclose(chain.waypoints[-1], home)
    require_safe(done.tpg)


def test_on_the_way_aside_nothing_may_touch_that_does_not_where_it_begins(
    plan: PlanResult,
) -> None:
    """A brick that was not put down is held above its place, and its way is clear of what it was to touch there."""
    never = {"probability": 1.0, "retries": 0}
    done, _ = operated(plan, 0, **{"failures.place-down": never, "recovery.again": 0})
    aside = {t.index for t in done.tpg.tasks if t.label == "aside"}
    may = {frozenset((c.first, c.second)) for c in done.tpg.allowed if c.tasks & aside}
    assert may == {
        frozenset((f"{t.robot}/tool", str(t.object)))
        for t in done.tpg.tasks
        if t.kind == TaskKind.TAKEN_OUT
    }


@pytest.mark.parametrize("at_s", [0.0, 0.01])
def test_a_robot_may_be_out_before_it_has_done_anything(
    plan: PlanResult, at_s: float
) -> None:
    done, _ = operated(plan, 0, outages=[{"robot": "right", "at_s": at_s}])
    assert done.record.outcome == "completed"
    assert {t.robot for t in done.tpg.tasks if t.kind == "place-down"} == {"left"}


def test_an_outage_after_the_end_changes_nothing(plan: PlanResult) -> None:
    late = [{"robot": "left", "at_s": 1e5}]
    done, events = operated(plan, 0, outages=late)
    assert events == operated(plan, 0)[1]
    assert events[-1].t_ns == done.record.makespan_ns


def edges_across(done: Operation) -> list[int]:
    """Return the edges from what was committed to what the last version has anew."""
    counts = done.versions[-1].counts
    edges = enumerate(done.tpg.edges.tolist())
    return [row for row, (k, u, i, v) in edges if u < counts[k] and v >= counts[i]]


def first_with_a_swap(plan: PlanResult) -> Operation:
    for seed in range(100):
        done, _ = operated(plan, seed, **lost(0.25))
        if done.versions and not done.given_up and edges_across(done):
            return done
    raise AssertionError("nothing ever fails")


def test_what_was_executed_is_verified_and_a_missing_edge_between_versions_is_found(
    plan: PlanResult,
) -> None:
    from dataclasses import replace

    done = first_with_a_swap(plan)
    require_safe(done.tpg)
    edges, found = done.tpg.edges, 0
    for row in edges_across(done)[:6]:
        keep = np.arange(len(edges)) != row
        other = replace(done.tpg, edges=edges[keep], cause=done.tpg.cause[keep])
        found += bool(verify_plan(other, limit=1).problems)
    assert found


def test_a_robot_that_is_out_stands_and_the_other_one_does_the_rest(
    plan: PlanResult,
) -> None:
    done, events = operated(plan, 0, outages=[{"robot": "left", "at_s": 5.0}])
    assert done.record.outcome == "completed"
    assert [e.robot for e in events if e.kind == "failed"] == ["left"]
    (swap,) = [e for e in events if e.kind == "replanned"]
    later = [e for e in events if e.t_ns > swap.t_ns and e.kind == "started"]
    assert {e.robot for e in later} == {"right"}
    places = placed(done)
    assert sorted(places) == [1, 2, 3, 4]


def test_draws_are_named_so_an_operation_is_the_same_again(plan: PlanResult) -> None:
    one, two = (operated(plan, 7, **lost(0.3))[1] for _ in range(2))
    assert one == two


def test_the_program_operates_audits_and_resumes(tmp_path: Path) -> None:
    file = tmp_path / "stack.yaml"
    file.write_text(STACK)
    options, out = ("--failures", "0.5", "--seed", "3"), tmp_path / "run"
    printed, _ = operated_by_program(file, out, *options, code=None)
    assert "replanned" in printed
    # Killed after the first swap: the log is what is left.
    log = require_resumed(out, '"replanned"', 3)
    kinds = {json.loads(line)["kind"] for line in log.splitlines()}
    assert {"failed", "recovered", "replanned"} <= kinds


def test_what_cannot_be_planned_anew_is_refused(plan: PlanResult) -> None:
    with pytest.raises(RequestError, match="only asynchronous"):
        operated(plan, 0, policy="sequential")


def test_what_fails_for_a_reason_that_no_section_names_is_planned_anew(
    plan: PlanResult,
) -> None:
    """As a peg that misses its hole, because a base is off."""
    case = plan.scenario
    model = scenario_execution(case.sections, case.folder)
    missed = next(t for t in plan.tpg.tasks if t.kind == "place-down")
    misses = {f"{missed.robot}/{missed.object}": 1.0}
    wrong = model.disturbances.with_misses("place-down", misses)
    model = replace(model, disturbances=wrong)
    done = operate(case.sections, plan.motions, plan.tpg, model, seed=0)
    assert done.versions
    tried = next(t for t in done.tpg.tasks if t.kind == TaskKind.FAILED)
    assert tried.object == missed.object


def test_a_robot_lets_go_of_what_comes_later_where_nobody_else_can_go_on(
    tmp_path: Path,
) -> None:
    """The left arm loses its only brick of step 2, while the right one has that of step 3 in its hand."""
    few = re.sub(r"    - \{name: left_[b-e].*\n", "", STACK)
    file = tmp_path / "few.yaml"
    file.write_text(few)
    sure = {"probability": 0.35, "retries": 0, "loses": 1.0}
    done, _ = operated(
        plan_scenario(load(file), keep=True), 3, **{"failures.place-down": sure}
    )
    require_safe(done.tpg)
    assert [t.object for t in done.tpg.tasks if t.kind == TaskKind.FAILED] == ["left_a"]
    assert [t.object for t in done.tpg.tasks if t.kind == TaskKind.TAKEN_OUT] == [
        "right_b"
    ]
    assert done.record.outcome == "completed"


def test_a_robot_that_keeps_hold_can_support_what_is_begun_anew(tmp_path: Path) -> None:
    file = tmp_path / "cover.yaml"
    file.write_text(COVER)
    fails = {
        f"failures.{skill}": {"probability": 0.4, "retries": 0, "loses": 0.0}
        for skill in ("pick", "place-down")
    }
    done, _ = operated(plan_scenario(load(file), keep=True), 4, **fails)
    assert any(t.object == "pin" and t.kind == TaskKind.FAILED for t in done.tpg.tasks)
    assert done.record.outcome == "completed"


@pytest.mark.nightly
@pytest.mark.parametrize("robot", ["left", "right"])
def test_a_robot_may_be_out_in_the_middle_of_a_handover(robot: str) -> None:
    """Who has got the brick goes on with it once it has been let go of."""
    plan = plan_scenario(load(CLIFF.with_name("faucet.yaml")), keep=True)
    _, events = operated(plan, 0)
    ends = {e.task: e.t_ns for e in events if e.kind == "completed"}
    moments = [
        ends[t.index] / 1e9 + off
        for t in plan.tpg.tasks
        if t.kind == "handover"
        for off in (-6.0, -4.4, -2.0, -0.1, 0.2)
    ]
    for at_s in moments:
        done, _ = operated(plan, 0, outages=[{"robot": robot, "at_s": round(at_s, 3)}])
        check_invariant(DerivedTpg(done.tpg))
        assert not any("does not wait" in why for why in done.given_up.values())

"""Parts that are rejected: named steps are done again, so often, and then the part goes into a bin."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

import twin
from benchmarks.operate import audited
from planning.cell.workcell import Attachment, WorldState
from planning.tasks.assembly import Disposal
from planning.tasks.task import STILL, Handling, StepTasks, Task, TaskKind
from planning.transforms import translation
from planning.worlds.supplied import RemovalPlan
from planning.worlds.world import World
from tests.planted import rows
from tests.twin.operations.operated import (
    at_the_end,
    gone,
    operated,
    operated_by_program,
    placed,
    planned,
    require_resumed,
    require_safe,
    tasks_of,
)
from tests.twin.operations.random_operations import drawn_values, plan_of
from tests.twin.operations.reworked import BIN, REWORKED, with_crate
from tests.twin.operations.test_kinds import works_of
from tests.twin.written import refusal, written
from twin.operations.operation import Operation
from twin.scenario.sections.kind import assembly_kind
from twin.studies.folder import StudyRequest
from twin.trial.plan_result import PlanResult

NEVER = {"probability": 1.0, "retries": 0}


@pytest.fixture(scope="module")
def rejecting() -> PlanResult:
    return plan_of("rejecting")


def rejects(plan: PlanResult, seed: int = 1, /, **values: Any) -> Operation:
    """Operate a cell in which every cover is rejected."""
    done, _ = operated(plan, seed, **{"failures.inspect": {**NEVER, **values}})
    require_safe(done.tpg)
    return done


def put_into_the_bin(done: Operation) -> list[tuple[str, str | None]]:
    """Return who has let go of what over the bin."""
    return [
        (task.robot, task.object)
        for task in tasks_of(done, "place-down")
        if any(h.holder == Handling.GONE for h in task.handlings)
    ]


@pytest.mark.parametrize(
    ("steps", "again"),
    [
        (["second"], [(4, "screw", "right")]),
        (["third", "first"], [(3, "screw", "left"), (5, "clean", "right")]),
    ],
)
def test_named_steps_are_done_again_so_often_and_then_it_is_scrapped(
    rejecting: PlanResult, steps: list[str], again: list[tuple[int, str, str]]
) -> None:
    rework = {"steps": steps, "times": 2}
    done = rejects(rejecting, then="rework", rework=rework)
    before = [
        (1, "clean", "left"),
        (3, "screw", "left"),
        (4, "screw", "right"),
        (5, "clean", "right"),
    ]
    failed = [(6, TaskKind.FAILED, "left")]
    assert works_of(done) == [*before, *failed, *again, *failed, *again, *failed]
    assert done.reworked == (1,)
    assert done.content()["reworked"] == [1]
    assert done.given_up == {6: "inspect cover/middle failed 3 times"}
    assert put_into_the_bin(done) == [("left", "cover")]
    values = {"failures.inspect": {**NEVER, "then": "rework", "rework": rework}}
    if len(steps) == 1:
        assert audited(done, rejecting.scenario.varied(values)) == []


def test_a_person_is_asked_once_it_has_been_done_again_often_enough(
    rejecting: PlanResult,
) -> None:
    own = {"times": 1, "then": "ask"}
    ask = {"recovery.ask": {"answer_s": 5, "times": 1}}
    values: dict[str, Any] = {
        "failures.inspect": {**NEVER, "then": "rework", "rework": own},
        **ask,
    }
    done, _ = operated(rejecting, 1, **values)
    assert [a.step for a in done.asks] == [6]
    assert len(tasks_of(done, TaskKind.FAILED)) == 4, (
        "two before the answer, two after it"
    )
    # With scrap nobody is asked, though there is somebody.
    values["failures.inspect"] = {**NEVER, "then": "rework", "rework": {"times": 1}}
    done, _ = operated(rejecting, 1, **values)
    assert done.asks == ()
    assert len(tasks_of(done, TaskKind.FAILED)) == 2


def test_a_robot_drops_it_into_the_bin(rejecting: PlanResult) -> None:
    done = rejects(rejecting, then="scrap")
    assert done.given_up == {6: "cover is scrapped"}
    assert done.reworked == ()
    assert put_into_the_bin(done) == [("left", "cover")]
    (drop,) = (t for t in tasks_of(done, "place-down") if t.step == 6)
    put, _ = drop.handlings
    # The crate stands at (-0.7, 0.35, 0.025).
    assert put.pose[:3, 3] == pytest.approx([-0.7, 0.35, 0.225])
    assert gone(done) == {"cover"}
    assert "pin" in at_the_end(done)


def test_a_person_takes_it_after_a_drawn_time(rejecting: PlanResult) -> None:
    took = []
    spread = {"kind": "uniform", "low_s": 3, "high_s": 9}
    values = {
        "failures.inspect": {**NEVER, "then": "scrap"},
        "recovery.bin": "person",
        "recovery.remove": spread,
    }
    for seed in (1, 2):
        done, _ = operated(rejecting, seed, **values)
        (task,) = tasks_of(done, TaskKind.TAKEN_OUT)
        assert (task.robot, task.object) == ("removal", "cover")
        k = done.tpg.chain_index["removal"]
        took.append(int(done.record.end_ns[k][-1] - done.record.start_ns[k][-1]) / 1e9)
    assert all(3 <= seconds <= 9 for seconds in took)
    assert took[0] != took[1]


@pytest.mark.parametrize(
    "values",
    [
        {"recovery.bin": {"pose": {"xyz_m": [3, 0, 0.5]}}},
        pytest.param(
            {"recovery.bin": {"pose": {"xyz_m": [0, 0, -0.2]}}},
            marks=pytest.mark.nightly,
        ),
    ],
)
def test_what_no_robot_can_put_there_a_person_takes(
    rejecting: PlanResult, values: dict[str, Any]
) -> None:
    values = {"failures.inspect": {**NEVER, "then": "scrap"}, **values}
    done, _ = operated(rejecting, 1, **values)
    require_safe(done.tpg)
    assert put_into_the_bin(done) == []
    (task,) = tasks_of(done, TaskKind.TAKEN_OUT)
    assert task.object == "cover"


def test_without_a_bin_it_stays_where_it_is(rejecting: PlanResult) -> None:
    values = {"failures.inspect": {**NEVER, "then": "scrap"}, "recovery.bin": None}
    done, _ = operated(rejecting, 1, **values)
    assert "cover" in at_the_end(done)
    assert tasks_of(done, TaskKind.TAKEN_OUT) == []


@pytest.mark.parametrize(("seed", "takes"), [(1, "left"), (6, "removal")])
def test_what_a_robot_fails_to_put_into_the_bin_a_person_takes(
    rejecting: PlanResult, seed: int, takes: str
) -> None:
    """After a pick it lies where it was; after a placement it is in the hand."""
    fails = {"probability": 0.4, "retries": 0}
    values = {
        "failures.inspect": {**NEVER, "then": "scrap"},
        "failures.pick": fails,
        "failures.place-down": fails,
    }
    done, events = operated(rejecting, seed, **values)
    assert "cover is left to a person" in {e.detail for e in events}
    require_safe(done.tpg)
    assert put_into_the_bin(done) == []
    (task,) = tasks_of(done, TaskKind.TAKEN_OUT)
    assert (task.robot, task.object, task.step) == (takes, "cover", 6)


@pytest.mark.parametrize(("kind", "first"), [("clean", 1), ("screw", 3)])
def test_nothing_more_is_done_with_what_is_scrapped(
    rejecting: PlanResult, kind: str, first: int
) -> None:
    """The first of six steps about the cover, or the third, scraps it."""
    done, _ = operated(rejecting, 1, **{f"failures.{kind}": {**NEVER, "then": "scrap"}})
    require_safe(done.tpg)
    assert put_into_the_bin(done) == [("left", "cover")]
    tried = [step for step, *_ in works_of(done)]
    assert tried == [step for step in (1, 3) if step <= first]
    undone = {k for k in range(1, 7) if k >= first}
    assert done.given_up.keys() == undone
    assert done.given_up[first] == "cover is scrapped"
    assert placed(done)[-1] == 7


def test_what_a_step_that_is_not_wanted_any_more_has_scrapped_is_told(
    rejecting: PlanResult,
) -> None:
    fails = {"failures.inspect": {**NEVER, "then": "scrap"}}
    _, events = operated(rejecting, 1, **fails)
    (failed,) = (e for e in events if e.kind == "failed")
    drop = [{"at_s": failed.t_ns / 1e9 - 0.1, "drop": [6]}]
    done, _ = operated(rejecting, 1, **fails, changes=drop)
    assert done.given_up == {6: "cover is scrapped"}
    assert done.dropped == {}
    assert gone(done) == {"cover"}


@pytest.mark.parametrize("helps", [1.0, 0.0])
def test_what_a_person_brings_gets_what_was_done_to_the_lost_one(
    rejecting: PlanResult, helps: float
) -> None:
    values = {
        "failures.pick": {"probability": 0.5, "retries": 0, "loses": 1.0},
        "recovery.ask": {"answer_s": 5, "helps": helps, "times": 1},
    }
    done, _ = operated(rejecting, 1, **values)
    cleaned = [(t.step, t.object) for t in tasks_of(done, "clean")]
    if helps:
        assert cleaned == [(1, "cover"), (1, "cover.1"), (5, "cover.1")]
        assert audited(done, rejecting.scenario.varied(values)) == []
    else:
        assert cleaned == [(1, "cover")]
        assert {2, 3, 4, 5, 6} <= done.given_up.keys()


def test_what_was_taken_away_before_leaves_with_no_tray() -> None:
    here, names = translation(0.0, 0.0, 0.1), ("blank.1", "blank.2")
    there = WorldState({}, {"blank.2": Attachment(None, here)})
    out = tuple(Handling(own, 1, Handling.GONE, here) for own in names)
    leaves = Task(0, "outfeed", TaskKind.LEAVE, 12, "leaves", STILL, out)
    rejected = {6: Disposal(6, "blank.1", None)}
    scrap = RemovalPlan(World(there), (), frozenset(), rejected)
    (left,) = scrap.without_absent_objects(StepTasks(12, (leaves,), (), ())).tasks
    assert [h.object for h in left.handlings] == ["blank.2"]


@pytest.mark.nightly
def test_who_has_only_approached_what_is_scrapped_retreats(tmp_path: Path) -> None:
    text = with_crate(REWORKED)
    for old, new in {
        "screw: {duration: {kind: fixed, value_s: 2}": "screw: {duration: {kind: fixed, value_s: 0.3}",
        "    inspect: {": "    polish: {duration: {kind: fixed, value_s: 9}, frame: driver, approach_m: 0.2}\n    inspect: {",
        "{process: screw, at: {part: cover, frame: hole2}, robots: [right], after: [first]": "{process: polish, at: {part: cover, frame: hole2}, robots: [right], after: [covered]",
        "speed_model: joint": "speed_model: l1, speed_rad_s: 0.25",
    }.items():
        assert old in text
        text = text.replace(old, new)
    plan = planned(written(tmp_path, text), **{"recovery.bin": BIN})
    done, _ = operated(plan, 1, **{"failures.screw": {**NEVER, "then": "scrap"}})
    require_safe(done.tpg)
    assert tasks_of(done, "polish") == []
    assert [t for t in done.tpg.tasks if t.label.startswith("back: approach to polish")]
    assert put_into_the_bin(done) == [("left", "cover")]
    assert done.given_up == dict.fromkeys(range(3, 7), "cover is scrapped")


@pytest.mark.nightly
def test_what_others_stand_on_stays(tmp_path: Path) -> None:
    text = with_crate(REWORKED)
    goal, pin = (
        "goal: {xyz_m: [0.06, 0.04, 0.07]}",
        "    - {place: pin, robots: [left], after: [seen]}\n",
    )
    assert goal in text
    assert pin in text
    text = text.replace(goal, "goal: {xyz_m: [-0.065, 0, 0.09]}").replace(pin, "")
    seen = "    - {process: inspect,"
    text = text.replace(
        seen, f"    - {{place: pin, robots: [left], after: [third]}}\n{seen}"
    )
    plan = planned(written(tmp_path, text), **{"recovery.bin": BIN})
    done = rejects(plan, then="scrap")
    assert {"cover", "pin"} <= at_the_end(done).keys()
    assert tasks_of(done, TaskKind.TAKEN_OUT) == []


REFUSED = rows(r"""
section | at | says
failures: {inspect: {probability: 0.1, rework: {times: 2}}} | {probability | rework says what is done again: give then: rework, too
failures: {inspect: {probability: 0.1, then: rework, rework: {times: 0}}} | 0}} | must be at least 1, not 0
failures: {inspect: {probability: 0.1, then: rework, rework: {times: 101}}} | 101 | must be at most 100
failures: {inspect: {probability: 0.1, then: rework, rework: {steps: []}}} | [] | at least 1
failures: {inspect: {probability: 0.1, then: rework, rework: {steps: [frist]}}} | frist | frist is no step that works at what inspect rejects, before that and where it lies (valid: first, second, third)
failures: {inspect: {probability: 0.1, then: rework, rework: {steps: [first, cleaned]}}} | cleaned | (valid: first, second, third)
failures: {inspect: {probability: 0.1, then: rework, rework: {steps: [covered]}}} | covered | covered is no step that works at
failures: {inspect: {probability: 0.1, then: rework, rework: {steps: [pin]}}} | pin | pin is no step that works at
failures: {inspect: {probability: 0.1, then: rework, rework: {steps: [seen]}}} | seen | seen is no step that works at
failures: {clean: {probability: 0.1, then: rework, rework: {steps: [third]}}} | third | (valid: first, second)
failures: {inspect: {probability: 0.1, then: rework, rework: {then: ask}}} | ask | there is nobody to ask: give recovery.ask (valid: scrap)
failures: {inspect: {probability: 0.1, then: rework, rework: {then: again}}} | again | unknown value 'again' (valid: scrap, ask)
recovery: {bin: {}} | {}} | key 'pose' is missing
recovery: {bin: robot} | robot | unknown value 'robot' (valid: person)
recovery: {bin: {by: person}} | by | unknown key 'by'
recovery: {bin: {fixture: creat, pose: {xyz_m: [0, 0, 0.2]}}} | creat | unknown fixture 'creat'; did you mean 'crate'? (valid: crate, table, jig)
recovery: {remove_s: 3, remove: {kind: fixed, value_s: 3}} | {remove_s | give remove_s or remove, not both
""")


@pytest.mark.parametrize(("section", "at", "says"), REFUSED)
def test_what_cannot_be_rejected_so_is_refused(
    tmp_path: Path, section: str, at: str, says: str
) -> None:
    text = with_crate(REWORKED).replace("execution:\n", f"execution:\n  {section}\n")
    found = refusal(tmp_path, text).problems
    (problem,) = (own for own in found if says in own.message)
    (row,) = [k for k, line in enumerate(text.splitlines()) if section in line]
    assert problem.mark.line == row + 1
    assert problem.mark.column == 3 + section.rindex(at)


OFTEN = {"failures.inspect": {"probability": 0.5, "retries": 0, "then": "rework"}}


@pytest.mark.parametrize(
    ("values", "options", "is_operated"),
    [
        (OFTEN, {}, True),
        ({"failures.inspect": NEVER}, {}, False),
        (OFTEN, {"operate": False}, False),
        (OFTEN, {"policies": ["sequential"]}, False),
        (
            {"failures.inspect": {**NEVER, "probability": 0.0, "then": "scrap"}},
            {},
            False,
        ),
        (
            {"failures.inspect": NEVER},
            {"vary": {"failures.inspect.then": ["again", "scrap"]}},
            True,
        ),
    ],
)
def test_a_study_operates_where_parts_may_be_rejected(
    rejecting: PlanResult,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    values: dict[str, Any],
    options: dict[str, Any],
    is_operated: bool,
) -> None:
    asked: list[bool] = []

    def start(request: StudyRequest, *_: object) -> None:
        asked.append(request.operated)
        raise KeyboardInterrupt

    monkeypatch.setattr(import_module("twin.studies.api"), "start_study", start)
    plan = replace(rejecting, scenario=rejecting.scenario.varied(values))
    with pytest.raises(KeyboardInterrupt):
        twin.study(plan, replications=2, out=tmp_path / "study", **options)
    assert asked == [is_operated]


@pytest.mark.nightly
def test_the_program_operates_verifies_and_resumes_it(tmp_path: Path) -> None:
    again = "{then: rework, rework: {steps: [second], times: 1}, probability: 1.0, retries: 0}"
    own = f"execution:\n  failures: {{inspect: {again}}}\n  recovery: {{bin: {{fixture: crate, pose: {{xyz_m: [0, 0, 0.2]}}}}}}\n"
    file = written(tmp_path, with_crate(REWORKED).replace("execution:\n", own))
    _, summary = operated_by_program(file, tmp_path / "out", code=1)
    assert summary["operation"]["reworked"] == [1]
    assert list(summary["operation"]["given_up"]) == ["6"]
    require_resumed(tmp_path / "out")


@pytest.mark.nightly
def test_a_study_says_whether_it_operates(
    rejecting: PlanResult, tmp_path: Path
) -> None:
    plan = replace(rejecting, scenario=rejecting.scenario.varied(OFTEN))
    study = twin.study(plan, replications=6, out=tmp_path / "operated")
    assert study.summary["closed_loop"]
    assert study.summary["warnings"] == []
    replanned = [n > 0 for n in study.replications["versions"].to_pylist()]
    assert 0 < sum(replanned) < 6
    study = twin.study(plan, replications=6, out=tmp_path / "not", operate=False)
    assert not study.summary["closed_loop"]
    (warning,) = study.summary["warnings"]
    assert warning.startswith("replications in which inspect fails for good count")
    ends = study.replications["outcome"].to_pylist()
    assert [end == "failed" for end in ends[-6:]] == replanned


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(20))
def test_every_product_ends_whole_or_scrapped(tmp_path: Path, seed: int) -> None:
    """What first-pass yield is counted from adds up: of those that are whole, some were worked at again."""
    plan, wanted, spare = plan_of("rejecting in a line"), 3, 1
    values = drawn_values("rejecting in a line", seed)
    done, _ = operated(plan, seed, **values)
    whole = set(done.tpg.products.tolist()) - {0}
    kind = assembly_kind(plan.scenario.sections.assembly).written_out()
    steps = kind.steps() // (wanted + spare)
    begun = {(k - 1) // steps + 1 for k in {t.step for t in done.tpg.tasks}}
    assert whole.isdisjoint(done.scrapped)
    assert {*whole, *done.scrapped} <= set(range(1, wanted + spare + 1))
    if not done.dropped and not done.out:
        assert begun <= {*whole, *done.scrapped}
    repeated = Counter((t.step - 1) // steps + 1 for t in tasks_of(done, "milling"))
    assert set(done.reworked) <= {
        n for n, often in repeated.items() if often > 1
    } | set(done.scrapped)
    assert gone(done) >= {o for _, o in put_into_the_bin(done)}

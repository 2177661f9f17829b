"""Cells with machines, sources and products go on when something fails: nothing comes twice, nothing stays in the way."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import twin
from planning.tasks.assembly import Disposal
from planning.tasks.task import STILL, Handling, StepTasks, Task, TaskKind
from planning.transforms import translation
from planning.worlds.supplied import REMOVAL, RemovalPlan
from planning.worlds.world import World
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.operations.operated import (
    FEW,
    at_the_end,
    gone_on,
    lost,
    operated,
    require_kept,
    require_safe,
    require_same_run,
    tasks_of,
)
from twin.operations.operation import Operation
from twin.throughput.throughput import line_summary
from twin.trial.loaded_scenario import load
from twin.trial.plan_result import PlanResult
from twin.trial.planning import plan_scenario

ROOT = Path(__file__).parents[3] / "scenarios" / "assembly"
STEPS = 5
"""Of a product that a mill and a washer work at."""

PRODUCTS = 3


@pytest.fixture(scope="module")
def plan() -> PlanResult:
    """Three products, each on a tray of its own."""
    case = load(ROOT / "machine_tending.yaml")
    few = {
        **FEW,
        "assembly.products.count": PRODUCTS,
        "assembly.products.places": {"counts": [1, 1], "pitch_m": [0.1, 0.1]},
        "machines": {},
    }
    return plan_scenario(case.varied(few), keep=True)


def require_true(done: Operation) -> None:
    """Check what was executed: the guarantee, the order, and that the world at the end is as it is told."""
    require_kept(done)
    tasks = [
        t for t in done.tpg.tasks if t.kind not in (TaskKind.LEFT_OUT, TaskKind.FAILED)
    ]
    # Every skill of a step is done once, or the step is not done to its end and told.
    skills = Counter(
        (t.step, t.kind)
        for t in tasks
        if t.kind in ("pick", "place-down", "milling", "washing")
    )
    undone = done.given_up.keys() | done.dropped.keys()
    assert max(skills.values(), default=0) <= 1 or undone
    last = {
        step for step, kind in skills if kind in ("place-down", "milling", "washing")
    }
    assert last | undone == set(range(1, PRODUCTS * STEPS + 1))
    assert not last & undone


def require_clear(done: Operation) -> None:
    """Check that every blank has come once, and that each has left the cell, was lost, or was taken away."""
    came = Counter(
        h.object
        for t in done.tpg.tasks
        if t.kind == TaskKind.PRESENT
        for h in t.handlings
        if h.holder is None
    )
    assert came == {f"blank.{k}": 1 for k in range(2, PRODUCTS + 1)}
    left = Counter(h.object for h in done.tpg.handlings if h.holder == Handling.GONE)
    blanks = {name: n for name, n in left.items() if name.startswith("blank")}
    assert blanks == {f"blank.{k}": 1 for k in range(1, PRODUCTS + 1)}
    state = at_the_end(done)
    assert not [name for name in state if name.startswith("blank")]
    leaves = tasks_of(done, TaskKind.LEAVE)
    assert len(leaves) == PRODUCTS


def test_without_failures_it_is_the_run(plan: PlanResult) -> None:
    done = require_same_run(plan)
    require_true(done)
    require_clear(done)


@settings(max_examples=2, deadline=None)
@given(seed=st.integers(0, 10_000), mill=st.sampled_from([0.0, 0.4]))
@example(seed=14, mill=0.0)  # a blank that could not be picked twice lies in the source
def test_whatever_fails_a_line_goes_on(
    plan: PlanResult, seed: int, mill: float
) -> None:
    fails = {"failures.milling": {"probability": mill, "retries": 0}}
    done, _ = operated(plan, seed, **lost(0.2), **fails, **{"recovery.again": 1})
    require_true(done)
    require_clear(done)


@pytest.mark.nightly
@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    out=st.sampled_from(["mill", "washer", "arm", "cart"]),
    at_s=st.floats(0.0, 300.0),
    drop=st.integers(1, PRODUCTS * STEPS),
)
def test_whoever_is_out_and_whatever_is_dropped_a_line_goes_on(
    plan: PlanResult, seed: int, out: str, at_s: float, drop: int
) -> None:
    changes = {
        "outages": [{"robot": out, "at_s": at_s}],
        "changes": [{"at_s": at_s / 2, "drop": [drop]}],
    }
    done, _ = operated(plan, seed, **lost(0.1), **changes)
    require_true(done)
    assert done.out <= {out}


def test_what_was_planned_and_never_done_is_forgotten(plan: PlanResult) -> None:
    changes = [{"at_s": 1.0, "drop": [8]}]
    mill = [{"robot": "mill", "at_s": 2.1}]
    done, _ = operated(plan, 8, **lost(0.1), outages=mill, changes=changes)
    require_true(done)
    assert len(done.versions) > 1


def test_what_is_in_a_machine_that_is_out_is_taken_away(plan: PlanResult) -> None:
    done, _ = operated(plan, 0, outages=[{"robot": "mill", "at_s": 15.0}])
    require_true(done)
    require_clear(done)
    assert done.out == {"mill"}
    # What it has begun it brings to its end; of the others nothing is begun that the mill is needed for.
    milled = [t.object for t in done.tpg.tasks if t.kind == "milling"]
    taken = {t.object for t in done.tpg.tasks if t.robot == REMOVAL}
    everyone = {f"blank.{k}" for k in range(1, PRODUCTS + 1)}
    assert taken == everyone - set(milled)
    assert all(
        t.kind == TaskKind.TAKEN_OUT for t in done.tpg.tasks if t.robot == REMOVAL
    )
    words = "; ".join(done.given_up.values())
    assert "mill is out" in words


def test_a_blank_that_is_lost_is_not_missed_by_the_others(plan: PlanResult) -> None:
    sure = {"failures.pick": {"probability": 0.5, "retries": 0, "loses": 1.0}}
    done, _ = operated(plan, 0, **sure)
    assert done.given_up[1] == "blank.1 is lost"
    assert done.given_up[2] == "it rests on step 1"
    require_clear(done)


def test_figures_of_the_line_are_those_of_products_that_are_whole(
    plan: PlanResult,
) -> None:
    done, _ = operated(plan, 0, changes=[{"at_s": 1.0, "drop": [STEPS + 1]}])
    assert done.scrapped == (), "nobody wants it"
    line = line_summary(done.tpg, done.record, due_s=[1e6, 0.0, 0.0])
    assert line is not None
    assert line["products"] == PRODUCTS - 1
    assert line["due"]["late"] == 1
    nothing = replace(done.tpg, products=np.zeros_like(done.tpg.products))
    assert line_summary(nothing, done.record) is None


def remaining(tpg: TemporalPlanGraph) -> dict[str, float]:
    """Return how long machines go on with what they were at, by name."""
    found = {}
    for task in tpg.tasks:
        if task.kind == TaskKind.GOES_ON:
            chain = tpg.chains[tpg.chain_index[task.robot]]
            assert chain.task[0] == task.index
            found[task.robot] = float(chain.duration[0])
    return found


@pytest.mark.parametrize(
    "who", ["mill", pytest.param("washer", marks=pytest.mark.nightly)]
)
def test_what_is_left_begins_with_machines_at_work(
    plan: PlanResult, tmp_path: Path, who: str
) -> None:
    run = twin.run(plan, out=tmp_path / "run", recording=False, audit=False)
    start, _ = run.node_times_ns[run.tpg.chain_index[who]]
    t_s = start[-1] / 1e9 + 1.0
    left, went = gone_on(run, t_s, tmp_path / "went")
    # What the tables say of the same time: who is at work, and until when.
    ends = {}
    for chain, (start, end) in zip(run.tpg.chains, run.node_times_ns, strict=True):
        node = int(np.searchsorted(start, t_s * 1e9)) - 1
        if run.tpg.cell.is_machine(chain.robot) and node >= 0:
            ends[chain.robot] = end[node] / 1e9
    found = remaining(left.tpg)
    assert who in found
    rest = max(ends[name] - seconds for name, seconds in found.items())
    assert rest >= t_s
    for name, end_s in ends.items():
        assert found.get(name, 0.0) == pytest.approx(max(end_s - rest, 0.0))
    # Each machine has worked as often as there are products, before or after.
    for kind in ("milling", "washing"):
        before = dict(left.tpg.cell.begun.done if left.tpg.cell.begun else ())
        after = sum(t.kind == kind for t in went.tpg.tasks)
        assert before.get(kind, 0) + after == PRODUCTS


def test_what_comes_up_waits_for_what_an_earlier_plan_had_taken_from_there() -> None:
    here, there = translation(0.0, 0.0, 0.1), translation(0.2, 0.0, 0.1)
    gone = (Handling("bolt.4", 1, Handling.GONE, here),)
    about = (
        REMOVAL,
        TaskKind.TAKEN_OUT,
        15,
        "bolt.4 is taken away",
        STILL,
        gone,
        "bolt.4",
    )
    tasks = [Task(3, *about)]
    for index, pose in ((2, here), (7, here), (8, there)):
        name = f"bolt.{index}"
        comes = (Handling(name, 1, None, pose),)
        tasks.append(
            Task(index, "bolts", TaskKind.PRESENT, index, name, STILL, comes, name)
        )
    scrap = RemovalPlan(cast(World, None), (), frozenset())
    assert [*scrap.waits(tasks)] == [(3, 7)]


@given(
    st.permutations(["pin", "lid", "pin of another"]),
    st.sets(st.sampled_from(["pin", "lid"])),
    st.sets(st.sampled_from(["pin", "lid"])),
    st.sets(st.sampled_from(["pin", "lid", "pin of another"])),
    st.booleans(),
)
def test_a_product_leaves_after_what_is_on_it_was_taken_away(
    order: list[str],
    rejected: set[str],
    placed: set[str],
    by_person: set[str],
    before: bool,
) -> None:
    """Robots or a person take rejected parts, on it or elsewhere, in this plan or in one before."""
    goals = {name: translation(0.1 * k, 0.0, 0.1) for k, name in enumerate(order)}
    away = [name for name in order if name in rejected | {"pin of another"}]
    tasks, takes = list[Task](), dict[str, int]()
    for name in away:
        at = goals[name] if name in placed else translation(0.0, 1.0, 0.1)
        put = (Handling(name, 1, None, at),)
        tasks.append(Task(len(tasks), "arm", "place-down", 8, name, STILL, put, name))
    for name in away:
        who, kind = "arm", "pick"
        off = Handling(name, 1, "arm", np.eye(4))
        if name in by_person:
            who, kind = REMOVAL, TaskKind.TAKEN_OUT
            off = Handling(name, 1, Handling.GONE, tasks[len(takes)].handlings[0].pose)
        takes[name] = len(tasks)
        tasks.append(Task(len(tasks), who, kind, 9, name, STILL, (off,), name))
    scrap = RemovalPlan(
        cast(World, None),
        (),
        frozenset(),
        {k: Disposal(k, name, None) for k, name in enumerate(rejected)},
        {} if before else {name: takes[name] for name in rejected},
    )
    parts = [Handling(k, 1, Handling.GONE, goals[k]) for k in ("pin", "lid")]
    leave = Task(9, "cart", TaskKind.LEAVE, 9, "leaves", STILL, tuple(parts))
    (left,) = scrap.without_absent_objects(StepTasks(9, (leave,), (), ())).tasks
    assert {h.object for h in left.handlings} == {"pin", "lid"} - rejected
    later = replace(tasks[-1], index=10)
    waits = {(a, b) for a, b in scrap.waits([*tasks, left, later]) if b == 9}
    assert waits == {(takes[name], 9) for name in rejected & placed}


@pytest.mark.nightly
def test_a_kitting_line_goes_on(tmp_path: Path) -> None:
    case = load(ROOT / "kitting.yaml").varied({"assembly.products.count": 6})
    plan = plan_scenario(case, keep=True)
    for seed in range(4):
        done, _ = operated(plan, seed, **lost(0.1))
        require_safe(done.tpg)
        placed = {t.step for t in done.tpg.tasks if t.kind == "place-down"}
        assert placed | done.given_up.keys() == set(range(1, 25))

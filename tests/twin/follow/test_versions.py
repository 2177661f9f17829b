"""An operated run is followed version by version: a clean one raises no alarm, a forbidden event in any version does."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.operations.operated import STACK
from tests.twin.program import invoke
from twin.follow.follow import follow
from twin.follow.followed_folder import PlanHistory, followed_execution, plan_history
from twin.follow.forecast import Forecaster
from twin.follow.recording import LiveRecording
from twin.follow.state import FollowedRun
from twin.runs.events import Event, event_line
from twin.runs.folder import EVENTS, FIRST, SUMMARY, VERSIONS

FAILS = (
    "execution:\n  failures:\n"
    "    pick: {probability: 0.3, retries: 0, loses: 0.6}\n"
    "    place-down: {probability: 0.3, retries: 0, loses: 0.5, slips: 0.5}\n"
)
RECOVERY = "  recovery: {again: %s, shortcuts: 0%s}\n"
CASES = {
    # A person brings bricks, in a chain that a later version adds; messages take time.
    "completed": FAILS + RECOVERY % (9, ", ask: {answer_s: 5}") + "  latency_s: 0.2\n",
    "late": FAILS + RECOVERY % (9, "") + "  late: [{part: left_a, at_s: 40}]\n",
    "failed": FAILS.replace(
        "0.3, retries: 0, loses: 0.5", "0.9, retries: 0, loses: 0.2"
    )
    + RECOVERY % (3, ""),
}


class Operated(NamedTuple):
    folder: Path
    plans: PlanHistory
    events: list[Event]
    outcome: str


@pytest.fixture(
    scope="module",
    params=["completed", "failed", pytest.param("late", marks=pytest.mark.nightly)],
)
def run(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Operated:
    folder = tmp_path_factory.mktemp("operated")
    text = STACK.replace("shortcut_candidates: 30", "shortcut_candidates: 0")
    (folder / "own.yaml").write_text(text + CASES[request.param])
    out, outcome = folder / "out", request.param.replace("late", "completed")
    words = "--no-recording", "--no-audit", "--seed", 4, "--out", out
    code = int(outcome == "failed")
    invoke("operate", folder / "own.yaml", *words, code=code)
    lines = (out / EVENTS).read_text().splitlines()
    events = [Event.parse(line) for line in lines]
    assert sum(e.kind == "replanned" for e in events) >= 2
    return Operated(out, plan_history(out), events, outcome)


def followed(run: Operated, events: Sequence[Event]) -> FollowedRun:
    plans = run.plans
    state = FollowedRun(plans.first, "asynchronous", plans.version, plans.late)
    for event in events:
        state.apply(event)
    return state


def test_a_clean_run_raises_no_alarm(run: Operated) -> None:
    state = followed(run, run.events)
    assert state.violations == []
    assert state.version == 1 + len(list((run.folder / VERSIONS).glob("[2-9]*")))
    nodes = sum(len(robot.start_ns) for robot in state.robots)
    assert state.nodes_done == nodes - len(
        run.plans.late - {e.robot for e in run.events}
    )


def test_log_summary_follow_and_resume_agree_on_the_outcome(run: Operated) -> None:
    summary = json.loads((run.folder / SUMMARY).read_text())
    assert summary["outcome"] == run.events[-1].detail == run.outcome
    assert bool(summary["operation"]["given_up"]) == (run.outcome == "failed")
    code = int(run.outcome == "failed")
    words = "--once", "--json", "--samples", 4, "--every", 50
    printed = invoke("follow", run.folder, run.folder / EVENTS, *words, code=code)
    last = json.loads(printed.stdout.splitlines()[-1])
    assert (last["outcome"], last["violations"]) == (run.outcome, 0)
    invoke("resume", run.folder, code=code)


@pytest.mark.parametrize("kind", ["started", "completed", "recovered", "replanned"])
def test_an_event_that_is_missing_is_found_in_every_version(
    run: Operated, kind: str
) -> None:
    rows = [k for k, event in enumerate(run.events) if event.kind == kind]
    draw = np.random.default_rng(len(run.events))
    tried = draw.choice(rows, size=min(3, len(rows)), replace=False)
    for row in sorted(tried):
        rest = [*run.events[:row], *run.events[row + 1 :]]
        assert followed(run, rest).violations, run.events[row]


def graphs(run: Operated) -> Iterator[tuple[int, int, TemporalPlanGraph]]:
    """Yield the events of each version, from one row to another one, with its graph."""
    assert run.plans.version is not None
    swaps = [k for k, event in enumerate(run.events) if event.kind == "replanned"]
    for number, (first, stop) in enumerate(
        zip([0, *swaps], [*swaps, len(run.events)], strict=True), start=1
    ):
        graph = run.plans.first if number == 1 else run.plans.version(number)
        yield first, stop, graph


def test_a_node_that_begins_too_early_is_found_in_every_version(run: Operated) -> None:
    """The rows of a node are moved to before the end of one that it waits for."""
    found = 0
    for first, stop, graph in graphs(run):
        at = {
            (event.robot, event.node, event.kind): row
            for row, event in enumerate(run.events[first:stop], start=first)
        }
        names = [chain.robot for chain in graph.chains]
        for k, u, i, v in graph.edges.tolist():
            before = at.get((names[k], u, "completed"))
            after = at.get((names[i], v, "started"))
            if names[k] in run.plans.late or before is None or after is None:
                continue
            events = [*run.events]
            early = replace(events.pop(after), t_ns=events[before].t_ns)
            events.insert(before, early)
            state = followed(run, events)
            edges = {edge for own in state.violations for edge in own.edges}
            assert (names[k], u) in edges
            found += 1
            break
    assert found >= 1


def test_another_task_or_robot_or_object_is_found(run: Operated) -> None:
    row = max(k for k, event in enumerate(run.events) if event.kind == "attached")
    changes: list[dict[str, Any]] = [
        {"task": 0},
        {"robot": "nobody"},
        {"object": "nothing"},
        {"node": 9999},
    ]
    for change in changes:
        events = [*run.events]
        events[row] = replace(events[row], **change)
        assert followed(run, events).violations, change


def test_a_run_is_followed_and_recorded_while_it_goes_on(
    run: Operated, tmp_path: Path
) -> None:
    """Versions come into the folder one after another, each before the log tells of it."""
    folder = tmp_path / "growing"
    shutil.copytree(
        run.folder, folder, ignore=shutil.ignore_patterns(VERSIONS, SUMMARY)
    )
    first = run.folder / VERSIONS / "1"
    if first.is_dir():
        shutil.copytree(first, folder / VERSIONS / "1")
    plans = plan_history(folder)
    _, model = followed_execution(folder, plans.first)
    state = FollowedRun(plans.first, model.policy, plans.version, plans.late)

    def lines() -> Iterator[str | None]:
        number = 1
        for event in run.events:
            if event.kind == "replanned":
                number += 1
                own = run.folder / VERSIONS / str(number)
                shutil.copytree(own, folder / VERSIONS / str(number))
                yield None
            yield event_line(event).strip()

    told: list[object] = []
    recorded = LiveRecording(state, tmp_path / "follow.rrd")
    forecaster = Forecaster(plans.first, model, samples=4)
    follow(lines(), state, forecaster, [told.append, recorded], every_s=20.0)
    assert state.violations == []
    assert state.outcome == run.outcome
    assert (tmp_path / "follow.rrd").stat().st_size > 0
    assert told[-1] is state


def test_a_version_that_is_not_there_is_named(run: Operated, tmp_path: Path) -> None:
    folder = tmp_path / "cut"
    shutil.copytree(run.folder, folder)
    shutil.rmtree(folder / VERSIONS / "2")
    printed = invoke("follow", folder, folder / EVENTS, "--once", code=2)
    assert f"{VERSIONS}/2" in printed.stderr.replace("\n", "")


def test_a_run_without_an_operation_has_one_plan(run: Operated) -> None:
    alone = plan_history(run.folder / FIRST)
    assert (alone.version, alone.late) == (None, frozenset())
    state = FollowedRun(alone.first)
    swap = next(event for event in run.events if event.kind == "replanned")
    assert state.apply(swap)

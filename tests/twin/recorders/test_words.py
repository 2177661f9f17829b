"""Words for tasks and waits: the part, the step, and whom a robot waits for under each policy."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planning.tasks.task import TRANSIT, Task
from scheduling.graph.task_edges import with_barriers
from tests.twin.recorders.recorded_toys import rows, toy_of
from tests.twin.simulated import simulate
from tests.twin.twin_toys import two_robot_tpg
from twin.recorders.observers import MemoryRecorder
from twin.recorders.rerun.event_rows import PlanWords
from twin.recorders.rerun.recorder import write_recording
from twin.run.activities import IDLE, RETRYING, STALLED
from twin.run.events import Policy
from twin.uncertainty.skill_durations import SkillDurations

PATH = np.zeros((1, 1))
SAID = {
    ("pick b1", "pick", 1, "b1"): "pick b1 (step 1/3)",
    ("HOME with b1", TRANSIT, 1, "b1"): "HOME with b1 (step 1/3)",
    ("to b1", TRANSIT, 1, None): "to b1 (step 1/3)",
    ("to b1", TRANSIT, 1, "b1"): "b1 to its place (step 1/3)",
    ("HOME", TRANSIT, 1, None): "HOME after b1 (step 1/3)",
    ("to its support", TRANSIT, 2, None): "to its support for b2 (step 2/3)",
    ("support step 2", "support-bottom", 2, None): "support for b2 (step 2/3)",
    ("place b2 from below", "place-up", 2, "b2"): "place b2 from below (step 2/3)",
    ("to goal 3", TRANSIT, 3, None): "to goal 3 (step 3/3)",
}


def test_tasks_name_part_and_step() -> None:
    tasks = tuple(
        Task(k, "robot_0", kind, step, label, PATH, object=part)
        for k, (label, kind, step, part) in enumerate(SAID)
    )
    words = PlanWords(replace(two_robot_tpg([]), tasks=tasks))
    assert [words.task(k) for k in range(len(tasks))] == list(SAID.values())
    assert words.task(-1) == words.task(len(tasks)) == ""
    assert words.state(STALLED, 0) == "stalled: pick b1 (step 1/3)"
    assert words.state(RETRYING, 0) == "tries again: pick b1 (step 1/3)"
    assert words.state("pick", 0) == "pick b1 (step 1/3)"
    assert words.state(IDLE, 0) == IDLE
    assert words.state(STALLED, -1) == STALLED


def test_waits_name_robot_and_task_until_it_is_complete() -> None:
    words = PlanWords(two_robot_tpg([(0, 0, 1, 1), (0, 2, 1, 1)]))
    done = {(0, 0)}
    assert words.wait(1, 1, lambda *node: node in done) == (
        "waits for robot_0: transit 0 (step 1/1)"
    )
    done.add((0, 2))
    assert words.wait(1, 1, lambda *node: node in done) == ""
    assert words.wait(1, 0, lambda *_: False) == ""
    assert ("waits for robot_0: transit 0 (step 1/1)", "waiting") in words.lane(1)


@pytest.mark.parametrize(
    "policy", ["asynchronous", "sequential", "synchronous", "open-loop"]
)
def test_waits_are_told_under_every_policy(policy: Policy, tmp_path: Path) -> None:
    tpg, memory = toy_of(["gp4", "gp4"]), MemoryRecorder()
    tpg = replace(tpg, slots=np.arange(len(tpg.tasks)))
    nominal = SkillDurations({})
    run = simulate(tpg, nominal, seed=1, policy=policy, recorders=[memory])
    path = tmp_path / "run.rrd"
    write_recording(path, tpg, run, memory.events)
    texts = [cell[0] for _, cell in rows(path, "/events", "TextLog:text")]
    told = [text for text in texts if " waits for " in text]
    waits = [event for event in memory.events if event.kind == "waiting"]
    assert len(told) == len(waits) > 0
    graph = with_barriers(tpg) if policy == "synchronous" else tpg
    for text, event in zip(told, waits, strict=True):
        assert "node" not in text
        if policy == "open-loop":
            assert text == f"{event.robot} {event.detail}"
            continue
        k = tpg.chain_index[event.robot]
        sources = {
            f"{event.robot} waits for {graph.chains[a].robot}: task"
            for a, m, b, n in graph.edges.tolist()
            if (b, n) == (k, event.node) and run.end_ns[a][m] > event.t_ns
        } or {f"{event.robot} {event.detail}"}
        assert any(text.startswith(source) for source in sources)

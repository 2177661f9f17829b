"""A dispatcher that is killed while drivers of their own processes move the robots, and goes on."""

import json
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

import twin
from planning.errors import TwinError
from scheduling.graph.plan_files import load_plan
from scheduling.graph.task_edges import actuation_nodes
from tests.twin.live.handed_bar import BAR
from tests.twin.operate.operated import STACK
from twin.live.history import ANEW, history_of
from twin.run.events import Event
from twin.trial.trial import resume_run

pytest.importorskip("grpc")

NIGHTLY = pytest.mark.nightly

Lines = list[dict[str, object]]


def started(*words: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "twin.cli", *map(str, words), "--quiet"]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True)


def lines(log: Path) -> Lines:
    text = log.read_text() if log.exists() else ""
    return [json.loads(line) for line in text.splitlines() if line.endswith("}")]


def completed(events: Lines) -> int:
    return sum(event["kind"] == "completed" for event in events)


def closing(events: Lines, out: Path) -> bool:
    """Whether the giver has begun the node in which the hand of the other robot closes."""
    begun = {
        e["node"] for e in events if (e["kind"], e["robot"]) == ("started", "left")
    }
    if not begun:
        return False
    tpg = load_plan(out)
    acts = actuation_nodes(tpg)[tpg.chain_index["left"]]
    return any(node in begun for node, act in acts.items() if act.robot == "right")


@pytest.mark.parametrize(
    ("text", "pace", "until"),
    [
        (STACK, 20.0, lambda events, _: completed(events) > 100),
        # While a hand closes for another robot.
        pytest.param(BAR, 2.0, lambda *so_far: closing(*so_far), marks=NIGHTLY),
    ],
)
def test_a_dispatcher_that_was_killed_goes_on_and_clears_nothing_twice(
    tmp_path: Path, text: str, pace: float, until: Callable[[Lines, Path], bool]
) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    scenario, out = tmp_path / "stack.yaml", tmp_path / "run"
    scenario.write_text(text)
    (tmp_path / "drivers.yaml").write_text(
        f"pace: {pace}\nlisten: {address}\n"
        "robots: {left: {kind: grpc}, right: {kind: grpc}}\n"
    )
    arms = [started("drive", address, n, "--pace", pace) for n in ("left", "right")]
    files = ("--drivers", tmp_path / "drivers.yaml", "--out", out, "--no-recording")
    first = started("operate", scenario, *files)
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline:
        if until(lines(out / "events.jsonl"), out):
            break
        time.sleep(0.02)
    first.kill()
    first.communicate()
    before = lines(out / "events.jsonl")
    assert before
    # Meanwhile drivers go on to the end of what they are cleared for.
    done = resume_run(out)
    for arm in arms:
        assert arm.wait(20) == 0
        arm.communicate()
    assert done.outcome == "completed"
    assert done.summary["audit"]["violations"] == []
    events = lines(out / "events.jsonl")
    assert events[: len(before)] == before
    assert sum(e["detail"] == ANEW for e in events) == 1
    released = [(e["robot"], e["node"]) for e in events if e["kind"] == "released"]
    assert len(released) == len(set(released))
    chains = load_plan(out).chains
    assert len(released) == sum(map(len, chains))
    # Killed once all was over, when drivers had left: there is nobody to wait for.
    log = out / "events.jsonl"
    log.write_text("".join(log.read_text().splitlines(keepends=True)[:-1]))
    (out / "summary.json").unlink()
    begin_s = time.monotonic()
    assert resume_run(out).outcome == "completed"
    assert time.monotonic() - begin_s < 50.0


def test_what_was_planned_anew_is_not_gone_on_with() -> None:
    tpg = twin.plan("tray").tpg
    robot = tpg.chains[0].robot
    told = [
        Event(0, robot, "released", 0, 0),
        Event(5, robot, "started", 0, 0),
        Event(7, "", "ordered", detail="hold"),
        Event(9, robot, "ordered", detail="go_on"),
    ]
    found = history_of(tpg, told)
    assert (found.cleared_ns[0], found.start_ns[0], found.end_ns[0]) == ([0], [5], [])
    assert found.held == {chain.robot for chain in tpg.chains[1:]}
    assert found.since_ns == 9
    with pytest.raises(TwinError, match=r"at 12\.000 s something failed"):
        history_of(tpg, [*told, Event(12 * 10**9, robot, "failed", 0, 0)])

"""Plans that drivers execute: simulated arms, and wires that fail, and a dispatcher that is killed and goes on."""

import errno
import json
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader

import twin
from planning.errors import OutputError, RequestError, TwinError
from scheduling.graph.actuations import actuation_nodes
from scheduling.graph.plan_files import load_plan
from scheduling.verification.verify import verify_plan
from tests.twin.live.handed_bar import BAR
from tests.twin.operations.operated import STACK, stack
from twin.drivers.driver import ClearedNode, DriverState
from twin.drivers.simulated_arm import SimulatedArm
from twin.engine.execution import Ports
from twin.exports.ros.mcap_file import mcap_files
from twin.live.driver_end import DriverEnd, LocalWire
from twin.live.link import Link
from twin.live.measured_log import MeasuredLog
from twin.live.messages import Command, Report
from twin.live.remote_robots import RemoteRobots
from twin.live.run_history import history_of
from twin.operations.operation import Operation, operate
from twin.operations.recovery import Recovery
from twin.recorders.observers import MemoryRecorder
from twin.runs.events import Event, EventCode
from twin.trial.plan_result import PlanResult
from twin.trial.resume import resume_run
from twin.trial.run_result import RunResult
from twin.trial.simulation import scenario_execution
from twin.uncertainty.disturbances import Disturbances

PACE = 60.0

pytestmark = pytest.mark.timeout(300)


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> PlanResult:
    return stack(tmp_path_factory.mktemp("stack"))


@dataclass
class Watched(LocalWire):
    """A wire that notes what it carries, and carries nothing at some times."""

    end: DriverEnd
    cut: Callable[[], bool] = lambda: False
    sent: list[Command] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__(self.end, 0.001)

    def open(self, deliver: Callable[[Report], None]) -> None:
        super().open(lambda report: None if self.cut() else deliver(report))

    def send(self, command: Command) -> None:
        self.sent.append(command)
        if not self.cut():
            super().send(command)


def live(
    plan: PlanResult,
    arms: dict[str, SimulatedArm],
    cuts: dict[str, Callable[[], bool]] | None = None,
    written: Callable[[], None] = lambda: None,
    measured: Path | None = None,
    memory: MemoryRecorder | None = None,
    lease_s: float = 10.0,
    out_s: float = 60.0,
    **values: Any,
) -> tuple[Operation, list[Event], dict[str, Watched]]:
    """Operate a plan with some arms; return what was told, and what was sent to them."""
    memory, links, wires = memory or MemoryRecorder(), {}, {}
    for robot in plan.tpg.cell.robots:
        arm = arms.get(robot.name) or SimulatedArm(pace=PACE)
        wires[robot.name] = Watched(DriverEnd(arm, robot.name, 1))
        if cuts and robot.name in cuts:
            wires[robot.name].cut = cuts[robot.name]
        links[robot.name] = Link(
            "run", robot.name, robot.home, lease_s=lease_s, ahead_s=None
        )
    sections = plan.scenario.varied({"recovery.planning_s": 0.0, **values}).sections
    model = scenario_execution(sections, plan.scenario.folder)
    done = operate(
        sections,
        plan.motions,
        plan.tpg,
        replace(model, disturbances=Disturbances()),
        seed=0,
        recorders=(memory,),
        ports=Ports(
            partial(
                RemoteRobots,
                links=links,
                wires=wires,
                written=written,
                measured=measured,
                out_s=out_s,
                tolerance=0.02,
                pace=PACE,
            )
        ),
    )
    return done, memory.events, wires


def placed(done: Operation) -> list[int]:
    return sorted(t.step for t in done.tpg.tasks if t.kind == "place-down")


def require_order(done: Operation) -> None:
    """Nobody has begun a node before all that it waits for was over."""
    start, end = done.record.start_ns, done.record.end_ns
    for a, u, b, v in done.tpg.edges.tolist():
        if start[b][v] >= 0:
            assert 0 <= end[a][u] <= start[b][v]


def test_a_cell_of_drivers_is_audited_by_what_they_have_measured(
    tmp_path: Path,
) -> None:
    (tmp_path / "stack.yaml").write_text(STACK)
    (tmp_path / "drivers.yaml").write_text(f"pace: {PACE}\n")
    done = twin.operate(
        tmp_path / "stack.yaml", drivers=tmp_path / "drivers.yaml", out=tmp_path / "run"
    )
    assert done.outcome == "completed"
    assert done.summary["audit"]["violations"] == []
    assert not verify_plan(load_plan(tmp_path / "run")).problems
    table = pq.read_table(tmp_path / "run" / "trajectory.parquet")
    assert table.schema.metadata[b"measured"] == b"left,right"
    for own in done.summary["tracking"].values():
        assert own["joint"] < 1e-9
        assert own["tool_m"] < 1e-9
    (bag,) = mcap_files(RunResult(tmp_path / "run")).values()
    summary = make_reader(BytesIO(bag)).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    counts = {
        channel.topic: summary.statistics.channel_message_counts[key]
        for key, channel in summary.channels.items()
    }
    for robot in ("left", "right"):
        planned_too = counts[f"/{robot}/planned/joint_states"]
        assert planned_too == counts[f"/{robot}/joint_states"] > 100
    # Motions are as quick as in the twin; how long robots wait for each other depends on how busy the machine is.
    planned = twin.operate(tmp_path / "stack.yaml", out=tmp_path / "twin")
    assert planned.summary["makespan_s"] < done.summary["makespan_s"]
    took, planned_s = [], []
    assert done.record is not None
    for chain, start, end in zip(
        done.tpg.chains, done.record.start_ns, done.record.end_ns, strict=True
    ):
        took += ((end - start) / 1e9).tolist()
        planned_s += chain.duration.tolist()
    some = np.array(planned_s) > 0.1
    assert np.median(np.array(took)[some] / np.array(planned_s)[some]) < 1.1


def test_a_node_is_in_the_log_before_its_driver_is_cleared_for_it(
    plan: PlanResult,
) -> None:
    count = [0]

    def written() -> None:
        count[0] += 1

    done, events, wires = live(plan, {}, written=written)
    require_order(done)
    released = [e for e in events if e.kind == "released"]
    sent = {n.node for c in wires["left"].sent for n in c.nodes}
    assert sent == {e.node for e in released if e.robot == "left"}
    assert count[0] == sum(bool(c.nodes) for w in wires.values() for c in w.sent)


def test_a_skill_that_a_driver_reports_as_failed_is_planned_anew(
    plan: PlanResult,
) -> None:
    failed: list[str] = []

    def fails(node: ClearedNode) -> bool:
        if node.kind == "pick" and not failed:
            failed.append(node.object)
            return True
        return False

    arm = SimulatedArm(pace=PACE, fails=fails)
    done, events, _ = live(plan, {"left": arm})
    assert done.record.outcome == "completed"
    assert placed(done) == [1, 2, 3, 4]
    require_order(done)
    (own,) = (e for e in events if e.kind == "failed")
    assert own.detail == f"pick {failed[0]} failed"
    assert any(e.kind == "recovered" for e in events)


@dataclass
class Breaking(SimulatedArm):
    """An arm that can do no more from some node on."""

    at: int
    within: bool

    def __post_init__(self) -> None:
        super().__init__(pace=PACE)

    def state(self) -> DriverState:
        state = super().state()
        if state.done < self.at or (self.within and state.begun <= self.at):
            return state
        self._words = "collision reflex"
        begun = self.at + self.within
        samples = tuple(s for s in state.samples if s.done <= self.at)
        return replace(
            state,
            mode="fault",
            words="collision reflex",
            done=self.at,
            begun=begun,
            samples=samples,
        )


def test_a_robot_that_breaks_down_within_a_node_ends_the_run_with_the_cause(
    plan: PlanResult,
) -> None:
    done, events, _ = live(plan, {"left": Breaking(40, within=True)})
    assert done.record.outcome == "failed"
    assert events[-2].detail == "left collision reflex"
    assert [e.detail for e in events if e.kind == "stopped"] == ["collision reflex"]
    # The same as data, for who is to see to it.
    assert done.ended is not None
    assert (done.ended.code, done.ended.robot) == ("driver-lost", "left")
    assert done.ended.words in done.record.failure
    own = next(node for node in done.ended.pending if node.robot == "left")
    assert (own.node, own.released, own.mode) == (40, True, "fault")
    assert done.content()["ended"] == asdict(done.ended)


def test_nothing_is_cleared_to_a_driver_that_gives_no_sign_of_life(
    plan: PlanResult,
) -> None:
    memory, until = MemoryRecorder(), [0.0]

    def cut() -> bool:
        """From the first nodes on until some time after that has been told."""
        told = [e.kind for e in tuple(memory.events) if e.robot == "left"]
        if "stopped" not in told:
            return told.count("completed") > 20
        until[0] = until[0] or time.monotonic() + 0.5
        return time.monotonic() < until[0]

    done, events, wires = live(plan, {}, {"left": cut}, memory=memory, lease_s=1.0)
    assert done.record.outcome == "completed"
    require_order(done)
    # The other one, too, may seem silent where the machine is busy.
    stopped = [e for e in events if e.kind == "stopped" and e.robot == "left"]
    resumed = [e for e in events if e.kind == "resumed" and e.robot == "left"]
    assert {e.detail for e in stopped} == {"no sign of life"}
    assert len(resumed) == len(stopped)
    lower, upper = stopped[0].t_ns, resumed[0].t_ns
    quiet = [e for e in events if e.kind == "released" and lower < e.t_ns < upper]
    assert not [e for e in quiet if e.robot == "left"]
    numbers = [c.number for c in wires["left"].sent]
    assert numbers == sorted(set(numbers))


def test_drivers_are_heard_while_something_is_planned(
    plan: PlanResult, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Planning takes longer than a driver may be silent; nothing more is cleared meanwhile."""
    lease_s = 3.0
    planned = Recovery.recover
    within: list[tuple[float, float]] = []

    def slowly(self: Recovery, *about: Any) -> Any:
        begin = time.monotonic()
        time.sleep(1.5 * lease_s)
        found = planned(self, *about)
        within.append((begin, time.monotonic()))
        return found

    monkeypatch.setattr(Recovery, "recover", slowly)
    failed: list[int] = []

    def fails(node: ClearedNode) -> bool:
        if node.kind != "pick" or failed:
            return False
        failed.append(node.node)
        return True

    heard: list[float] = []
    original = Link.receive

    def receive(self: Link, report: Report, now_s: float) -> DriverState | None:
        heard.append(now_s)
        return original(self, report, now_s)

    monkeypatch.setattr(Link, "receive", receive)
    arm = SimulatedArm(pace=PACE, fails=fails)
    done, events, _ = live(plan, {"left": arm}, lease_s=lease_s)
    assert done.record.outcome == "completed"
    require_order(done)
    (begin, end), *_ = within
    assert sum(begin < at < end for at in heard) > 20
    assert not [e for e in events if e.kind == "stopped"]


def test_a_log_that_cannot_be_written_stops_the_run(plan: PlanResult) -> None:
    def full() -> None:
        raise OutputError("events.jsonl: no space left on device")

    with pytest.raises(OutputError, match="no space"):
        live(plan, {}, written=full)


@pytest.mark.parametrize("room", [0, 50])
def test_a_disk_that_is_full_keeps_nobody_waiting(
    plan: PlanResult, room: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Samples cannot be written: the run ends, its drivers stand, and nothing of it goes on."""
    arms = {chain.robot: SimulatedArm(pace=PACE) for chain in plan.tpg.chains}
    before, memory = set(threading.enumerate()), MemoryRecorder()
    flush, close = MeasuredLog.flush, MeasuredLog.close

    def full(self: MeasuredLog) -> None:
        if len(memory.events) >= room:
            raise OSError(errno.ENOSPC, "No space left on device")
        flush(self)

    def closed(self: MeasuredLog) -> None:
        close(self)
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(MeasuredLog, "flush", full)
    monkeypatch.setattr(MeasuredLog, "close", closed)
    with pytest.raises(OSError, match="No space left"):
        live(plan, arms, measured=tmp_path / "measured.csv", memory=memory)
    told = [e.detail for e in memory.events if e.kind == "finished"]
    assert told == (["failed"] if room else [])
    while set(threading.enumerate()) - before:
        time.sleep(0.01)


def test_a_robot_that_is_not_heard_of_at_all_is_named(plan: PlanResult) -> None:
    with pytest.raises(RequestError, match="no driver of right has been heard of"):
        live(plan, {}, {"right": lambda: True}, out_s=5.0)


def test_all_stop_where_one_is_off_its_path(plan: PlanResult) -> None:
    first, other = (chain.robot for chain in plan.tpg.chains)
    arms = {name: SimulatedArm(pace=PACE) for name in (first, other)}
    whole = arms[first].state

    def state() -> DriverState:
        found = whole()
        return replace(found, off=0.019 if found.done < 100 else 0.021)

    arms[first].state = state  # type: ignore[method-assign]
    done, events, _ = live(plan, arms)
    assert done.record.outcome == "failed"
    (why,) = [e.detail for e in events if e.kind == "failed"]
    assert why == f"{first} is 0.021 rad or m off its path, more than 0.02"
    assert done.ended is not None
    assert (done.ended.code, done.ended.robot) == ("off-path", first)
    (told,) = [e for e in events if e.kind == "stopped"]
    assert told.robot == first
    assert all(e.t_ns <= told.t_ns for e in events if e.kind == "released")
    # Nobody is where nobody has been cleared for, and nobody goes on.
    before = [arm.state().q for arm in arms.values()]
    time.sleep(0.05)
    for arm, q in zip(arms.values(), before, strict=True):
        assert (arm.state().q == q).all()


def test_a_driver_that_falls_silent_for_good_is_done_without(plan: PlanResult) -> None:
    first = plan.tpg.chains[0].robot
    at = [0.0]

    def cut() -> bool:
        """Silent from when it stands at the end of all that it was cleared for."""
        return bool(at[0])

    arm = SimulatedArm(pace=PACE)
    whole = arm.state

    def state() -> DriverState:
        found = whole()
        if found.done > 100 and found.begun == found.done:
            at[0] = 1.0
        return found

    arm.state = state  # type: ignore[method-assign]
    done, events, _ = live(plan, {first: arm}, {first: cut}, lease_s=1.0, out_s=5.0)
    told = [e.detail for e in events if e.kind == "stopped"]
    assert told[-1] == "has not been heard of for 5 s"
    if done.out:
        assert done.out == {first}
        # The other one does what it can, and the rest is named.
        assert sorted({*placed(done), *done.given_up}) == [1, 2, 3, 4]
    else:
        assert events[-2].detail == f"{first} has not been heard of for 5 s"
        assert done.ended is not None
        assert (done.ended.code, done.ended.robot) == ("driver-lost", first)


pytest.importorskip("grpc")

NIGHTLY = pytest.mark.nightly

Lines = list[dict[str, object]]


def started(*words: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "twin.cli", *map(str, words), "--quiet"]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True)


def listens(address: str) -> bool:
    """Tell whether a cell is there: on a busy machine it may plan for longer than drivers ask for it."""
    host, _, port = address.partition(":")
    with socket.socket() as asked:
        return asked.connect_ex((host, int(port))) == 0


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
        (STACK, 20.0, lambda events, _: completed(events) > 40),
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
        f"pace: {pace}\nlisten: {address}\nout_s: 600\n"
        "robots: {left: {kind: grpc}, right: {kind: grpc}}\n"
    )
    files = ("--drivers", tmp_path / "drivers.yaml", "--out", out, "--no-recording")
    first = started("operate", scenario, *files)
    while not listens(address):
        assert first.poll() is None
        time.sleep(0.02)
    arms = [started("drive", address, n, "--pace", pace) for n in ("left", "right")]
    while not until(lines(out / "events.jsonl"), out):
        assert first.poll() is None
        time.sleep(0.02)
    first.kill()
    first.communicate()
    before = lines(out / "events.jsonl")
    assert before
    # Meanwhile drivers go on to the end of what they are cleared for.
    done = resume_run(out)
    for arm in arms:
        assert arm.wait() == 0
        arm.communicate()
    assert done.outcome == "completed"
    assert done.summary["audit"]["violations"] == []
    events = lines(out / "events.jsonl")
    assert events[: len(before)] == before
    assert sum(e["detail"] == EventCode.DISPATCHER_RESTARTED for e in events) == 1
    released = [(e["robot"], e["node"]) for e in events if e["kind"] == "released"]
    assert len(released) == len(set(released))
    chains = load_plan(out).chains
    assert len(released) == sum(map(len, chains))
    # Killed once all was over, when drivers had left: there is nobody to wait for.
    log = out / "events.jsonl"
    log.write_text("".join(log.read_text().splitlines(keepends=True)[:-1]))
    (out / "summary.json").unlink()
    # Who waited for them would do so for longer than the test may take.
    assert resume_run(out).outcome == "completed"


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

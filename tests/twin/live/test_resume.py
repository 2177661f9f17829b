"""Sessions that are killed anywhere and resumed, without clocks and sockets: they complete, or end with the cause."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from scheduling.graph.dispatcher import Dispatcher
from scheduling.graph.temporal_plan_graph import EVER, TemporalPlanGraph
from tests.twin.twin_toys import random_tpg, two_robot_tpg
from twin.drivers.driver import ClearedNode, DriverState
from twin.drivers.simulated_arm import SimulatedArm
from twin.durations.nanoseconds import NANOSECONDS
from twin.engine.ending import PendingNode
from twin.engine.execution import Execution, Ports
from twin.engine.execution_model import Messages
from twin.live.driver_end import DriverEnd
from twin.live.inbox import Inbox
from twin.live.link import Link
from twin.live.messages import Command, Report
from twin.live.remote_robots import RemoteRobots
from twin.live.run_history import history_of
from twin.operations.replanner import RollingReplanner
from twin.recorders.observers import MemoryRecorder, Observers
from twin.runs.events import Event
from twin.uncertainty.node_times import NodeTimes
from twin.uncertainty.skill_durations import nominal_ns

pytestmark = pytest.mark.timeout(300)

STEP_S, LEASE_S, OUT_S = 0.02, 0.5, 30.0
ENDLESS_S = 2000.0
"""A session that takes so long waits for ever: its plan takes less than 20 s [s]."""


class KilledError(BaseException):
    """The dispatcher is killed; nothing that it does afterwards has an effect."""


@dataclass
class Ether:
    """Time and messages of a cell: each message may be late, doubled, lost, or come after later ones."""

    rng: random.Random
    loses: float = 0.0
    doubles: float = 0.0
    latest_s: float = 0.0
    now_s: float = 0.0
    ends: dict[str, DriverEnd] = field(default_factory=dict)
    cut_s: dict[str, float] = field(default_factory=dict)
    """Nothing comes to and from a driver before that time."""
    commands: list[tuple[float, Command]] = field(default_factory=list)
    reports: list[tuple[float, Report]] = field(default_factory=list)

    def clock(self) -> float:
        return self.now_s

    def carry(self, message: Any, under_way: list[tuple[float, Any]]) -> None:
        if self.now_s < self.cut_s.get(message.robot, 0.0):
            return
        for _ in range(1 + (self.rng.random() < self.doubles)):
            if self.rng.random() >= self.loses:
                late = self.rng.uniform(0.0, self.latest_s)
                under_way.append((self.now_s + late, message))

    def _due(self, under_way: list[tuple[float, Any]]) -> list[Any]:
        here = [item for item in under_way if item[0] <= self.now_s]
        under_way[:] = [item for item in under_way if item[0] > self.now_s]
        self.rng.shuffle(here)
        return [message for _, message in here]

    def pass_by(self, seconds: float) -> list[Report]:
        """Let time pass; return the reports that arrive at its end."""
        while seconds > 0.0:
            self.now_s += min(STEP_S, seconds)
            seconds -= STEP_S
            for command in self._due(self.commands):
                self.ends[command.robot].receive(command)
            for end in self.ends.values():
                self.carry(end.report(), self.reports)
        return self._due(self.reports)


class WaitingInbox(Inbox):
    """Reports of a dispatcher, whose waiting lets time pass."""

    def __init__(self, ether: Ether, dies: Callable[[], bool]) -> None:
        super().__init__()
        self.ether, self.dies = ether, dies

    def get(self, timeout: float) -> Report:
        if self._queue.empty():
            if self.dies():
                raise KilledError
            assert self.ether.now_s < ENDLESS_S, "waits for ever"
            for report in self.ether.pass_by(timeout):
                self.put(report)
        return super().get(timeout=0.0)


@dataclass
class Cell:
    """A plan, its drivers, and what is on the disk of its dispatcher."""

    tpg: TemporalPlanGraph
    ether: Ether
    driven: tuple[str, ...]
    pace: float = 1.0
    slow_s: float = 0.0
    log: list[Event] = field(default_factory=list)
    kept: int = 0
    arms: dict[str, SimulatedArm] = field(default_factory=dict)
    instance: int = 0
    out_s: float = OUT_S
    measured: Path | None = None

    def start_driver(
        self, name: str, kind: type[SimulatedArm] = SimulatedArm, **options: Any
    ) -> None:
        self.instance += 1
        arm = kind(self.ether.clock, pace=self.pace, **options)
        self.arms[name] = arm
        self.ether.ends[name] = DriverEnd(arm, name, self.instance, self.ether.clock)

    def restart_driver(self, name: str) -> None:
        at = self.arms[name].state().q
        stands = at if at.size else self.tpg.chains[self.tpg.chain_index[name]].start
        self.start_driver(name, stands=stands)

    def dispatcher(self, dies: Callable[[], bool] = lambda: False) -> Execution:
        """Start a dispatcher with what is on its disk."""
        ether, memory = self.ether, MemoryRecorder()
        memory.events = self.log
        for name in self.driven:
            ether.cut_s[name] = ether.now_s + ether.rng.choice([0.0, 0.4, 3.0])
        history = None
        if self.log:
            history = history_of(self.tpg, self.log)
            now_ns = round(ether.now_s * self.pace * NANOSECONDS)
            history.since_ns = max(history.since_ns, now_ns)
        dead = [False]

        def die() -> bool:
            dead[0] = dead[0] or dies()
            return dead[0]

        def written() -> None:
            if not dead[0]:
                self.kept = len(self.log)
                wait(self.slow_s)

        inbox = WaitingInbox(ether, die)

        def wait(most_s: float) -> None:
            """Wait for the disk; reports come meanwhile, and are not heard."""
            for report in ether.pass_by(ether.rng.uniform(0.0, most_s)):
                inbox.put(report)

        slow_s = self.slow_s

        class Wire:
            def open(self, deliver: Callable[[Report], None]) -> None: ...
            def close(self) -> None: ...
            def send(self, command: Command) -> None:
                if not dead[0]:
                    ether.carry(command, ether.commands)

        class Log(MemoryRecorder):
            def record(self, event: Event) -> None:
                if not dead[0]:
                    memory.record(event)
                    if event.kind == "completed":
                        wait(slow_s)

        motion = tuple(nominal_ns(self.tpg))
        times = NodeTimes(
            motion,
            tuple(np.zeros_like(own) for own in motion),
            tuple(() for _ in motion),
            tuple(-1 for _ in motion),
        )
        robots = [r for r in self.tpg.cell.robots if r.name in self.driven]
        planner: Any = SimpleNamespace(
            initial=None,
            due=lambda *_: False,
            is_short=lambda _: False,
            with_measure=lambda state, _: state,
        )
        remote = partial(
            RemoteRobots,
            links={r.name: Link("run", r.name, r.home, LEASE_S) for r in robots},
            wires={r.name: Wire() for r in robots},
            written=written,
            out_s=self.out_s,
            measured=self.measured,
            pace=self.pace,
            history=history,
            clock=ether.clock,
            inbox=inbox,
        )
        return Execution(
            self.tpg,
            times,
            Dispatcher(self.tpg),
            Messages(),
            Ports(remote, replanner=partial(RollingReplanner, planner=planner)),
            observers=Observers((Log(),)),
        )


def require_whole(cell: Cell) -> None:
    """Every node was released, begun and completed once, after all that it waited for."""
    tpg, at = cell.tpg, {}
    counts = Counter((e.kind, e.robot, e.node, e.object) for e in cell.log)
    for place, event in enumerate(cell.log):
        at[event.kind, event.robot, event.node] = place
    for chain in tpg.chains:
        for node in range(len(chain)):
            for kind in ("released", "started", "completed"):
                assert counts[kind, chain.robot, node, ""] == 1, (kind, node)
    for kind in ("attached", "detached"):
        told = [(e.robot, e.node, e.object) for e in cell.log if e.kind == kind]
        assert len(told) == len(set(told))
    names = [chain.robot for chain in tpg.chains]
    patience = tpg.patience if len(tpg.patience) else np.full(len(tpg.edges), EVER)
    for (a, u, b, v), least in zip(tpg.edges.tolist(), patience, strict=True):
        if least >= EVER:
            assert at["completed", names[a], u] < at["released", names[b], v]


def killed_and_resumed(
    seed: int,
    loses: float,
    latest_s: float,
    slow_s: float,
    kills: int,
    *,
    to_the_end: bool = False,
) -> None:
    rng = random.Random(seed)
    tpg = random_tpg(rng.randrange(2**31), dofs=(2, 3, 1), tasks=rng.randint(3, 8))
    if rng.random() < 0.3:
        times = [rng.choice([EVER, rng.randrange(NANOSECONDS)]) for _ in tpg.edges]
        tpg = replace(tpg, patience=np.array(times, dtype=np.int64))
    # What no driver moves takes the time that the plan says, as machines do.
    driven = tuple(chain.robot for chain in tpg.chains[: rng.choice([2, 3])])
    ether = Ether(rng, loses, doubles=loses, latest_s=latest_s)
    cell = Cell(tpg, ether, driven, pace=rng.choice([1.0, 4.0]), slow_s=slow_s)
    for name in driven:
        cell.start_driver(name)
    for _ in range(kills):
        lines = rng.randrange(6 * sum(map(len, tpg.chains)))
        run = cell.dispatcher(lambda lines=lines: len(cell.log) >= lines)  # type: ignore[misc]
        try:
            assert run.execute() == "completed", run.ended
            break
        except KilledError:
            # All that a driver was cleared for is on the disk; of the rest, some.
            del cell.log[max(rng.randint(0, len(cell.log)), cell.kept) :]
        pause_s = 20.0 if to_the_end else rng.choice([0.0, rng.uniform(0.0, 3.0), 20.0])
        ether.pass_by(pause_s)
        if not to_the_end and rng.random() < 0.2:
            cell.restart_driver(rng.choice(driven))
    else:
        run = cell.dispatcher()
        assert run.execute() == "completed", run.ended
    require_whole(cell)
    for name in driven:
        goal = tpg.chains[tpg.chain_index[name]].waypoints[-1]
        assert np.allclose(cell.arms[name].state().q, goal)


@settings(max_examples=24)
@example(seed=1, loses=0.0, latest_s=0.0, slow_s=0.0, kills=1)
# Killed again before anything is on the disk of what it was resumed for.
@example(seed=58, loses=0.0, latest_s=0.0, slow_s=0.0, kills=2)
# Killed after a node was released whose patience was over, and before it was complete.
@example(seed=731644238, loses=0.0, latest_s=0.0, slow_s=0.0, kills=3)
@given(
    seed=st.integers(0, 2**32 - 1),
    loses=st.sampled_from([0.0, 0.3]),
    latest_s=st.sampled_from([0.0, 0.2, 1.0]),
    slow_s=st.sampled_from([0.0, 2.0 * LEASE_S]),
    kills=st.integers(1, 3),
)
def test_a_session_that_was_killed_anywhere_completes(
    seed: int, loses: float, latest_s: float, slow_s: float, kills: int
) -> None:
    killed_and_resumed(seed, loses, latest_s, slow_s, kills)


def test_a_session_goes_on_from_every_line_of_its_log() -> None:
    """Its drivers were started anew, too, and know nothing but where they stand."""
    tpg = random_tpg(4, dofs=(2, 1), tasks=4, nodes_per_transit=2, edges=3)
    names = tuple(chain.robot for chain in tpg.chains)

    def started(log: Sequence[Event], driven: tuple[str, ...]) -> Cell:
        cell = Cell(tpg, Ether(random.Random(0)), driven, pace=4.0, log=[*log])
        for name in driven:
            cell.start_driver(name)
        assert cell.dispatcher().execute() == "completed"
        require_whole(cell)
        return cell

    for driven in (names, names[:1], names[1:]):
        whole = started((), driven).log
        assert {"attached", "detached"} <= {event.kind for event in whole}
        for count in range(1, len(whole)):
            started(whole[:count], driven)


@pytest.mark.parametrize("seed", range(4))
def test_drivers_that_came_to_the_end_of_what_they_were_cleared_for_are_cleared_for_more(
    seed: int,
) -> None:
    killed_and_resumed(seed, 0.0, 0.0, 0.0, 3, to_the_end=True)


def two_robots(
    edges: list[tuple[int, int, int, int]],
    log: Sequence[Event] = (),
) -> Cell:
    """Return two robots of three nodes of 1 s each, with what is in the log."""
    ether = Ether(random.Random(0))
    cell = Cell(two_robot_tpg(edges), ether, ("robot_0", "robot_1"), log=[*log])
    for name in cell.driven:
        cell.start_driver(name)
    return cell


CLEARED = [Event(0, "robot_0", "released", 0, node) for node in range(3)]


def test_what_was_complete_before_the_dispatcher_begins_is_followed_by_what_waits_for_it() -> (
    None
):
    """All that there is to report is there while another driver is still waited for."""
    cell = two_robots([(0, 2, 1, 0)])
    first = cell.dispatcher(lambda: cell.kept >= 3)
    with pytest.raises(KilledError):
        first.execute()
    cell.ether.pass_by(10.0)
    run = cell.dispatcher()
    cell.ether.cut_s = {"robot_1": cell.ether.now_s + 1.0}
    assert run.execute() == "completed"
    require_whole(cell)


def test_a_driver_that_was_silent_when_it_was_to_be_cleared_is_cleared_once_it_is_heard_of() -> (
    None
):
    """Its reports have come, and wait while the disk is slow, for longer than a driver may be silent."""
    cell = two_robots([(0, 0, 1, 0), (1, 0, 0, 1)])
    cell.slow_s = 10.0 * LEASE_S
    assert cell.dispatcher().execute() == "completed"
    require_whole(cell)


class Resting(SimulatedArm):
    """An arm that never begins a node from one on."""

    def __init__(self, *about: Any, at: int, **options: Any) -> None:
        super().__init__(*about, **options)
        self.at = at

    def take(self, nodes: list[ClearedNode]) -> None:
        super().take([node for node in nodes if node.node < self.at])


def test_a_session_in_which_a_driver_does_not_go_on_ends_with_what_waits_for_it() -> (
    None
):
    cell = two_robots([(0, 2, 1, 0)])
    cell.start_driver("robot_0", kind=Resting, at=1)
    run = cell.dispatcher()
    assert run.execute() == "failed"
    assert run.ended is not None
    assert (run.ended.code, run.ended.robot) == ("nothing-to-come", "")
    first, second = run.ended.pending
    assert first == PendingNode("robot_0", 1, 0, True, (), "standing", False)
    assert second == PendingNode("robot_1", 0, 1, False, (("robot_0", 2),), "standing")
    assert OUT_S < cell.ether.now_s < 2.0 * OUT_S
    (told,) = [e.detail for e in cell.log if e.kind == "failed"]
    assert told == run.ended.words


class Crawling(SimulatedArm):
    """An arm that moves on and on in a node and comes to no end of it."""

    def __init__(self, *about: Any, at: int, **options: Any) -> None:
        super().__init__(*about, **options)
        self.at = at

    def state(self) -> DriverState:
        if self._done >= self.at:
            self._pace = 1e-9
        return super().state()


class Numb(SimulatedArm):
    """An arm that is in the middle of a node and says no more than that it is held."""

    def state(self) -> DriverState:
        own = super().state()
        self._held = self._done >= 1
        return replace(own, mode="held") if self._held else own


@pytest.mark.parametrize(
    ("kind", "options", "mode"),
    [(Crawling, {"at": 1}, "moving"), (Numb, {}, "held")],
)
def test_a_session_in_which_a_driver_makes_no_progress_for_ever_ends(
    kind: type[SimulatedArm], options: dict[str, Any], mode: str
) -> None:
    cell = two_robots([(0, 2, 1, 0)])
    cell.out_s = 2.0
    cell.start_driver("robot_0", kind=kind, **options)
    run = cell.dispatcher()
    assert run.execute() == "failed"
    assert run.ended is not None
    assert (run.ended.code, run.ended.robot) == ("no-progress", "")
    first, second = run.ended.pending
    assert (first.robot, first.node, first.mode) == ("robot_0", 1, mode)
    assert second.waits_for == (("robot_0", 2),)
    # Nodes take 1 s as planned.
    assert 10.0 * 3.0 < cell.ether.now_s < 12.0 * 3.0


class Unsampled(DriverEnd):
    """The end of a driver that keeps no samples, so that its first report has all the news."""

    def report(self) -> Report:
        own = super().report()
        state = replace(own.state, samples=())
        return replace(own, first=0, kept=0, state=state)


def test_what_a_driver_did_while_nothing_was_heard_of_it_comes_after_its_return() -> (
    None
):
    cell = two_robots([(0, 2, 1, 0)])
    arm, clock = cell.arms["robot_0"], cell.ether.clock
    cell.ether.ends["robot_0"] = Unsampled(arm, "robot_0", 99, clock)

    def cut() -> bool:
        if 0.5 < cell.ether.now_s < 1.5:
            cell.ether.cut_s["robot_0"] = 2.5
        return False

    assert cell.dispatcher(cut).execute() == "completed"
    told = [e for e in cell.log if e.robot == "robot_0"]
    kinds = [e.kind for e in told]
    stopped, resumed = kinds.index("stopped"), kinds.index("resumed")
    assert told[stopped].detail == "no sign of life"
    assert kinds[stopped:].count("completed") > 1
    assert not {"started", "completed"} & {*kinds[stopped:resumed]}


def test_a_session_that_nobody_can_let_go_on_ends_with_who_is_held() -> None:
    """A person had a robot stand; the dispatcher was killed, and nobody is there to give orders."""
    held = Event(0, "robot_0", "ordered", detail="hold")
    cell = two_robots([(0, 2, 1, 0)], [*CLEARED, held])
    run = cell.dispatcher()
    assert run.execute() == "failed"
    assert run.ended is not None
    assert run.ended.code == "nothing-to-come"
    assert [(node.robot, node.held) for node in run.ended.pending] == [
        ("robot_0", True),
        ("robot_1", False),
    ]


def test_a_plan_in_which_nodes_wait_for_each_other_ends_with_them() -> None:
    cell = two_robots([(0, 2, 1, 0), (1, 2, 0, 0)])
    run = cell.dispatcher()
    assert run.execute() == "failed"
    assert run.ended is not None
    waits = {node.robot: node.waits_for for node in run.ended.pending}
    assert waits == {"robot_0": (("robot_1", 2),), "robot_1": (("robot_0", 2),)}


def test_a_driver_that_says_nothing_that_is_believed_ends_the_session() -> None:
    """It is started anew within a node, and never takes up the session."""
    cell = two_robots([(0, 2, 1, 0)])
    run, deaf = cell.dispatcher(), DriverEnd(SimulatedArm(), "robot_0", 99)
    deaf.receive = lambda command: None  # type: ignore[method-assign]

    def dies() -> bool:
        if cell.ether.now_s > 0.5:
            cell.ether.ends["robot_0"] = deaf
        return False

    run = cell.dispatcher(dies)
    assert run.execute() == "failed"
    assert run.ended is not None
    assert run.ended.pending[0].robot == "robot_0"
    assert cell.ether.now_s < 4.0 * OUT_S


class Unheeding(DriverEnd):
    """The end of a driver that never says which commands it has heard of, so that no sample of it counts."""

    def report(self) -> Report:
        return replace(super().report(), seen=0)


def test_where_a_driver_was_is_known_by_its_reports_where_no_sample_counts() -> None:
    cell = two_robots([(0, 2, 1, 0)])
    arm, clock = cell.arms["robot_0"], cell.ether.clock
    cell.ether.ends["robot_0"] = Unheeding(arm, "robot_0", 99, clock)
    run = cell.dispatcher()
    assert run.execute() == "completed"
    require_whole(cell)
    found, chain = run.robots.measured()["robot_0"], cell.tpg.chains[0]
    assert len(chain) - 1 in found.node
    assert np.allclose(found.q[-1], chain.waypoints[-1])


@pytest.mark.parametrize(
    "row",
    [
        "robot_0,12,0.1,1,0,nan,;",
        "robot_0,12,0.1,1,0,0.0,0.0,0.0,0.0,0.0,;",
        "robot_0,twelve,0.1,1,0,0.0,;",
        f"robot_0,{10**30},0.1,1,0,0.0,;",
        f"robot_0,12,0.1,{10**9},{10**9},0.0,;",
        "robot_0,12,0.1,0,1,0.0,;",
        "robot_0,12,0.1,-1,-1,0.0,;",
        "nobody,12,0.1,1,0,0.0,;",
        "robot_0,;",
        "#begin,;",
        "#begin,nan,;",
        ";",
        "\udcff\udcfe,;",
    ],
)
def test_a_damaged_row_of_samples_changes_nothing(tmp_path: Path, row: str) -> None:
    cell = two_robots([(0, 2, 1, 0)], CLEARED)
    cell.measured = tmp_path / "measured.csv"
    cell.measured.write_text(f"{row}\n", errors="surrogateescape")
    run = cell.dispatcher()
    assert run.execute() == "completed"
    require_whole(cell)
    for rows in run.robots.measured().values():
        assert np.isfinite(rows.q).all()
        assert rows.t_ns.max() < 60 * NANOSECONDS

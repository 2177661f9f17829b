"""Dispatcher and driver, while messages between them are late, doubled, lost and overtaken, and both start anew."""

import random
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from twin.drivers.driver import ClearedNode
from twin.drivers.simulated_arm import SimulatedArm
from twin.live.driver_end import DriverEnd
from twin.live.link import Link
from twin.live.messages import Command, Report

TICK_S = 0.05
START = np.zeros(2)


def some_nodes(rng: random.Random, count: int) -> list[ClearedNode]:
    """Return nodes of tasks of one to three nodes each, every other one a skill."""
    nodes: list[ClearedNode] = []
    task, at = 0, START
    while len(nodes) < count:
        for _ in range(rng.randint(1, 3)):
            points = rng.randint(1, 3)
            ways = np.array([[rng.uniform(0.1, 1.0), 0.3] for _ in range(points)])
            waypoints = at + np.cumsum(ways, axis=0)
            seconds = np.cumsum([rng.uniform(0.02, 0.4) for _ in range(points)])
            kind = "pick" if task % 2 else "transit"
            label = f"{kind} {task}"
            node = ClearedNode(len(nodes), task, kind, label, waypoints, seconds)
            nodes.append(node)
            at = waypoints[-1]
        task += 1
    return nodes[:count]


@dataclass
class Network:
    """Carries messages badly: each may be lost, doubled, or come after others that were sent later."""

    rng: random.Random
    loses: float
    doubles: float
    latest_s: float
    under_way: list[tuple[float, Command | Report]] = field(default_factory=list)

    def send(self, now_s: float, message: Command | Report) -> None:
        copies = 1 + (self.rng.random() < self.doubles)
        for _ in range(copies):
            if self.rng.random() >= self.loses:
                late = self.rng.uniform(0.0, self.latest_s)
                self.under_way.append((now_s + late, message))

    def arrived(self, now_s: float) -> list[Command | Report]:
        here = [m for t, m in self.under_way if t <= now_s]
        self.under_way = [item for item in self.under_way if item[0] > now_s]
        self.rng.shuffle(here)
        return here


@dataclass
class Cell:
    """One arm whose nodes are cleared some at a time, with everything between it and its dispatcher."""

    rng: random.Random
    nodes: list[ClearedNode]
    network: Network
    now_s: float = 0.0
    cleared: int = 0
    through: int = 0
    apart_s: float = 0.0

    def __post_init__(self) -> None:
        self.link = Link("run", "left", START)
        self.arm = SimulatedArm(lambda: self.now_s)
        self.end = self.new_end(1)

    def new_end(self, instance: int) -> DriverEnd:
        return DriverEnd(self.arm, "left", instance, lambda: self.now_s + self.apart_s)

    def start_driver_anew(self, instance: int) -> None:
        stands = self.arm.state().q
        self.arm = SimulatedArm(
            lambda: self.now_s, stands=stands if stands.size else START
        )
        self.end = self.new_end(instance)

    def start_dispatcher_anew(self, times: int) -> None:
        """Start it with what was written: what it has cleared, and which nodes are known to be through."""
        old = self.link
        self.link = Link("run", "left", START)
        self.link.restore(times, old.done)
        self.link.clear(self.nodes[: self.cleared])

    def tick(self) -> None:
        self.now_s += TICK_S
        if (command := self.link.command(self.now_s)) is not None:
            self.network.send(self.now_s, command)
        self.network.send(self.now_s, self.end.report())
        for message in self.network.arrived(self.now_s):
            if isinstance(message, Command):
                self.end.receive(message)
            else:
                self.link.receive(message, self.now_s)
        state = self.arm.state()
        # Whatever happens, it is in no node that it is not cleared for.
        assert state.begun <= self.cleared
        assert state.mode != "fault", state.words
        assert not self.link.problem
        self.through = max(self.through, state.done)
        assert self.link.done <= self.through


@settings(max_examples=60)
@example(63, 0.0, 0.5, 2.0, 0.0, 0.1)
@given(
    seed=st.integers(0, 2**32 - 1),
    loses=st.sampled_from([0.0, 0.3, 0.8]),
    doubles=st.sampled_from([0.0, 0.5]),
    latest_s=st.sampled_from([0.0, 0.2, 2.0]),
    apart_s=st.sampled_from([0.0, -3600.0, 3600.0]),
    anew=st.sampled_from([0.0, 0.02, 0.1]),
)
def test_every_node_is_passed_and_none_before_it_is_cleared(
    seed: int,
    loses: float,
    doubles: float,
    latest_s: float,
    apart_s: float,
    anew: float,
) -> None:
    rng = random.Random(seed)
    nodes = some_nodes(rng, rng.randint(1, 12))
    cell = Cell(rng, nodes, Network(rng, loses, doubles, latest_s), apart_s=apart_s)
    starts = 1
    for _ in range(200):
        if cell.cleared < len(nodes) and rng.random() < 0.2:
            count = rng.randint(1, 3)
            cell.link.clear(nodes[cell.cleared : cell.cleared + count])
            cell.cleared = min(cell.cleared + count, len(nodes))
        if rng.random() < anew:
            starts += 1
            if rng.random() < 0.5:
                cell.start_driver_anew(starts)
            else:
                cell.start_dispatcher_anew(starts)
        cell.tick()
    # Once messages arrive again, all that is left is done.
    cell.network.loses = cell.network.latest_s = 0.0
    cell.link.clear(nodes[cell.cleared :])
    cell.cleared = len(nodes)
    for _ in range(400):
        cell.tick()
    assert cell.link.done == len(nodes)
    assert np.allclose(cell.arm.state().q, nodes[-1].waypoints[-1])


def commands(link: Link, now_s: float = 0.0) -> Command:
    """Return what a driver of instance 1 is told next."""
    command = link.command(now_s)
    assert command is not None
    return replace(command, instance=1)


def test_what_was_meant_to_come_after_a_skill_that_failed_is_left_aside() -> None:
    now = [0.0]
    nodes = some_nodes(random.Random(1), 9)
    skill = next(n for n in nodes if n.kind == "pick")
    arm = SimulatedArm(lambda: now[0], fails=lambda node: node is skill)
    end, link = DriverEnd(arm, "left", 1), Link("run", "left", START)
    link.clear(nodes)
    old = commands(link)
    end.receive(old)
    now[0] = 100.0
    state = link.receive(end.report(), 0.1)
    assert state is not None
    assert (state.failed, state.done) == (skill.node, skill.node)
    before = nodes[skill.node - 1].waypoints[-1] if skill.node else START
    assert np.allclose(state.q, before)
    # One that was sent before comes once more, with a number of its own.
    end.receive(replace(old, number=old.number + 1))
    assert arm.state().failed == skill.node
    link.swap(2, skill.node + 1)
    other = [
        replace(node, node=skill.node + 1 + k, task=20, kind="transit")
        for k, node in enumerate(some_nodes(random.Random(2), 2))
    ]
    link.clear(other)
    link.number += 1
    end.receive(commands(link, 0.2))
    now[0] = 200.0
    state = link.receive(end.report(), 0.3)
    assert state is not None
    assert (state.failed, state.done) == (-1, skill.node + 3)


@pytest.mark.parametrize(
    "wrong",
    [
        {"have": 4},
        {"state": {"done": 3, "begun": 3}},
        {"state": {"done": 2, "begun": 1}},
        {"session": "another"},
    ],
)
def test_a_driver_that_says_what_cannot_be_is_not_believed(
    wrong: dict[str, object],
) -> None:
    link = Link("run", "left", START)
    link.clear(some_nodes(random.Random(3), 2))
    arm = SimulatedArm(lambda: 0.0)
    end = DriverEnd(arm, "left", 1)
    end.receive(commands(link))
    report = end.report()
    if isinstance(own := wrong.get("state"), dict):
        wrong = {"state": replace(report.state, **own)}
    assert link.receive(replace(report, **wrong), 0.1) is None  # type: ignore[arg-type]
    assert link.problem


def test_a_driver_is_held_and_goes_on_and_stands_for_good_when_it_leaves() -> None:
    now = [0.0]
    nodes = some_nodes(random.Random(4), 3)
    whole = sum(float(node.seconds[-1]) for node in nodes)
    arm = SimulatedArm(lambda: now[0])
    end, link = DriverEnd(arm, "left", 1), Link("run", "left", START)
    link.clear(nodes)
    end.receive(commands(link))
    now[0] = 0.01
    link.hold(True)
    end.receive(commands(link))
    now[0] = 1000.0
    assert end.report().state.mode == "held"
    assert end.report().state.done == 0
    link.hold(False)
    end.receive(commands(link))
    now[0] += whole
    assert end.report().state.done == 3
    link.say_leave()
    end.receive(commands(link))
    assert end.left


def test_a_driver_hears_only_what_is_meant_for_it() -> None:
    link = Link("run", "left", START)
    link.clear(some_nodes(random.Random(5), 2))
    command = commands(link)
    end = DriverEnd(SimulatedArm(lambda: 0.0), "left", 1)
    end.receive(replace(command, robot="right"))
    assert end.report().have == 0
    end.receive(command)
    assert end.report().have == 2
    end.receive(replace(command, session="another", number=99, leave=True))
    assert not end.left


def test_an_arm_tells_where_it_is_and_how_fast_it_moves() -> None:
    now = [0.0]
    nodes = some_nodes(random.Random(6), 4)
    times = np.cumsum([float(n.seconds[-1]) for n in nodes])
    points = [START, *(row for node in nodes for row in node.waypoints)]
    since = np.concatenate(
        [[0.0], *(t + n.seconds for t, n in zip([0.0, *times], nodes, strict=False))]
    )
    arm = SimulatedArm(lambda: now[0], pace=2.0)
    arm.begin(START, 0)
    arm.take(nodes)
    for gone in np.linspace(0.013, times[-1] - 0.011, 23):
        now[0] = gone / 2.0
        state = arm.state()
        for joint, column in enumerate(np.transpose(points)):
            assert state.q[joint] == pytest.approx(np.interp(gone, since, column))
            ahead = np.interp([gone - 1e-7, gone + 1e-7], since, column)
            assert state.dq[joint] == pytest.approx(
                2.0 * np.diff(ahead)[0] / 2e-7, rel=1e-3
            )
    now[0] = 100.0
    assert arm.state().mode == "standing"
    assert not arm.state().dq.any()

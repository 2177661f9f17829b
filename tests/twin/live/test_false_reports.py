"""Drivers that say what is not so: nothing of it is executed, whatever they say, alone and in pairs."""

import itertools
from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import cache, partial
from typing import Any, cast

import numpy as np
import pytest

from scheduling.graph.dispatcher import Dispatcher
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.live.false_reports import (
    CLOCKS,
    FALSE,
    LETTERS,
    MANY,
    Falsify,
    ModelClock,
    ModelInbox,
    ModelWire,
    both,
    skills,
)
from tests.twin.simulated import NOMINAL
from tests.twin.twin_toys import random_tpg, with_cut_skill
from twin.drivers.driver import ClearedNode, cleared_node
from twin.drivers.simulated_arm import SimulatedArm
from twin.engine.execution import Execution, Ports
from twin.engine.execution_model import Messages
from twin.live.driver_end import DriverEnd
from twin.live.inbox import Inbox
from twin.live.link import Link
from twin.live.messages import Report
from twin.live.remote_robots import RemoteRobots
from twin.live.report_checks import plain_text
from twin.live.wire_format import (
    MOST_BYTES,
    MOST_SAMPLES,
    MessageError,
    message_class,
    read_report,
    report_bytes,
)
from twin.operations.commitment import PlanRevision
from twin.operations.planner import Planner
from twin.operations.replanner import RollingReplanner
from twin.recorders.observers import MemoryRecorder, Observers
from twin.runs.events import Event
from twin.uncertainty.disturbances import Disturbances
from twin.uncertainty.node_times import NodeTimes, NodeTimeSampler

TOLERANCE = 0.02


def toy() -> TemporalPlanGraph:
    """Return a graph whose first robot has a skill of two nodes, a transit in which it lies, and other skills."""
    for seed in range(2000):
        tpg = random_tpg(seed, tasks=10, nodes_per_transit=3, edges=12)
        tpg = with_cut_skill(tpg)
        own = tpg.chains[0]
        first = skills(own)
        fits = len(first) >= 3 and first[0] == 3 and not own.skill[5:8].any()
        if fits and own.duration[LIES_FROM : LIES_FROM + 2].min() > 0.3:
            return tpg
    raise AssertionError


LIES_FROM = 6
TPG = toy()


class SameAgain:
    """A planner that has no other plan."""

    initial = None

    def is_short(self, _: Any) -> bool:
        return False

    def with_measure(self, state: Any, _: int) -> Any:
        return state

    def due(self, *_: Any) -> bool:
        return False

    def recover(self, state: Any, _: Any) -> tuple[Any, PlanRevision]:
        nothing, counts = NodeTimes((), (), (), ()), tuple(map(len, TPG.chains))
        return state, PlanRevision(TPG, counts, (), nothing, 0, 0.0, "out")


def driven(falsify: Falsify | None) -> tuple[Execution, list[Event], ModelWire]:
    """Execute the toy with a first driver that lies."""
    tpg, memory, clock = TPG, MemoryRecorder(), ModelClock()
    links = {}
    for robot, chain in zip(tpg.cell.robots, tpg.chains, strict=True):
        arm = SimulatedArm(clock.monotonic)
        end = DriverEnd(arm, robot.name, 1, clock.monotonic)
        lies = falsify if not clock.wires else None
        clock.wires.append(ModelWire(end, chain, lies, LIES_FROM))
        links[robot.name] = Link("run", robot.name, robot.home, lease_s=0.2)
        model = robot.model
        links[robot.name].lower, links[robot.name].upper = model.lower, model.upper
    times = NodeTimeSampler(tpg, NOMINAL, Disturbances()).sample(seed=0)
    robots = partial(
        RemoteRobots,
        links=links,
        wires=dict(zip(links, clock.wires, strict=True)),
        written=lambda: None,
        out_s=1.0,
        tolerance=TOLERANCE,
        clock=clock.monotonic,
        inbox=ModelInbox(clock),
    )
    planner = cast(Planner[Any], SameAgain())
    execution = Execution(
        tpg,
        times,
        Dispatcher(tpg),
        Messages(),
        Ports(robots, replanner=partial(RollingReplanner, planner=planner)),
        observers=Observers((memory,)),
    )
    execution.execute()
    return execution, memory.events, clock.wires[0]


def require_possible(tpg: TemporalPlanGraph, events: Sequence[Event]) -> None:
    """Check that a log is that of an execution: all in order, and nothing that was not released."""
    at: dict[tuple[str, int, str], int] = {}
    handled = set()
    for k, event in enumerate(events):
        own = (event.robot, event.node, event.kind)
        if event.kind in ("released", "started", "completed"):
            assert own not in at
            at[own] = k
            before = {"released": None, "started": "released", "completed": "started"}
            if needed := before[event.kind]:
                assert (event.robot, event.node, needed) in at
            if event.kind == "started" and event.node:
                assert (event.robot, event.node - 1, "completed") in at
        if event.kind in ("attached", "detached"):
            handled.add((event.robot, event.node, event.object))
            assert (event.robot, event.node, "started") in at
    names = [chain.robot for chain in tpg.chains]
    assert handled <= {(names[h.robot], h.node, h.object) for h in tpg.handlings}
    for robot, node, _ in handled:
        assert (robot, node, "completed") in at
    for a, u, b, v in tpg.edges.tolist():
        begun = at.get((names[b], v, "started"))
        if begun is not None:
            assert at[names[a], u, "completed"] < begun


def counted(events: Sequence[Event], robot: str) -> int:
    return sum((e.kind, e.robot) == ("completed", robot) for e in events)


def require_stopped(events: list[Event], wire: ModelWire, codes: str) -> None:
    """Check that the first robot was stopped with a cause, and nothing of what it said was executed."""
    robot = wire.chain.robot
    require_possible(TPG, events)
    assert events[-1].kind == "finished"
    assert events[-1].detail == "failed"
    assert wire.honest >= LIES_FROM
    assert counted(events, robot) <= wire.honest
    known = [e.detail for e in events if (e.kind, e.robot) == ("stopped", robot)]
    assert known
    assert all(detail.isprintable() and len(detail) < 400 for detail in known)
    words = {"off": "off its path", "fault": "owned", "silent": "no sign of life"}
    causes = [words.get(code, f"({code})") for code in codes.split()]
    assert any(cause in known[0] for cause in causes), known


@pytest.mark.parametrize("name", FALSE)
def test_nothing_of_a_false_report_is_executed(name: str) -> None:
    codes, falsify = FALSE[name]
    _, events, wire = driven(falsify)
    require_stopped(events, wire, codes)


def test_a_true_driver_is_believed() -> None:
    _, events, _ = driven(None)
    require_possible(TPG, events)
    assert events[-1].detail == "completed"
    assert counted(events, TPG.chains[0].robot) == len(TPG.chains[0])
    assert not [e for e in events if e.kind == "stopped"]


@pytest.mark.parametrize("name", CLOCKS)
def test_a_clock_that_is_set_changes_nothing_that_was_measured(name: str) -> None:
    true, _, _ = driven(None)
    execution, events, wire = driven(CLOCKS[name])
    require_possible(TPG, events)
    assert events[-1].detail == "completed"
    assert wire.honest >= LIES_FROM
    for own, other in zip(execution.end, true.end, strict=True):
        assert np.abs(np.array(own) - np.array(other)).max() < 0.3e9
    robot = wire.chain.robot
    speeds = []
    for found in (true.robots.measured()[robot], execution.robots.measured()[robot]):
        took, ways = np.diff(found.t_ns) / 1e9, np.diff(found.q, axis=0)
        assert took.min() >= 0.0
        assert not ways[took == 0.0].any()
        fast = np.abs(ways[took > 0.0]).max(axis=1) / took[took > 0.0]
        speeds.append(float(fast.max()))
    assert speeds[1] < 1.5 * speeds[0]


@cache
def on_its_way() -> tuple[Link, Report]:
    """Return a link whose driver has come some way, and the next true report of that."""
    chain, now = TPG.chains[0], [0.0]
    robot = TPG.cell.robot(chain.robot)
    link = Link("run", robot.name, robot.home, ahead_s=None)
    link.lower, link.upper = robot.model.lower, robot.model.upper
    end = DriverEnd(SimulatedArm(lambda: now[0]), robot.name, 1, clock=lambda: now[0])
    link.clear(cleared(LIES_FROM + 4))
    end.receive(replace(require(link.command(0.0)), instance=1))
    while True:
        now[0] += 0.01
        report = end.report()
        state = require(link.receive(report, now[0]))
        link.samples(report)
        if state.done == LIES_FROM and state.begun > state.done:
            break
    now[0] += 0.01
    return link, end.report()


def cleared(count: int) -> list[ClearedNode]:
    return [cleared_node(TPG, 0, node, {}) for node in range(count)]


def require(value: Any) -> Any:
    assert value is not None
    return value


def refused(falsify: Falsify) -> bool:
    """Tell whether a link uses nothing of a false report."""
    (link, true), now_s = on_its_way(), 100.0
    link = copy(link)
    done, begun, state = link.done, link.begun, link.state
    found = link.receive(falsify(true, TPG.chains[0]), now_s)
    if found is not None:
        return found.off > TOLERANCE or found.mode == "fault"
    assert (link.done, link.begun, link.state) == (done, begun, state)
    if link.problem is not None:
        # Nor is it believed once it says what is so.
        assert link.receive(replace(true, number=2**40), now_s) is None
        assert not link.alive(now_s)
    return True


UNDO = (
    {"done before it is there", "done goes back"},
    {"one joint more", "one joint less"},
)
"""Kinds of which each makes true what the other one says."""

PAIRS = [
    pair
    for pair in itertools.permutations(FALSE, 2)
    if set(pair) not in UNDO and "a million samples" not in pair
]


def require_pairs_refused(pairs: Sequence[tuple[str, str]]) -> None:
    heard = [pair for pair in pairs if "silent" not in {FALSE[n][0] for n in pair}]
    believed = [
        pair for pair in heard if not refused(both(*(FALSE[n][1] for n in pair)))
    ]
    assert not believed


def test_pairs_of_false_reports_are_refused() -> None:
    require_pairs_refused(PAIRS[::41])


@pytest.mark.nightly
def test_all_pairs_of_false_reports_are_refused() -> None:
    require_pairs_refused(PAIRS)


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(150))
def test_nothing_of_pairs_of_false_reports_is_executed(seed: int) -> None:
    rng = np.random.default_rng(seed)
    one, other = (list(FALSE)[k] for k in rng.choice(len(FALSE), 2, replace=False))
    _, events, wire = driven(both(FALSE[one][1], FALSE[other][1]))
    require_possible(TPG, events)
    assert events[-1].detail == "failed", (one, other)
    assert counted(events, wire.chain.robot) <= wire.honest


def test_what_was_cleared_before_a_kill_is_possible_after_it() -> None:
    """All that a driver did while there was no dispatcher comes at once, and nothing more is believed."""
    (before, report), count = on_its_way(), LIES_FROM + 4
    link = Link("run", before.robot, before.start)
    link.clear(cleared(count))
    link.restore(1, 2)
    over = replace(report.state, begun=count, done=count, samples=())
    q = cleared(count)[-1].waypoints[-1]
    all_of_it = replace(report, have=count, state=replace(over, q=q))
    found = require(link.receive(all_of_it, 0.0))
    assert (link.done, found.off) == (count, 0.0)
    more = replace(over, begun=count + 1)
    beyond = replace(all_of_it, number=2**40, have=count + 1, state=more)
    assert link.receive(beyond, 0.1) is None
    fault = require(link.problem)
    assert (fault.code, fault.field) == ("beyond-clearance", "have")
    assert (fault.value, fault.low, fault.high) == (count + 1, 0, count)


def test_reports_that_nobody_hears_take_little_room() -> None:
    _, report = on_its_way()
    inbox = Inbox()
    for number in range(10_000):
        inbox.put(replace(report, number=number))
    inbox.put(replace(report, robot="another"))
    heard: list[Report] = []
    while inbox.is_behind() and len(heard) < 9_000:
        heard.append(inbox.get(0.0))
    assert len(heard) < 9_000
    assert heard[-1].robot == "another"
    assert [own.number for own in heard[:-1]] == list(range(len(heard) - 1))


def test_others_are_seen_to_while_one_sends_without_end() -> None:
    _, report = on_its_way()
    inbox = Inbox()
    inbox.put(report)
    rounds = 0
    while inbox.is_behind():
        inbox.put(report)
        inbox.get(0.0)
        rounds += 1
        assert rounds < 10_000


def test_long_reports_that_come_without_end_are_heard_as_long_as_short_ones() -> None:
    _, report = on_its_way()
    some = report.state.samples[:1] * MOST_SAMPLES
    report = replace(report, state=replace(report.state, samples=some))
    inbox = Inbox()
    inbox.put(report)
    rounds = 0
    while inbox.is_behind():
        inbox.put(report)
        inbox.get(0.0)
        rounds += 1
        assert rounds < 20


@pytest.mark.parametrize("text", [LETTERS, "a\r\nb\0c\x9b31m", "\u2066x" * 500, ""])
def test_a_text_of_a_driver_is_one_short_line(text: str) -> None:
    shown = plain_text(text)
    assert len(shown) <= 300
    assert shown.isprintable()


def test_a_message_of_very_many_entries_is_read_as_far_as_is_needed() -> None:
    (_, report), kind = on_its_way(), message_class("Report")
    some = kind.FromString(report_bytes(report))
    del some.samples[:]
    some.samples.extend(
        [kind.DESCRIPTOR.fields_by_name["samples"].message_type._concrete_class()]
        * 10**5
    )
    some.words, some.begun = "x" * 10**5, MANY
    content = some.SerializeToString()
    assert len(content) < MOST_BYTES
    read = read_report(content, 2)
    assert len(read.state.samples) == MOST_SAMPLES + 1
    assert len(read.state.words) <= 1000
    link = copy(on_its_way()[0])
    assert link.receive(read, 0.0) is None
    assert require(link.problem).field == "samples"
    with pytest.raises(MessageError):
        read_report(bytes(MOST_BYTES + 1))

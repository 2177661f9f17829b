"""Kinds of false reports, each made from a true one, and a clock and wires of a model that carry them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from scheduling.graph.temporal_plan_graph import NodeChain
from twin.drivers.driver import Sample
from twin.live.driver_end import DriverEnd
from twin.live.inbox import Inbox
from twin.live.messages import Command, Report

MANY = 2**32 - 1
LETTERS = "\x1b[2J\x1b]0;owned\x07\n\u202e" * 20_000

Falsify = Callable[[Report, NodeChain], Report]


def says(**values: Any) -> Falsify:
    """Return what changes fields of a report."""
    return lambda report, _: replace(report, **values)


def state(**values: Any) -> Falsify:
    """Return what changes fields of the state in a report."""
    return lambda report, _: replace(report, state=replace(report.state, **values))


def sample(**values: Any) -> Falsify:
    """Return what adds a sample that differs from the state in some fields."""

    def falsify(report: Report, _: NodeChain) -> Report:
        own = report.state
        one = Sample(report.at_s, own.q, own.begun, own.done)
        more = replace(own, samples=(*own.samples, replace(one, **values)))
        return replace(report, state=more)

    return falsify


def moved(report: Report, *, by: float = 0.0, length: int = 0) -> np.ndarray:
    """Return the positions of a report beside the path, or of another number of joints."""
    q = report.state.q + by
    return np.resize(q, max(len(q) + length, 0))


def all_done(report: Report, chain: NodeChain) -> Report:
    count = len(chain)
    done = replace(report.state, begun=count, done=count, q=chain.waypoints[-1])
    return replace(report, have=count, state=replace(done, samples=()))


def both(*some: Falsify) -> Falsify:
    def falsify(report: Report, chain: NodeChain) -> Report:
        for own in some:
            report = own(report, chain)
        return report

    return falsify


def failed(choose: Callable[[NodeChain, int], int]) -> Falsify:
    """Return what reports that a node has failed, chosen by the chain and the nodes done."""

    def falsify(report: Report, chain: NodeChain) -> Report:
        node = choose(chain, report.state.done)
        own = replace(report.state, failed=node, words="no grip")
        return replace(report, have=max(report.have, node + 1), state=own)

    return falsify


def transits(chain: NodeChain) -> list[int]:
    """Return all nodes that are of no skill."""
    return np.flatnonzero(~chain.skill).tolist()


def skills(chain: NodeChain) -> list[int]:
    """Return the first nodes of all skills."""
    new = np.r_[True, np.diff(chain.task) != 0]
    return np.flatnonzero(chain.skill & new).tolist()


def ahead(seconds: float) -> Falsify:
    """Return what sets the clock of a driver."""

    def falsify(report: Report, _: NodeChain) -> Report:
        later = tuple(
            replace(own, at_s=own.at_s + seconds) for own in report.state.samples
        )
        own = replace(report.state, samples=later)
        return replace(report, at_s=report.at_s + seconds, state=own)

    return falsify


def stopped_clock(report: Report, _: NodeChain) -> Report:
    some = tuple(replace(own, at_s=1.0) for own in report.state.samples)
    return replace(report, at_s=1.0, state=replace(report.state, samples=some))


def wild_clock(report: Report, chain: NodeChain) -> Report:
    return ahead((report.number * 7919) % 1000 - 500.0)(report, chain)


def plus(field_: str, by: int) -> Falsify:
    """Return what adds to a number of a report, or of its state."""

    def falsify(report: Report, chain: NodeChain) -> Report:
        if hasattr(report, field_):
            return says(**{field_: getattr(report, field_) + by})(report, chain)
        value = getattr(report.state, field_) + by
        return state(**{field_: value})(report, chain)

    return falsify


def joints(**about: Any) -> Falsify:
    return lambda report, chain: state(q=moved(report, **about))(report, chain)


def sample_joints(**about: Any) -> Falsify:
    return lambda report, chain: sample(q=moved(report, **about))(report, chain)


NAN, INF = math.nan, math.inf
FALSE: dict[str, tuple[str, Falsify]] = {
    "a version that was never issued, all done": (
        "unknown-version",
        both(all_done, says(version=999)),
    ),
    "the next version": ("unknown-version", says(version=2)),
    "a negative version": ("unknown-version", says(version=-1)),
    "no version": ("beyond-clearance went-back", says(version=0)),
    "all done": ("beyond-clearance", all_done),
    "done 2^32": ("beyond-clearance", state(done=MANY)),
    "begun 2^32": ("beyond-clearance", state(begun=MANY)),
    "have 2^32": ("beyond-clearance", says(have=MANY)),
    "all 2^32": (
        "beyond-clearance",
        both(says(have=MANY), state(begun=MANY, done=MANY)),
    ),
    "have one more": ("beyond-clearance", plus("have", 99)),
    "begun two more": ("disordered beyond-clearance", plus("begun", 2)),
    "done two more": ("disordered beyond-clearance", plus("done", 2)),
    "have none": ("disordered", says(have=0)),
    "done goes back": ("disordered went-back", plus("done", -1)),
    "all goes back": ("went-back", state(done=0, begun=0, samples=())),
    "done negative": ("beyond-clearance", state(done=-1)),
    "samples begun 2^32": ("disordered", sample(begun=MANY)),
    "samples done 2^32": ("disordered", sample(done=MANY, begun=MANY)),
    "samples done before begun": ("disordered", sample(begun=0)),
    "samples go back": ("disordered", sample(begun=0, done=0)),
    "samples from 2^60 on": ("disordered", says(first=2**60, kept=2**60)),
    "samples kept of later": ("disordered", plus("kept", 10**6)),
    "samples counted from 0 again": ("went-back", both(says(first=0, kept=0))),
    "a million samples": (
        "out-of-range",
        lambda r, c: state(
            samples=(*r.state.samples, sample()(r, c).state.samples[-1]) * 2**20
        )(r, c),
    ),
    "a command that was not sent": ("unknown-command", says(seen=2**63)),
    "an earlier command": ("went-back", says(seen=0)),
    "an order that nobody gave": ("unknown-order", state(acted="robot_1:3")),
    "an order of 20,000 letters": ("unknown-order", state(acted=LETTERS)),
    "a transit failed": (
        "cannot-fail",
        failed(lambda c, done: max(n for n in transits(c) if n <= max(done, 0))),
    ),
    "a skill to come failed": (
        "cannot-fail beyond-clearance",
        failed(lambda c, _: skills(c)[-1]),
    ),
    "a skill that is done failed": (
        "cannot-fail",
        failed(lambda c, _: skills(c)[0]),
    ),
    "the second node of a skill failed": (
        "cannot-fail beyond-clearance",
        failed(lambda c, _: skills(c)[0] + 1),
    ),
    "node 2^32 failed": ("beyond-clearance", state(failed=MANY)),
    "off -1": ("out-of-range", state(off=-1.0)),
    "off NaN": ("out-of-range", state(off=NAN)),
    "off infinite": ("out-of-range", state(off=INF)),
    "joints NaN": ("out-of-range", joints(by=NAN)),
    "joints infinite": ("out-of-range", joints(by=-INF)),
    "joints 1e300": ("out-of-range", joints(by=1e300)),
    "joints of no robot": ("out-of-range", joints(by=9.0)),
    "one joint less": ("out-of-range", joints(length=-1)),
    "one joint more": ("out-of-range", joints(length=1)),
    "a million joints": ("out-of-range", joints(length=2**20)),
    "no joints": ("out-of-range", state(q=np.zeros(0))),
    "speeds NaN": ("out-of-range", state(dq=np.array([NAN, 0.0]))),
    "speeds of others": ("out-of-range", state(dq=np.zeros(9))),
    "samples NaN": ("out-of-range", sample_joints(by=NAN)),
    "samples of others": ("out-of-range", sample_joints(length=1)),
    "samples at no time": ("out-of-range", sample(at_s=NAN)),
    "no time": ("out-of-range", says(at_s=NAN)),
    "no end of time": ("out-of-range", says(at_s=INF)),
    "a time of 1e300": ("out-of-range", says(at_s=1e300)),
    "an unknown mode": ("unknown-mode", state(mode="\x1b[31mflying")),
    "another session": ("other-session", says(session=LETTERS)),
    "beside the path": ("off", both(joints(by=0.4), state(off=0.0))),
    "samples beside the path": ("off", both(sample_joints(by=-0.4), state(off=0.0))),
    "off itself": ("off", state(off=0.5)),
    "done before it is there": (
        "off beyond-clearance",
        both(
            plus("done", 1),
            lambda r, _: replace(r, state=replace(r.state, begun=r.state.done)),
        ),
    ),
    "at fault, with escape sequences": ("fault", state(mode="fault", words=LETTERS)),
    "the same number again and again": ("silent", says(number=0)),
    "an older instance": ("silent", says(instance=0)),
    "a robot that is not there": ("silent", says(robot="nobody")),
    "started anew, and all of it undone": (
        "went-back",
        both(
            says(instance=2**40, first=0, kept=0),
            state(done=0, begun=0, samples=()),
        ),
    ),
}
"""What a report says, what comes of it, and what makes it of a true one."""

CLOCKS: dict[str, Falsify] = {
    "1e9 s ahead": ahead(1e9),
    "50 s back": ahead(-50.0),
    "0.3 s back": ahead(-0.3),
    "5 s ahead": ahead(5.0),
    "stands still": stopped_clock,
    "is wild": wild_clock,
    "jumps once and back": lambda r, c: ahead(1e9)(r, c) if r.number % 40 == 0 else r,
}
"""What the clock of a driver does."""


@dataclass
class ModelClock:
    """A clock that goes on when it is told."""

    now: float = 100.0
    wires: list[ModelWire] = field(default_factory=list)

    def monotonic(self) -> float:
        return self.now

    def wait(self, seconds: float) -> None:
        self.now += seconds
        for wire in self.wires:
            wire.report()


class ModelInbox(Inbox):
    """An inbox for which the clock of a model goes on while nothing comes."""

    def __init__(self, clock: ModelClock) -> None:
        super().__init__()
        self.clock = clock

    def get(self, timeout: float) -> Report:
        if self._queue.empty() and timeout > 0.0:
            self.clock.wait(timeout)
        return super().get(1e-9)


@dataclass
class ModelWire:
    """A wire without threads, of a driver that lies from some of its nodes on."""

    end: DriverEnd
    chain: NodeChain
    falsify: Falsify | None = None
    lies_from: int = 3
    honest: int = -1
    """Nodes that were done when the driver began to lie."""

    def open(self, deliver: Callable[[Report], None]) -> None:
        self._deliver = deliver

    def send(self, command: Command) -> None:
        self.end.receive(command)

    def close(self) -> None: ...

    def report(self) -> None:
        report = self.end.report()
        own = report.state
        if self.falsify is not None and report.session:
            begins = own.done >= self.lies_from and own.begun > own.done
            if begins and self.honest < 0:
                self.honest = own.done
            if self.honest >= 0:
                report = self.falsify(report, self.chain)
        self._deliver(report)

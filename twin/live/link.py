"""The end of a session at the dispatcher, one a robot: what its driver is told, and what is believed of it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from planning.transforms import Array
from twin.drivers.driver import ClearedNode, DriverState, Sample, ToolOrder
from twin.live.wire_format import Command, Report

_SAME_CLOCK_S = 1.0
"""A clock on this machine that is so near to that of the dispatcher is the same one [s]."""


@dataclass(frozen=True)
class AwaitedAct:
    """A node that a robot passes once another one's tool has closed or opened.

    Attributes:
        node: its number among those of the robot.
        robot: whose tool it is.
        order: what that is to do.
    """

    node: int
    robot: str
    order: ToolOrder


@dataclass
class Link:
    """What is known of one driver, and what it is to know.

    Attributes:
        session, robot: names of the run and the robot.
        start: where the plan has the robot stand at the beginning, shape (n,).
        lease_s: without a report for so long, nothing more is cleared to it [s].
        repeat_s: what a driver has not got is told again after so long, and at least so often there is a
            sign of life [s].
        number: of the last command.
        done: nodes that are through.
        cleared: nodes that it may pass, from its first one on.
        version: of the graph that they are from.
        ahead_s: how far the clock of the dispatcher is ahead of the driver's, as far as is known; None where
            they are the same [s].
        near: whether its driver may be on this machine; where it then has the same clock, that is seen by its
            first report.
        awaited: what tools of other robots are to have done before further nodes are told.
        tool: the last order of its own tool, None for none.
        held, leave: whether it is to stand; whether nothing more will come.
        state: what it said last, None before it has.
        problem: what it has said that cannot be, empty for nothing: it is not to be relied on any more.
    """

    session: str
    robot: str
    start: Array
    lease_s: float = 2.0
    repeat_s: float = 0.2
    number: int = 0
    done: int = 0
    cleared: list[ClearedNode] = field(default_factory=list)
    version: int = 1
    ahead_s: float | None = math.inf
    near: bool = False
    awaited: list[AwaitedAct] = field(default_factory=list)
    tool: ToolOrder | None = None
    held: bool = False
    leave: bool = False
    state: DriverState | None = None
    problem: str = ""
    _instance: int = -1
    _report: int = -1
    _have: int | None = None
    _taken: int | None = None
    _base: int = 0
    _heard_s: float | None = None
    _sent_s: float | None = None
    _news: bool = True

    def go_on(self, starts: int, done: int) -> None:
        """Take up what a dispatcher before this one knew.

        Args:
            starts: how many there were.
            done: nodes that are known to be through.
        """
        self.number = self._base = starts << 32
        self.done = done

    def samples(self, report: Report) -> tuple[Sample, ...] | None:
        """Return the samples of a report that has been believed which have not come before.

        None where some before them are still to come.
        """
        if report.seen <= self._base:
            return None  # it does not know yet what this dispatcher has heard of
        if self._taken is None:
            self._taken = report.first
        self._taken = max(self._taken, report.kept)
        skip = self._taken - report.first
        if skip < 0:
            return None  # what is missing before them is told again
        own = report.state.samples[skip:]
        self._taken += len(own)
        return own

    def alive(self, now_s: float) -> bool:
        """Tell whether its driver has given a sign of life."""
        return self._heard_s is not None and now_s - self._heard_s <= self.lease_s

    def silent_s(self, now_s: float) -> float | None:
        """Return for how long nothing has been heard of it [s], None where nothing ever was."""
        return None if self._heard_s is None else now_s - self._heard_s

    def when(self, at_s: float) -> float:
        """Return a time by the clock of the driver in that of the dispatcher [s].

        As far as is known: no report was quicker than the quickest one.
        """
        return at_s + (self.ahead_s or 0.0)

    def clear(self, nodes: Sequence[ClearedNode]) -> None:
        """Let the robot pass more nodes."""
        self.cleared += nodes
        self._news = True

    def swap(self, version: int, count: int) -> None:
        """Go on with another graph, in which it may pass so many nodes."""
        self.version = version
        del self.cleared[count:]
        self.awaited = [own for own in self.awaited if own.node < count]
        self._news = True

    def order(self, order: ToolOrder) -> None:
        """Have its tool close or open."""
        if self.tool != order:
            self.tool, self._news = order, True

    @property
    def is_acting(self) -> bool:
        """Whether its tool has not done what was ordered last."""
        acted = "" if self.state is None else self.state.acted
        return self.tool is not None and acted != self.tool.name

    def is_due(self, awaited: AwaitedAct) -> bool:
        """Tell whether its robot stands where another one's tool is to act next."""
        return self.done >= awaited.node

    def go_on_after(self, awaited: AwaitedAct) -> None:
        """Tell of the nodes from one on in which another tool was awaited."""
        self.awaited.remove(awaited)
        self._news = True

    def has(self, node: int) -> bool:
        """Tell whether its driver has said that it knows a node."""
        return self._have is not None and self._have > node

    def hold(self, held: bool) -> None:
        """Let the robot stand, or go on."""
        self.held, self._news = held, True

    def say_leave(self) -> None:
        """Let the robot come to rest for good."""
        self.leave, self._news = True, True

    # Messages

    def receive(self, report: Report, now_s: float) -> DriverState | None:
        """Return what a report says, None where it is to be left aside: foreign, doubled or overtaken.

        Args:
            report: what has arrived.
            now_s: the time [s].
        """
        order = (report.instance, report.number)
        if report.robot != self.robot or order <= (self._instance, self._report):
            return None
        if report.session not in ("", self.session):
            self.problem = f"serves another session, {report.session!r}"
            return None
        before, (self._instance, self._report) = self._instance, order
        if report.instance != before:
            # What it was told last may be old: it knows less than is known of it.
            self._have = self._taken = None
            if self.ahead_s is not None:
                self.ahead_s = math.inf
        self._heard_s = now_s
        if self.near and 0.0 <= now_s - report.at_s < _SAME_CLOCK_S:
            self.ahead_s = None
        if self.ahead_s is not None:
            self.ahead_s = min(self.ahead_s, now_s - report.at_s)
        if not report.session:
            # It has been started anew, or has not been told yet.
            self._news, self._have = True, None
            return None
        state = report.state
        if words := self._impossible(report):
            self.problem = words
            return None
        self._have = report.have
        self.state = state
        self.done = max(self.done, state.done)
        return state

    def _impossible(self, report: Report) -> str:
        state = report.state
        if not state.done <= state.begun <= report.have:
            return f"says that {state.done} nodes are through, {state.begun} begun, and that it has {report.have}"
        if report.version == self.version and report.have > len(self.cleared):
            return f"says that it has {report.have} nodes, and is cleared for {len(self.cleared)}"
        if self._have is not None and self.state and state.done < self.state.done:
            return f"says that {state.done} nodes are through, after {self.state.done}"
        return ""

    def command(self, now_s: float) -> Command | None:
        """Return what is to be sent now, None for nothing."""
        late = self._sent_s is None or now_s - self._sent_s >= self.repeat_s
        if not self._news and not late:
            return None
        # A driver that has said nothing yet is told from where it may have to begin.
        have = self.done if self._have is None else self._have
        self._news, self._sent_s = False, now_s
        self.number += 1
        stands = self.cleared[self.done - 1].waypoints[-1] if self.done else self.start
        return Command(
            self.session,
            self.robot,
            max(self._instance, 0),
            self.number,
            stands,
            self.done,
            self.version,
            tuple(self.cleared[have : self.awaited[0].node if self.awaited else None]),
            self._taken or 0,
            self.held,
            self.leave,
            self.tool,
        )


def see_to_tools(links: Mapping[str, Link]) -> list[tuple[str, int]]:
    """Order what robots that stand ready for it await of others' tools, and let them go on after it.

    Args:
        links: of all robots, by name.

    Returns:
        Robots, and their nodes that another one's tool has been ordered to act in.
    """
    found = []
    for name, link in links.items():
        for awaited in link.awaited[:1]:
            other = links[awaited.robot]
            ordered = other.tool == awaited.order
            if link.has(awaited.node) or (ordered and not other.is_acting):
                link.go_on_after(awaited)
            elif link.is_due(awaited):
                other.order(awaited.order)
                found.append((name, awaited.node))
    return found

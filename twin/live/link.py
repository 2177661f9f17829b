"""Dispatcher side of the connection to one driver: sends commands, and validates reports."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from planning.motion.near_path import nearest_points_on_path
from planning.tasks.task import TaskKind
from planning.transforms import Array
from twin.drivers.driver import ClearedNode, DriverState, Sample, ToolOrder
from twin.live.messages import Command, Report
from twin.live.report_checks import (
    Clearance,
    ReportFault,
    begun_nodes,
    known_nodes,
    plain_text,
    report_fault,
)
from twin.live.wire_format import LARGEST_NUMBER

_SAME_CLOCK_S = 1.0
"""A clock on this machine that is so near to that of the dispatcher is the same one [s]."""

_CLOCK_JUMP_S = 10.0
"""Clock change relative to the dispatcher that counts as a jump or standstill [s]."""

_EARLY_S = 0.1
"""A node may be reported as done so long before its end is passed as planned [s]."""

_MOST_TOLD = 5
"""Largest number of reported clock jumps of a driver."""

_BLOCK = 1000
"""So many samples are compared with their path at a time."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class AwaitedActuation:
    """A node that a robot enters after another robot's tool has closed or opened.

    Attributes:
        node: its number among those of the robot.
        robot: whose tool it is.
        order: the action of the other tool.
    """

    node: int
    robot: str
    order: ToolOrder


@dataclass
class Link:
    """State of the connection to one driver, and its commands.

    Attributes:
        session, robot: names of the run and the robot.
        start: where the plan has the robot stand at the beginning, shape (n,).
        lease_s: without a report for so long, nothing more is cleared to it [s].
        repeat_s: unacknowledged commands are resent after this time, and at least this often there is a
            sign of life [s].
        number: of the last command.
        done: nodes that are through.
        cleared: nodes that it may pass, from its first one on.
        version: of the graph that they are from.
        ahead_s: how far the clock of the dispatcher is ahead of the driver's, as far as is known; None where
            they are the same [s].
        near: whether its driver may be on this machine; where it then has the same clock, that is seen by its
            first report.
        awaited: tool actions of other robots required before further nodes are sent.
        tool: the last order of its own tool, None for none.
        held, leave: whether the robot shall stop; whether the session ends.
        state: its last report, None before the first.
        problem: why a report of its was impossible, None where none was: it is not relied on any more.
        lower, upper: range of each joint, shape (n,) [rad or m].
        begun: nodes that it has reported as begun.
        failed: the node of the last skill that it has reported as failed, -1 for none.
        orders: names of all orders that its tool was given.
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
    awaited: list[AwaitedActuation] = field(default_factory=list)
    tool: ToolOrder | None = None
    held: bool = False
    leave: bool = False
    state: DriverState | None = None
    problem: ReportFault | None = None
    lower: Array | float = -LARGEST_NUMBER
    upper: Array | float = LARGEST_NUMBER
    begun: int = 0
    failed: int = -1
    orders: set[str] = field(default_factory=set)
    _instance: int = -1
    _report: int = -1
    _last: Report | None = None
    _begins_at: int | None = None
    _least: int = 0
    _stuck: bool = False
    _cleared: dict[int, int] = field(default_factory=dict)
    _at_s: float | None = None
    _shifts_s: tuple[float, float] = (0.0, 0.0)
    _jumps: int = 0
    _have: int | None = None
    _taken: int | None = None
    _base: int = 0
    _heard_s: float | None = None
    _sent_s: float | None = None
    _news: bool = True

    def restore(self, starts: int, done: int) -> None:
        """Restore the state of an earlier dispatcher.

        Args:
            starts: how many there were.
            done: nodes that are known to be through.
        """
        self.number = self._base = starts << 32
        self.done = self.begun = done

    def samples(self, report: Report) -> tuple[Sample, ...] | None:
        """Return the new samples of an accepted report.

        None where some before them are still to come.
        """
        if report.seen <= self._base:
            return None  # it has no acknowledgement of this dispatcher yet
        if self._taken is None:
            self._taken = report.first
        self._taken = max(self._taken, report.kept)
        skip = self._taken - report.first
        if skip < 0:
            return None  # missing earlier ones are sent again
        own = report.state.samples[skip:]
        self._taken += len(own)
        if not own and not self._taken:
            return self.state_alone(report)
        return tuple(self._in_one_clock(sample, report.at_s) for sample in own)

    def state_alone(self, report: Report) -> tuple[Sample, ...]:
        """Return the state of a report as a sample, for drivers that send no samples."""
        state = report.state
        own = Sample(report.at_s, state.q, state.begun, state.done)
        return (self._in_one_clock(own, report.at_s),)

    def _in_one_clock(self, sample: Sample, reported_s: float) -> Sample:
        """Return a sample with its time corrected for resets of the driver's clock."""
        before, shift = self._shifts_s
        was_before = sample.at_s > reported_s + _SAME_CLOCK_S
        if not shift and not was_before:
            return sample
        at_s = sample.at_s + (before if was_before else shift)
        return replace(sample, at_s=min(at_s, self._at_s or at_s))

    def alive(self, now_s: float) -> bool:
        """Return whether the driver's heartbeat is recent and its reports were valid."""
        heard = self._heard_s is not None and now_s - self._heard_s <= self.lease_s
        return heard and self.problem is None

    def silent_s(self, now_s: float) -> float | None:
        """Return the time since the last report [s], None before the first."""
        return None if self._heard_s is None else now_s - self._heard_s

    def when(self, at_s: float) -> float:
        """Convert a time of the driver's clock to the dispatcher's clock [s].

        As far as is known: no report was quicker than the quickest one, and nothing was measured after it was
        reported.
        """
        when_s = at_s + (self.ahead_s or 0.0)
        return when_s if self._heard_s is None else min(when_s, self._heard_s)

    def clear(self, nodes: Sequence[ClearedNode]) -> None:
        """Clear further nodes."""
        self.cleared += nodes
        self._news = True

    def swap(self, version: int, count: int) -> None:
        """Continue with another graph, with a number of nodes cleared."""
        self.version = version
        if self._stuck and count == self.failed + 1:
            # The robot stands where the skill began, which counts as done.
            q, own = self._stands_at(self.failed), self.cleared[self.failed]
            waypoints, seconds = q[None], np.zeros(1)
            self.cleared[self.failed] = replace(
                own, kind=TaskKind.FAILED, waypoints=waypoints, seconds=seconds, act=""
            )
            self.done, self._stuck = max(self.done, count), False
        del self.cleared[count:]
        self._cleared = {own: min(most, count) for own, most in self._cleared.items()}
        self.awaited = [own for own in self.awaited if own.node < count]
        self._news = True

    def order(self, order: ToolOrder) -> None:
        """Order its tool to close or open."""
        if self.tool != order:
            self.tool, self._news = order, True
            self.orders.add(order.name)

    @property
    def is_acting(self) -> bool:
        """Whether its last tool order is not done; a robot at fault counts as not done."""
        state, acted = self.state, ""
        if state is not None and state.mode != "fault":
            acted = state.acted
        return self.tool is not None and acted != self.tool.name

    def rests(self, count: int, tolerance: float) -> bool:
        """Return whether its robot rests, or will come to rest, at its last cleared node.

        Args:
            count: nodes that it was cleared for.
            tolerance: how far a joint may be from its path [rad or m].
        """
        if self.state is None or self.state.off > tolerance or self.is_acting:
            return False
        silent = self.state.mode != "fault" and self.problem is None
        return count > 0 and count == (self.state.begun if silent else self.state.done)

    def is_due(self, awaited: AwaitedActuation) -> bool:
        """Return whether its robot stands where another robot's tool acts next."""
        return self.done >= awaited.node

    def send_awaited(self, awaited: AwaitedActuation) -> None:
        """Send the nodes from one on that awaited another tool."""
        self.awaited.remove(awaited)
        self._news = True

    def has(self, node: int) -> bool:
        """Return whether its driver has acknowledged a node."""
        return self._have is not None and self._have > node

    def hold(self, held: bool) -> None:
        """Stop the robot, or let it continue."""
        self.held, self._news = held, True

    def say_leave(self) -> None:
        """End the session: the robot comes to rest for good."""
        self.leave, self._news = True, True

    # Messages

    def receive(self, report: Report, now_s: float) -> DriverState | None:
        """Validate a report; None for a foreign, duplicate or outdated one.

        Args:
            report: the received report.
            now_s: the time [s].
        """
        order = (report.instance, report.number)
        if report.robot != self.robot or order <= (self._instance, self._report):
            return None
        if self.problem is not None:
            self._heard_s = now_s
            return None
        if report.session not in ("", self.session):
            self._refuse(ReportFault("other-session", "session", report.session))
            return None
        before, (self._instance, self._report) = self._instance, order
        if report.instance != before:
            # Its last command may be old: it knows less than the dispatcher.
            self._have = self._taken = self._last = self._at_s = self._begins_at = None
            self._least = self.done
            self._shifts_s = 0.0, 0.0
            if self.ahead_s is not None:
                self.ahead_s = math.inf
        if (fault := report_fault(report, self._clearance(report))) is not None:
            self._refuse(fault)
            return None
        self._compare_clocks(report.at_s, now_s)
        self._heard_s = now_s
        if not report.session:
            # It has been restarted, or has not received the order yet.
            self._news, self._have = True, None
            return None
        self.begun = max(self.begun, begun_nodes(report))
        self._have, self._last = known_nodes(report), report
        state = report.state
        if state.failed >= self.done:
            # Until a graph continues from there, nothing follows it.
            self.failed, self._stuck = state.failed, True
        off, words = max(state.off, self._off(report)), plain_text(state.words)
        self.state = state = replace(state, off=off, words=words)
        self.done = max(self.done, state.done)
        return state

    def _refuse(self, fault: ReportFault) -> None:
        """Distrust the driver from now on, and stop its robot."""
        self.problem = fault
        self.hold(True)

    def _clearance(self, report: Report) -> Clearance:
        """Return the bounds for the next report."""
        lower, upper = (np.zeros_like(self.start) + k for k in (self.lower, self.upper))
        return Clearance(
            lower,
            upper,
            self._most(report.version),
            self.cleared,
            self.number,
            self.orders,
            self._last,
            self._taken,
            self.done,
            self.begun,
            0 if 0 < self._base >= report.seen else self._least,
            self.failed if self._stuck else -1,
        )

    def _most(self, version: int) -> int | None:
        """Return the number of nodes sent by a version of the graph, None for an unknown version.

        Of an earlier dispatcher's messages, only the clearances are known.
        """
        if not 0 <= version <= self.version:
            return None
        if self._base:
            most: int | None = len(self.cleared)
        else:
            # A restarted driver has completed nodes, but none by itself.
            most = self._cleared.get(version) if version else self.done
        return min(most, self.failed + 1) if most and self._stuck else most

    def _compare_clocks(self, at_s: float, now_s: float) -> None:
        """Estimate the offset of the driver's clock, reset after a jump or standstill of that clock."""
        told_s = at_s + self._shifts_s[1]
        behind_s = now_s - told_s
        if self._at_s is not None:
            late_s = behind_s - (self.ahead_s or 0.0)
            if told_s <= self._at_s:
                self._shifts_s = self._shifts_s[1], self._at_s - at_s
                told_s, self.ahead_s = self._at_s, math.inf
            elif late_s > _CLOCK_JUMP_S:
                self.ahead_s = math.inf
            if abs(late_s) > _CLOCK_JUMP_S and self._jumps < _MOST_TOLD:
                self._jumps += 1
                _log.warning("%s: its clock jumped by %.6g s", self.robot, -late_s)
        self._at_s, behind_s = told_s, now_s - told_s
        if self.near and not self._shifts_s[1] and 0.0 <= behind_s < _SAME_CLOCK_S:
            self.ahead_s = None
        elif self.ahead_s is None and behind_s < 0.0:
            self.ahead_s = behind_s
        if self.ahead_s is not None:
            self.ahead_s = min(self.ahead_s, behind_s)

    def _off(self, report: Report) -> float:
        """Return the largest joint deviation from the path in a report and its samples [rad or m].

        The path reaches from the end of the last completed node, or shortly before, as a corner may be
        cut, to the end of the next node but one, as a border may be reported late. A restarted driver
        may be anywhere on the rest of the path.
        """
        state, most = report.state, self._most(report.version) or 0
        if self._begins_at is None:
            self._begins_at = state.done
        lost = state.begun == self._begins_at
        rows: dict[int, list[Array]] = {state.done: [state.q]}
        for sample in state.samples:
            rows.setdefault(sample.done, []).append(sample.q)
        off = 0.0
        for done, own in rows.items():
            low = min(done, self.failed) if self._stuck else done
            nodes = self.cleared[low : most if lost else min(done + 2, most)]
            path = np.vstack([self._before(low), *(node.waypoints for node in nodes)])
            for k in range(0, len(own), _BLOCK):
                near = nearest_points_on_path(path, np.array(own[k : k + _BLOCK]))
                off = max(off, float(near.off.max()))
        return off

    def _before(self, count: int) -> Array:
        """Return the last part of the path of some nodes, passed in a short time, shape (k, n)."""
        if not count:
            return self.start[None]
        node = self.cleared[count - 1]
        seconds = np.array([0.0, *node.seconds])
        corners = np.vstack([self._stands_at(count - 1), node.waypoints])
        begin_s = max(float(seconds[-1]) - _EARLY_S, 0.0)
        begin = [np.interp(begin_s, seconds, joint) for joint in corners.T]
        return np.vstack([begin, corners[seconds > begin_s], corners[-1:]])

    def _stands_at(self, count: int) -> Array:
        """Return the configuration after a number of nodes, shape (n,)."""
        return self.cleared[count - 1].waypoints[-1] if count else self.start

    def command(self, now_s: float) -> Command | None:
        """Return the command to send now, None for none."""
        late = self._sent_s is None or now_s - self._sent_s >= self.repeat_s
        if not self._news and not late:
            return None
        # A driver without any report yet is sent its possible start.
        have = self.done if self._have is None else self._have
        self._news, self._sent_s = False, now_s
        self.number += 1
        end = self.awaited[0].node if self.awaited else len(self.cleared)
        if self._stuck:
            end = min(end, self.failed)
        self._cleared[self.version] = max(
            self._cleared.get(self.version, 0), end, self.done
        )
        return Command(
            self.session,
            self.robot,
            max(self._instance, 0),
            self.number,
            self._stands_at(self.done),
            self.done,
            self.version,
            tuple(self.cleared[have:end]),
            self._taken or 0,
            self.held,
            self.leave,
            self.tool,
        )


def sync_tool_commands(links: Mapping[str, Link]) -> list[tuple[str, int]]:
    """Order awaited tool actions for robots in position, and continue them afterwards.

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
                link.send_awaited(awaited)
            elif link.is_due(awaited):
                other.order(awaited.order)
                found.append((name, awaited.node))
    return found

"""Validation of driver reports before they are used.

Drivers are external programs, so every field of a report is untrusted input. It is compared with the nodes that the
dispatcher has cleared (permitted) for the robot. A report that breaks a rule is rejected as a whole, and its robot is
no longer trusted.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from planning.tasks.task import TaskKind
from planning.transforms import Array
from twin.drivers.driver import ClearedNode, Mode
from twin.live.messages import Report
from twin.live.wire_format import LARGEST_NUMBER, MOST_SAMPLES

FaultCode = Literal[
    "other-session",
    "unknown-mode",
    "unknown-version",
    "unknown-command",
    "unknown-order",
    "out-of-range",
    "beyond-clearance",
    "disordered",
    "went-back",
    "cannot-fail",
    "failure-withdrawn",
]
"""The rule that a report breaks; docs/guides/robots.md explains each."""

_MARGIN = 0.5
"""How far outside the range of its model a joint may be measured [rad or m]."""

_MODES = get_args(Mode)

_Bound = tuple[FaultCode, str, float, float, float]
"""A rule, the field that it is about, its value, and the least and the greatest value that are possible."""


def plain_text(text: str, most: int = 300) -> str:
    """Return a text of a driver as one line without control characters and escape sequences.

    Args:
        text: as it came.
        most: greatest length; a longer text is cut, and ends with an ellipsis.
    """
    line = " ".join(text[: 4 * most].split())
    shown = "".join(c if c.isprintable() else "?" for c in line)
    return shown if len(shown) <= most else f"{shown[: most - 1]}…"


@dataclass(frozen=True)
class ReportFault:
    """Reason why a report is impossible.

    Attributes:
        code: the rule that it breaks.
        field: the field of ``cell.proto`` that breaks it.
        value: of that field.
        low, high: least and greatest value that would have been possible; ``low > high`` where none was.
    """

    code: FaultCode
    field: str
    value: float | str
    low: float = np.inf
    high: float = -np.inf

    def __str__(self) -> str:
        text = isinstance(self.value, str)
        shown = plain_text(repr(self.value), 60) if text else f"{self.value:.10g}"
        bounds = f" (possible: {self.low:.10g} to {self.high:.10g})"
        return (
            f"impossible report ({self.code}): {self.field} is {shown}"
            f"{bounds if self.low <= self.high else ''}"
        )


@dataclass(frozen=True)
class Clearance:
    """Bounds of the next report of a driver.

    Attributes:
        lower, upper: range of each joint, shape (n,) [rad or m].
        most: nodes sent to the driver by the report's version of the graph, None if never sent
            of that version.
        nodes: that the robot is cleared for, from its first one on.
        commands: number of the last command that was sent.
        orders: names of all orders that its tool was given.
        last: the last report of the same instance that was used, None before the first.
        taken: number of the next expected sample, None before the first.
        done, begun: nodes that it has reported as done, and as begun, in any report or sample.
        least: nodes completed before its instance connected, which it skips.
        failed: the node that it reported as failed, until a graph continues from there; -1 for none.
    """

    lower: Array
    upper: Array
    most: int | None
    nodes: Sequence[ClearedNode]
    commands: int
    orders: Collection[str]
    last: Report | None
    taken: int | None
    done: int
    begun: int
    least: int
    failed: int


def report_fault(report: Report, known: Clearance) -> ReportFault | None:
    """Return the first rule that a report breaks, None where it is possible.

    Args:
        report: any report, as it was read.
        known: clearances and earlier reports of the driver.
    """
    state = report.state
    if state.mode not in _MODES:
        return ReportFault("unknown-mode", "mode", state.mode)
    if report.session and state.acted and state.acted not in known.orders:
        return ReportFault("unknown-order", "acted", state.acted)
    for code, field, value, low, high in _bounds(report, known):
        if not low <= value <= high:  # nor is NaN
            return ReportFault(code, field, value, low, high)
    return None


def known_nodes(report: Report) -> int:
    """Return the number of nodes known to a driver, up to the first node of a failed skill."""
    failed = report.state.failed
    return report.have if failed < 0 else min(report.have, failed + 1)


def begun_nodes(report: Report) -> int:
    """Return the number of nodes begun by a report and its samples."""
    return max(report.state.begun, *(own.begun for own in report.state.samples), 0)


def _bounds(report: Report, known: Clearance) -> Iterator[_Bound]:
    """Yield the bounds of all fields; each may depend on earlier ones."""
    state, most = report.state, LARGEST_NUMBER
    yield "out-of-range", "samples", len(state.samples), 0, MOST_SAMPLES
    yield "out-of-range", "at_s", report.at_s, -most, most
    yield "out-of-range", "off", state.off, 0.0, most
    for sample in state.samples:
        yield "out-of-range", "samples.at_s", sample.at_s, -most, most
    if not report.session:
        return  # no command was sent yet, and of its report only the clock is used
    everywhere = np.full(len(known.lower), most)
    yield from _joint_bounds("dq", state.dq, -everywhere, everywhere)
    limits = known.lower - _MARGIN, known.upper + _MARGIN
    yield from _joint_bounds("q", state.q, *limits)
    for sample in state.samples:
        yield from _joint_bounds("samples.q", sample.q, *limits)
    yield "unknown-command", "seen", report.seen, 0, known.commands
    if known.most is None:
        yield "unknown-version", "version", report.version, np.inf, -np.inf
        return
    yield from _failure_bounds(report, known)
    yield from _node_bounds(report, known.most)
    yield "went-back", "done", state.done, known.least, np.inf
    if known.last is not None:
        yield from _lower_bounds(report, known.last, known.taken)


def _joint_bounds(field: str, q: Array, lower: Array, upper: Array) -> Iterator[_Bound]:
    yield "out-of-range", f"length of {field}", len(q), len(lower), len(lower)
    for k in np.flatnonzero(~((lower <= q) & (q <= upper))).tolist():
        yield "out-of-range", f"{field}[{k}]", q[k], lower[k], upper[k]


def _node_bounds(report: Report, most: int) -> Iterator[_Bound]:
    """Yield bounds of the robot's progress; it is in one node at a time."""
    state, have = report.state, known_nodes(report)
    yield "beyond-clearance", "have", have, 0, most
    yield "beyond-clearance", "begun", state.begun, 0, most
    yield "beyond-clearance", "done", state.done, 0, most
    yield "disordered", "begun", state.begun, state.done, min(have, state.done + 1)
    yield "disordered", "kept", report.kept, 0, report.first
    yield "disordered", "first", report.first, report.kept, 2**53
    before = 0
    for own in state.samples:
        yield "disordered", "samples.done", own.done, before, state.done
        high = min(own.done + 1, most)
        yield "disordered", "samples.begun", own.begun, own.done, high
        before = own.done


def _failure_bounds(report: Report, known: Clearance) -> Iterator[_Bound]:
    """Yield bounds of the node that has failed: the first one of a skill, begun and not done before."""
    state, node, nodes = report.state, report.state.failed, known.nodes
    stated = -1 if known.last is None else known.last.state.failed
    if 0 <= stated == known.failed:
        yield "failure-withdrawn", "failed", node, stated, stated
    if node < 0 or node == stated:
        return
    yield "beyond-clearance", "failed", node, 0, (known.most or 0) - 1
    first = node == 0 or nodes[node - 1].task != nodes[node].task
    done = known.done if node != known.failed else node
    # Where samples are missing, one of them may have its start.
    whole = known.taken is not None and report.first <= known.taken
    begun = max(known.begun, begun_nodes(report)) if whole else node + 1
    high = min(state.done, begun - 1)
    if not first or nodes[node].kind == TaskKind.TRANSIT:
        high = -1
    yield "cannot-fail", "failed", node, max(done, state.done - 1), high


def _lower_bounds(report: Report, last: Report, taken: int | None) -> Iterator[_Bound]:
    """Yield bounds of fields that do not decrease without a restart of the driver."""
    state, most, fails = report.state, np.inf, report.state.failed >= 0
    yield "went-back", "seen", report.seen, last.seen, most
    yield "went-back", "version", report.version, last.version, most
    yield "went-back", "kept", report.kept, last.kept, most
    yield "went-back", "first", report.first + len(state.samples), taken or 0, most
    yield "went-back", "done", state.done, last.state.done, most
    if not fails:
        yield "went-back", "begun", state.begun, last.state.begun, most
        yield "went-back", "have", report.have, known_nodes(last), most

"""Validation of the reports of a driver against what that driver was cleared for, before a report has any effect.

A driver is a program of somebody else: every field of its reports is input that may be wrong. A report that breaks
a rule is impossible: nothing of it is used, and its robot is not relied on any more.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from planning.tasks.task import TRANSIT
from planning.transforms import Array
from twin.drivers.driver import ClearedNode, Mode, Sample
from twin.live.wire_format import LARGEST_NUMBER, MOST_SAMPLES, Report

FaultCode = Literal[
    "other-session",
    "not-finite",
    "out-of-range",
    "wrong-length",
    "joint-range",
    "unknown-mode",
    "unknown-version",
    "beyond-clearance",
    "disordered",
    "went-back",
    "unknown-command",
    "unknown-order",
    "cannot-fail",
    "not-begun",
    "already-through",
    "failure-withdrawn",
]
"""What is wrong with a report; docs/guides/robots.md has a table of them."""

_MARGIN = 0.5
"""How far outside the range of its model a joint may be measured [rad or m]."""

_MOST_TEXT = 300
"""Longest text of a driver that is passed on."""

_MODES = get_args(Mode)


def plain_text(text: str, most: int = _MOST_TEXT) -> str:
    """Return a text of a driver as one line without control characters and escape sequences.

    Args:
        text: as it came.
        most: greatest length; a longer text is cut, and ends with an ellipsis.
    """
    start = " ".join(text[: 4 * most].split())
    shown = "".join(c if c.isprintable() else "?" for c in start)
    return shown if len(shown) <= most else f"{shown[: most - 1]}…"


@dataclass(frozen=True)
class ReportFault:
    """Why a report is impossible.

    Attributes:
        code: the rule that it breaks.
        field: the field of ``cell.proto`` that breaks it.
        value: of that field; a text is cut.
        low, high: least and greatest value that would have been possible, None for no bound.
    """

    code: FaultCode
    field: str
    value: float | str = ""
    low: float | None = None
    high: float | None = None

    def __str__(self) -> str:
        if isinstance(self.value, str):
            shown = repr(plain_text(self.value, 60))
        else:
            shown = f"{self.value:.10g}"
        bounds = (("at least", self.low), ("at most", self.high))
        allowed = [f"{word} {own:.10g}" for word, own in bounds if own is not None]
        must = f", possible {' and '.join(allowed)}" if allowed else ""
        return f"impossible report ({self.code}): {self.field} {shown}{must}"


@dataclass(frozen=True)
class Clearance:
    """What bounds the next report of a driver.

    Attributes:
        joints: of the robot.
        lower, upper: range of each joint, shape (n,) [rad or m]; None where it is not known.
        most: nodes of the graph of the report's version that the driver was told of; None where it was told of no
            such version.
        nodes: that the robot is cleared for, from its first one on.
        commands: number of the last command that was sent.
        orders: names of all orders that its tool was given.
        last: the last report of the same instance that was used, None before the first.
        taken: number of the next sample that is wanted, None before the first.
        done: nodes that the driver has reported as done.
        begun: nodes that it has reported as begun, in a report or in a sample.
        failed: the node of a skill that it has reported as failed, for which no graph has been made yet; -1 for none.
    """

    joints: int
    lower: Array | None
    upper: Array | None
    most: int | None
    nodes: Sequence[ClearedNode]
    commands: int
    orders: Collection[str]
    last: Report | None
    taken: int | None
    done: int
    begun: int
    failed: int


def report_fault(report: Report, known: Clearance) -> ReportFault | None:
    """Return the first rule that a report breaks, None where it is possible.

    Args:
        report: any report, as it was read.
        known: what the driver was cleared for and has reported.
    """
    return next(_faults(report, known), None)


def _faults(report: Report, known: Clearance) -> Iterator[ReportFault]:
    yield from _number_faults(report)
    if not report.session:
        return  # of a driver that has not been told yet, only the clock is used
    yield from _joint_faults(report, known)
    yield from _command_faults(report, known)
    yield from _node_faults(report, known)
    yield from _sample_faults(report, known)
    yield from _failure_faults(report, known)


def _number_faults(report: Report) -> Iterator[ReportFault]:
    """Yield numbers that no clock or sensor has."""
    state = report.state
    if len(state.samples) > MOST_SAMPLES:
        count = float(len(state.samples))
        yield ReportFault("out-of-range", "samples", count, high=MOST_SAMPLES)
    if state.mode not in _MODES:
        yield ReportFault("unknown-mode", "mode", state.mode)
    for field, value in (("at_s", report.at_s), ("off", state.off)):
        yield from _finite(field, value)
    yield from _least("off", state.off, 0.0)
    for sample in state.samples:
        yield from _finite("samples.at_s", sample.at_s)


def _finite(field: str, value: float) -> Iterator[ReportFault]:
    if not math.isfinite(value):
        yield ReportFault("not-finite", field, value)
    elif abs(value) > LARGEST_NUMBER:
        low, high = -LARGEST_NUMBER, LARGEST_NUMBER
        yield ReportFault("out-of-range", field, value, low, high)


def _least(field: str, value: float, low: float) -> Iterator[ReportFault]:
    if value < low:
        yield ReportFault("out-of-range", field, value, low=low)


def _joint_faults(report: Report, known: Clearance) -> Iterator[ReportFault]:
    """Yield positions and speeds that the robot cannot have."""
    state = report.state
    positions = [("q", state.q), *(("samples.q", own.q) for own in state.samples)]
    for field, values in (*positions, ("dq", state.dq)):
        if values.shape != (known.joints,):
            count, joints = float(values.size), known.joints
            yield ReportFault("wrong-length", field, count, joints, joints)
    speeds = np.abs(state.dq)
    if not speeds.max(initial=0.0) <= LARGEST_NUMBER:
        yield ReportFault("not-finite", "dq", float(speeds.max()))
    rows = np.stack([values for _, values in positions])
    if not np.isfinite(rows).all():
        k = int(np.flatnonzero(~np.isfinite(rows).all(axis=1))[0])
        wrong = rows[k][~np.isfinite(rows[k])]
        yield ReportFault("not-finite", positions[k][0], float(wrong[0]))
    lower = -LARGEST_NUMBER if known.lower is None else known.lower - _MARGIN
    upper = LARGEST_NUMBER if known.upper is None else known.upper + _MARGIN
    outside = np.argwhere((rows < lower) | (rows > upper))
    if len(outside):
        k, joint = outside[0].tolist()
        low, high = (
            float(np.broadcast_to(bound, known.joints)[joint])
            for bound in (lower, upper)
        )
        field, value = f"{positions[k][0]}[{joint}]", float(rows[k, joint])
        yield ReportFault("joint-range", field, value, low, high)


def _command_faults(report: Report, known: Clearance) -> Iterator[ReportFault]:
    """Yield commands and orders that nobody gave."""
    if report.seen > known.commands:
        yield ReportFault("unknown-command", "seen", report.seen, high=known.commands)
    if report.state.acted and report.state.acted not in known.orders:
        yield ReportFault("unknown-order", "acted", report.state.acted)
    last = known.last
    if last is None:
        return
    for field, value, before in (
        ("seen", report.seen, last.seen),
        ("version", report.version, last.version),
        ("kept", report.kept, last.kept),
    ):
        if value < before:
            yield ReportFault("went-back", field, value, low=before)


def known_nodes(report: Report) -> int:
    """Return how many nodes a driver knows; after a skill that failed those beyond its first one do not count."""
    failed = report.state.failed
    return report.have if failed < 0 else min(report.have, failed + 1)


def _node_faults(report: Report, known: Clearance) -> Iterator[ReportFault]:
    """Yield nodes that the robot cannot be in."""
    state, most = report.state, known.most
    if most is None:
        yield ReportFault("unknown-version", "version", report.version)
        return
    have = known_nodes(report)
    for field, value in (("have", have), ("begun", state.begun), ("done", state.done)):
        if not 0 <= value <= most:
            yield ReportFault("beyond-clearance", field, value, 0, most)
    if not state.done <= state.begun <= have:
        yield ReportFault("disordered", "begun", state.begun, state.done, have)
    if state.begun > state.done + 1:
        yield ReportFault("disordered", "begun", state.begun, high=state.done + 1)
    last = known.last
    if last is None:
        return
    fails = state.failed >= 0
    for field, value, before in (
        ("done", state.done, last.state.done),
        ("begun", state.begun, 0 if fails else last.state.begun),
        ("have", have, 0 if fails else known_nodes(last)),
    ):
        if value < before:
            yield ReportFault("went-back", field, value, low=before)


def _sample_faults(report: Report, known: Clearance) -> Iterator[ReportFault]:
    """Yield samples that contradict each other, the report or the clearance."""
    samples, most = report.state.samples, known.most or 0
    if not 0 <= report.kept <= report.first <= 2**53:
        yield ReportFault("disordered", "first", report.first, report.kept, 2**53)
    if known.taken is not None and known.last is not None:
        count = report.first + len(samples)
        if count < known.taken:
            yield ReportFault("went-back", "first", count, low=known.taken)
    before = 0
    for own in samples:
        if not 0 <= own.done <= report.state.done:
            high = report.state.done
            yield ReportFault("disordered", "samples.done", own.done, 0, high)
        if not own.done <= own.begun <= min(own.done + 1, most):
            high = min(own.done + 1, most)
            yield ReportFault("disordered", "samples.begun", own.begun, own.done, high)
        if own.done < before:
            yield ReportFault("went-back", "samples.done", own.done, low=before)
        before = own.done


def _failure_faults(report: Report, known: Clearance) -> Iterator[ReportFault]:
    """Yield failures of what cannot fail, and failures that are taken back."""
    state, node, last = report.state, report.state.failed, known.last
    told = -1 if last is None else last.state.failed
    if node != told and told >= 0 and known.failed == told:
        yield ReportFault("failure-withdrawn", "failed", node, told, told)
    if node < 0:
        return
    if node >= (known.most or 0):
        high = (known.most or 0) - 1
        yield ReportFault("beyond-clearance", "failed", node, 0, high)
        return
    nodes = known.nodes
    first = node == 0 or nodes[node - 1].task != nodes[node].task
    if told != node and (nodes[node].kind == TRANSIT or not first):
        yield ReportFault("cannot-fail", "failed", node)
    if state.done > node + 1 or (told != node != known.failed and known.done > node):
        yield ReportFault("already-through", "failed", node, low=state.done)
    complete = known.taken is not None and report.first <= known.taken
    if state.done < node or (complete and begun_by(report, known.begun) <= node):
        yield ReportFault("not-begun", "failed", node, high=state.begun - 1)


def begun_by(report: Report, begun: int) -> int:
    """Return how many nodes a driver has begun by a report, and by what is known before it."""
    samples: Sequence[Sample] = report.state.samples
    return max(begun, report.state.begun, *(own.begun for own in samples), 0)

"""Audit of processes such as screwing: required position, robot, and parts that another robot holds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from planning.transforms import Array, Indices, Transform
from twin.audits.case import AuditCase, Violation, tool_frames
from twin.audits.expectations import ExpectedProcess
from twin.audits.motion.executed import RobotRows
from twin.audits.part_holding import keeping_violations
from twin.audits.supports import nearest_hand
from twin.audits.work_places import machine_work_spans
from twin.audits.worlds.world import FAR

NEAR = 0.001
"""A tool comes as near as this to where its process is done [m]."""

ALONG = float(np.radians(1.0))
"""Its z axis is opposite to that of the place to within this [rad]."""

_STEP = 0.02
"""Time between two looks at where a tool that moves is [s]."""


@dataclass(frozen=True)
class _DoneProcess:
    """A process that was executed.

    Attributes:
        robot: its robot.
        begin, end: when [s].
        missed: how far its tool stayed away from the place, 0 if it came there [m].
        words: description of a wrong tool position; empty if none.
    """

    robot: str
    begin: float
    end: float
    missed: float
    words: str


def process_violations(case: AuditCase) -> Iterator[Violation]:
    """Yield missing or wrong processes.

    Each wanted process is one task of its name, in which the tool's frame comes to every pose of
    its path in turn, z opposite to that of the place, relative to where the part or fixture is
    then. A part that is to be held has another robot's tool at it that stands still meanwhile.
    Steps begin after the end of their predecessors, and parts to be held until a step is complete stay
    held. Without a log the work of machines is not checked, nor is work before the plan began.
    """
    begun = case.cell.begun
    before = () if begun is None else begun.steps
    tasks, wanted = case.tpg.tasks, case.wanted
    left = [task.index for task in tasks]
    ends = dict(_placed_at(case))
    begins = dict(ends)
    for process in wanted.processes:
        if process.step in before:
            continue
        tried = [
            (index, _done(case, process, index))
            for index in left
            if tasks[index].kind == process.process
        ]
        if not tried:
            yield _not_done(case.end, process, 0.0, "was not done")
            continue
        index, done = min(tried, key=lambda entry: (entry[1].missed, entry[0]))
        if done.words:
            missed = done.missed if np.isfinite(done.missed) else 0.0
            yield _not_done(case.end, process, missed, done.words)
            continue
        left.remove(index)
        if process.name is not None:
            begins[process.name], ends[process.name] = done.begin, done.end
        if process.hold is not None:
            yield from _held(case, process.hold, done)
    if case.logged:
        work = machine_work_spans(case).items()
        ends.update({wanted.rests[k].name or "": end for k, (_, _, end) in work})
    yield from keeping_violations(case, ends)
    for name, after in wanted.order():
        least = wanted.lags.get((name, after), 0.0)
        if (
            name in begins
            and after in ends
            and begins[name] < ends[after] + least - 1e-6
        ):
            detail = f"{name} begins before {after} is complete"
            detail += f" for {least:g} s" if least else ""
            t = begins[name]
            yield Violation(t, ends[after], name, after, 0.0, detail, "process")


def _placed_at(case: AuditCase) -> Iterator[tuple[str, float]]:
    """Yield the steps that place objects, with the last time these came to rest [s]."""
    for place in case.wanted.places:
        stays = case.stays.get(place.object or "", ())
        if place.name is not None and len(stays) > 1 and stays[-1].holder is None:
            yield place.name, stays[-1].t


def _not_done(
    end: float, process: ExpectedProcess, missed: float, words: str
) -> Violation:
    owner = process.owner or "world"
    return Violation(end, end, process.words, owner, missed, words, "process")


def _done(case: AuditCase, process: ExpectedProcess, index: int) -> _DoneProcess:
    robot = case.tpg.tasks[index].robot
    rows = case.robots[robot]
    chain = case.tpg.chains[case.tpg.chain_index[robot]]
    span = _span(rows, np.flatnonzero(chain.task == index))
    if span is None:
        return _DoneProcess(robot, 0.0, 0.0, np.inf, "was not done")
    otherwise = partial(_DoneProcess, robot, *span, np.inf)
    if process.robots is not None and robot not in process.robots:
        return otherwise(f"was done by {robot}")
    begin, end = span
    place = _place(case, process, end)
    if place is None:
        return otherwise(f"{process.owner} is in a hand meanwhile")
    tip = _tip(case, process, robot, span)
    if isinstance(tip, str):
        return otherwise(tip)
    times = rows.moving_samples(begin, end, _STEP)
    tools = case.world.flange_poses(case.numbers[robot], rows.at(times)) @ tip
    missed, words = _missed(tools, [place @ at for at in process.path])
    return _DoneProcess(robot, begin, end, missed, words)


def _span(rows: RobotRows, nodes: Indices) -> tuple[float, float] | None:
    """Return the interval of a robot's nodes [s], None if never executed.

    What takes no time has no rows of its own within limits: it is passed where the next node begins.
    """
    own = np.flatnonzero(np.isin(rows.node, nodes))
    if not len(own):
        after = int(np.searchsorted(rows.node, nodes[0]))
        if not 0 < after < len(rows.node):
            return None
        passed = float(rows.t[after - 1])
        return passed, passed
    return float(rows.t[max(0, int(own[0]) - 1)]), float(rows.t[own[-1]])


def _place(case: AuditCase, process: ExpectedProcess, t: float) -> Transform | None:
    """Return the place of a process, None while its part is held."""
    if process.owner is None:
        return process.pose
    stay = case.place(process.owner, t)
    if stay is None or stay.holder is not None:
        return None
    return np.asarray(stay.pose @ process.pose)


def _tip(
    case: AuditCase, process: ExpectedProcess, robot: str, span: tuple[float, float]
) -> Transform | str:
    """Return the process frame in the flange frame, or the fault of the tool."""
    placed = case.cell.robot(robot)
    frames = placed.model.frames
    if any(tool.robot == robot for tool in case.wanted.tools):
        on_it = [case.tool_on(robot, t) for t in span]
        names = ["no tool" if tool is None else tool.name for tool in on_it]
        if process.tool is not None and set(names) != {process.tool}:
            return f"was done with {' and '.join(dict.fromkeys(names))}, not {process.tool}"
        frames = {} if on_it[0] is None else tool_frames(placed, on_it[0])
    if process.frame == "flange":
        return np.eye(4)
    return frames.get(process.frame, f"was done without a frame {process.frame!r}")


def _missed(tools: Array, path: list[Transform]) -> tuple[float, str]:
    """Return the largest deviation of a tool from a path, and its description."""
    first = 0
    for at in path:
        away = np.linalg.norm(tools[first:, :3, 3] - at[:3, 3], axis=1)
        near = np.flatnonzero(away <= NEAR)
        if not len(near):
            least = float(away.min())
            words = f"its tool comes no nearer than {least * 1e3:.2f} mm to its place"
            return least, words
        tilt = np.arccos(np.clip(-tools[first + near, :3, 2] @ at[:3, 2], -1.0, 1.0))
        if float(tilt.min()) > ALONG:
            words = f"its tool leans by {np.degrees(tilt.min()):.1f} deg at its place"
            return float(away.min()), words
        first += int(near[int(np.argmin(tilt))])
    return 0.0, ""


def _held(case: AuditCase, part: str, done: _DoneProcess) -> Iterator[Violation]:
    """Yield that a part was not held while a process was done."""
    stay, span = case.place(part, done.end), (done.begin, done.end)
    there = {} if stay is None else {part: stay}
    hand = nearest_hand(case, span, done.robot, there)
    if not hand.is_near:
        detail = "is not held meanwhile by another robot that stands still"
        if hand.gap < FAR:
            detail += f": the nearest is {hand.gap * 1e3:.2f} mm away"
            detail += f", of which it {hand.loose}" if hand.loose else ""
        yield Violation(*span, part, done.robot, 0.0, detail, "support")

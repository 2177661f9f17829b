"""Processes are done where the scenario says, by who may, while what is to be held is held."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from planning.cell.workcell import Workcell
from planning.transforms import Array, Indices, Transform
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.audit.grips import finger_travel
from twin.audit.keeping import NodeSpans, keeping_violations
from twin.audit.motion.executed import Recording, RobotRows
from twin.audit.places import rows_at
from twin.audit.resting import machine_work
from twin.audit.supports import SUPPORT, stands_still
from twin.audit.tools import flange_poses, hand_of, tool_frames, tool_on
from twin.audit.violation import Violation
from twin.audit.wanted import Wanted, WantedProcess
from twin.audit.worlds.world import FAR, AuditWorld

NEAR = 0.001
"""A tool comes as near as this to where its process is done [m]."""

ALONG = float(np.radians(1.0))
"""Its z axis is opposite to that of the place to within this [rad]."""

_STEP = 0.02
"""Time between two looks at where a tool is [s]."""


@dataclass(frozen=True)
class _DoneProcess:
    """A process that was executed.

    Attributes:
        robot: who did it.
        begin, end: when [s].
        missed: how far its tool stayed away from the place, 0 if it came there [m].
        words: what is wrong with where the tool was; empty if nothing is.
    """

    robot: str
    begin: float
    end: float
    missed: float
    words: str


def process_violations(
    world: AuditWorld,
    tpg: TemporalPlanGraph,
    recording: Recording,
    wanted: Wanted,
    spans: Mapping[str, NodeSpans],
) -> Iterator[Violation]:
    """Yield processes that were not done, or not as the scenario says.

    Each wanted process is one task of its name, in which the tool's frame comes to every pose of
    its path in turn, z opposite to that of the place, relative to where the part or fixture is
    then. A part that is to be held has another robot's tool at it that stands still meanwhile.
    Steps begin after the end of those that they are to come after, and what is to be kept hold of
    until a step is complete stays in its hand for that long.

    Args:
        world: to measure in.
        tpg: says which tasks are processes.
        recording: what was executed, to its end.
        wanted: the processes.
        spans: when nodes were started and completed, by robot or machine; empty where no log says
            so, and then machines' work is waited for by nobody.
    """
    left = [task.index for task in tpg.tasks]
    ends = dict(_placed_at(recording, wanted))
    begins = dict(ends)
    for process in wanted.processes:
        tried = [
            (index, _done(world, tpg, recording, wanted, process, index))
            for index in left
            if tpg.tasks[index].kind == process.process
        ]
        if not tried:
            yield _not_done(recording, process, 0.0, "was not done")
            continue
        index, done = min(tried, key=lambda entry: (entry[1].missed, entry[0]))
        if done.words:
            missed = done.missed if np.isfinite(done.missed) else 0.0
            yield _not_done(recording, process, missed, done.words)
            continue
        left.remove(index)
        if process.name is not None:
            begins[process.name], ends[process.name] = done.begin, done.end
        if process.hold is not None:
            yield from _held(world, recording, wanted, process.hold, done)
    if spans:
        work = machine_work(tpg, wanted, spans).items()
        ends.update({wanted.rests[k].name or "": end for k, (_, _, end) in work})
    yield from keeping_violations(tpg, recording, wanted, ends, spans)
    for name, after in wanted.order():
        if name in begins and after in ends and begins[name] < ends[after] - 1e-6:
            detail = f"{name} begins before {after} is complete"
            t = begins[name]
            yield Violation(t, ends[after], name, after, 0.0, detail, "process")


def _placed_at(recording: Recording, wanted: Wanted) -> Iterator[tuple[str, float]]:
    """Yield the names of steps that place objects, with when those came to rest last [s]."""
    for place in wanted.places:
        rows = [row for row in recording.objects if row.object == place.object]
        if place.name is not None and len(rows) > 1 and rows[-1].holder is None:
            yield place.name, rows[-1].t


def _not_done(
    recording: Recording, process: WantedProcess, missed: float, words: str
) -> Violation:
    end, owner = recording.end, process.owner or "world"
    return Violation(end, end, process.words, owner, missed, words, "process")


def _done(
    world: AuditWorld,
    tpg: TemporalPlanGraph,
    recording: Recording,
    wanted: Wanted,
    process: WantedProcess,
    index: int,
) -> _DoneProcess:
    task = tpg.tasks[index]
    rows = recording.robots[task.robot]
    chain = tpg.chains[tpg.chain_index[task.robot]]
    span = _span(rows, np.flatnonzero(chain.task == index))
    if span is None:
        return _DoneProcess(task.robot, 0.0, 0.0, np.inf, "was not done")
    begin, end = span
    if process.robots is not None and task.robot not in process.robots:
        words = f"was done by {task.robot}"
        return _DoneProcess(task.robot, begin, end, np.inf, words)
    place = _place(world.cell, recording, process, end)
    if place is None:
        words = f"{process.owner} is in a hand meanwhile"
        return _DoneProcess(task.robot, begin, end, np.inf, words)
    times = np.unique(
        np.r_[
            rows.t[(rows.t > begin) & (rows.t < end)], np.arange(begin, end, _STEP), end
        ]
    )
    tip = _tip(world.cell, recording, wanted, process, task.robot, (begin, end))
    if isinstance(tip, str):
        return _DoneProcess(task.robot, begin, end, np.inf, tip)
    number = [robot.name for robot in world.cell.robots].index(task.robot)
    tools = flange_poses(world, number, rows.at(times)) @ tip
    missed, words = _missed(tools, [place @ at for at in process.path])
    return _DoneProcess(task.robot, begin, end, missed, words)


def _span(rows: RobotRows, nodes: Indices) -> tuple[float, float] | None:
    """Return from when to when a robot is at some nodes [s], None if it never is.

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


def _place(
    cell: Workcell, recording: Recording, process: WantedProcess, t: float
) -> Transform | None:
    """Return where a process is done, None while its part is in a hand."""
    if process.owner is None:
        return process.pose
    row = rows_at(cell, recording, t).get(process.owner)
    if row is None or row.holder is not None:
        return None
    return np.asarray(row.pose @ process.pose)


def _tip(
    cell: Workcell,
    recording: Recording,
    wanted: Wanted,
    process: WantedProcess,
    robot: str,
    span: tuple[float, float],
) -> Transform | str:
    """Return where the frame of a process is in the flange frame, or what is wrong with the tool."""
    frames = cell.robot(robot).model.frames
    if any(tool.robot == robot for tool in wanted.tools):
        rows = [rows_at(cell, recording, t) for t in span]
        on_it = [tool_on(wanted, there, robot) for there in rows]
        names = ["no tool" if tool is None else tool.name for tool in on_it]
        if process.tool is not None and set(names) != {process.tool}:
            return f"was done with {' and '.join(dict.fromkeys(names))}, not {process.tool}"
        placed, tool = cell.robot(robot), on_it[0]
        frames = {} if tool is None else tool_frames(placed, tool)
    if process.frame == "flange":
        return np.eye(4)
    return frames.get(process.frame, f"was done without a frame {process.frame!r}")


def _missed(tools: Array, path: list[Transform]) -> tuple[float, str]:
    """Return how far a tool stays away from a path at most, and what is wrong in words."""
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


def _held(
    world: AuditWorld,
    recording: Recording,
    wanted: Wanted,
    part: str,
    done: _DoneProcess,
) -> Iterator[Violation]:
    """Yield that a part was not held while a process was done."""
    shapes = [item for item in world.objects if item.entity == part]
    there = rows_at(world.cell, recording, done.end)
    row = there[part]
    least, closing = FAR, 0.0
    for k, robot in enumerate(world.cell.robots):
        rows = recording.robots[robot.name]
        if robot.name == done.robot or row.holder is not None:
            continue
        if not stands_still(rows, done.begin, done.end):
            continue
        q = rows.at(np.array([done.begin]))[0]
        hand = hand_of(world, k, q, there, wanted)
        opening = hand.opening(wanted.opening_m)
        for shape in shapes:
            world.place(shape, shape.at(row.pose))
            gap = min(world.distance(item, shape, FAR) for item in hand.shapes)
            closes = finger_travel(shape, opening)
            if gap - closes < least - closing:
                least, closing = gap, closes
    if least > SUPPORT + closing:
        detail = "is not held meanwhile by another robot that stands still"
        if least < FAR:
            detail += f": the nearest is {least * 1e3:.2f} mm away"
        yield Violation(done.begin, done.end, part, done.robot, 0.0, detail, "support")

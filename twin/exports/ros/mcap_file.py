"""Export of a run as an MCAP file with joint states, frames, trajectories and markers.

Time 0 is the start of the run. Messages of moving robots and objects have a given rate. All messages are
repeated once a second for late subscribers, until one minute after the last motion.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from planning.cell.workcell import CellObject, Fixture
from planning.transforms import Array, Indices
from twin.drawing.looks import coloured_fixtures
from twin.drawing.team_colours import parse_rgb, team_colours
from twin.drawing.triangles import corners_of
from twin.durations.nanoseconds import NANOSECONDS, Nanoseconds
from twin.exports.ros.bag import Message, Topic, rosbag_file
from twin.exports.ros.definitions import (
    JOINT_STATE,
    JOINT_TRAJECTORY,
    MARKER_ARRAY,
    TF_MESSAGE,
)
from twin.exports.ros.drawn_robot import drawn_robot
from twin.exports.ros.frames import (
    WORLD,
    ObjectState,
    fixed_frames,
    link_frame,
    moved_frames,
    object_frame,
    object_states,
)
from twin.exports.ros.messages import (
    FramePose,
    Marker,
    frame_pose,
    joint_state,
    joint_trajectory,
    marker_array,
    tf_message,
)
from twin.exports.segments import STILL, require_rate, segments
from twin.runs.tracking import nearest_on_path
from twin.runs.trajectory import Trajectory
from twin.trial.run_result import RunResult

RATES_HZ = (1.0, 1000.0)
RATE_HZ = 50.0

_TF = Topic("/tf", TF_MESSAGE)
_TF_STATIC = Topic("/tf_static", TF_MESSAGE, latched=True)
_ROBOTS = Topic("/robots", MARKER_ARRAY, latched=True)
_FIXTURES = Topic("/fixtures", MARKER_ARRAY, latched=True)
_OBJECTS = Topic("/objects", MARKER_ARRAY, latched=True)

_REPEATED_NS = 60 * NANOSECONDS
"""Time after the last motion for which all messages are repeated once a second [ns]."""


def mcap_files(run: RunResult, *, rate_hz: float = RATE_HZ) -> Mapping[str, bytes]:
    """Return ``run.mcap``.

    Args:
        run: the run.
        rate_hz: of the messages about what moves, and of points of trajectories where speeds are
            known [Hz].

    Raises:
        OutputError: there is no such rate, or a package is missing.
    """
    require_rate(rate_hz, RATES_HZ)
    return {"run.mcap": rosbag_file(_messages(run, rate_hz))}


def _messages(run: RunResult, rate_hz: float) -> Iterator[Message]:
    """Yield all messages; only those of the same time are in order."""
    cell = run.tpg.cell
    colours = team_colours([robot.name for robot in cell.robots])
    drawn = {
        robot.name: drawn_robot(robot, parse_rgb(colours[robot.name]))
        for robot in cell.robots
    }
    fixed = [
        pose for robot in cell.robots for pose in fixed_frames(robot, drawn[robot.name])
    ]
    fixed += [
        frame_pose(WORLD, _fixture_frame(item.name), item.pose)
        for item in cell.fixtures
    ]
    yield Message(0, _TF_STATIC, tf_message(0, fixed))
    bodies = [
        Marker(link_frame(name, body.link), name, number, body.corners, body.colour)
        for name, robot in drawn.items()
        for number, body in enumerate(robot.bodies)
    ]
    yield Message(0, _ROBOTS, marker_array(bodies))
    fixtures = [
        _marker(_fixture_frame(item.name), item, colour)
        for item, colour in coloured_fixtures(cell)
    ]
    yield Message(0, _FIXTURES, marker_array(fixtures))
    yield from _objects(run)
    spaces = _name_spaces([robot.name for robot in cell.robots])
    for robot in cell.robots:
        motion = run.motions[robot.name]
        times = _times(motion, rate_hz)
        if motion.v is None:
            q, v = motion.at(times), None
        else:
            q, v, _ = motion.states_at(times)
        states = Topic(f"/{spaces[robot.name]}/joint_states", JOINT_STATE)
        names = tuple(robot.model.joint_names)
        frames = moved_frames(robot, drawn[robot.name], q)
        for k, (t_ns, poses) in enumerate(zip(times.tolist(), frames, strict=True)):
            speeds = None if v is None else v[k]
            yield Message(t_ns, states, joint_state(t_ns, names, q[k], speeds))
            yield Message(t_ns, _TF, tf_message(t_ns, poses))
        if robot.name in run.measured:
            wanted = Topic(f"/{spaces[robot.name]}/planned/joint_states", JOINT_STATE)
            chain = run.tpg.chains[run.tpg.chain_index[robot.name]]
            at = np.searchsorted(motion.t_ns, times, side="right") - 1
            near = nearest_on_path(chain, q, motion.node[at])
            for t_ns, point in zip(times.tolist(), near, strict=True):
                yield Message(t_ns, wanted, joint_state(t_ns, names, point, None))
    for segment in segments(run, rate_hz):
        t_ns = (segment.motion or segment.executed)[0]
        if t_ns >= 0 and segment.robot in spaces:
            name = f"/{spaces[segment.robot]}/joint_trajectory"
            topic = Topic(name, JOINT_TRAJECTORY)
            yield Message(t_ns, topic, joint_trajectory(t_ns, segment))


def _times(motion: Trajectory, rate_hz: float) -> Nanoseconds:
    """Return message times of a robot: at a rate while it moves, and every second [ns].

    Of a standstill that lasts for more than a minute there are those of the first minute.
    """
    end, period = int(motion.t_ns[-1]), NANOSECONDS / rate_hz
    begins, ends = _moving(motion)
    near = _whole_numbers(begins / period - 1.0, ends / period + 1.0)
    seconds = _whole_numbers(
        begins / NANOSECONDS - 1.0, (ends + _REPEATED_NS) / NANOSECONDS
    )
    near = np.union1d(near, np.ceil(seconds * rate_hz).astype(np.int64))
    grid = np.rint(near[near >= 0] * period).astype(np.int64)
    times = np.unique(np.append(grid[grid < end], [0, end]))
    moves = np.any(np.diff(motion.at(times), axis=0) != 0.0, axis=1)
    second = np.diff(times // NANOSECONDS, prepend=-1) > 0
    said = second | np.append(moves, True) | np.append(True, moves)
    return np.asarray(times[said])


def _moving(motion: Trajectory) -> tuple[Nanoseconds, Nanoseconds]:
    """Return when a robot moves, from and to, with the beginning of the run as a moment of motion [ns]."""
    moves = np.any(np.abs(np.diff(motion.q, axis=0)) > STILL, axis=1)
    if motion.v is not None:
        moving = np.any(motion.v != 0.0, axis=1)
        moves |= moving[:-1] | moving[1:]
    begins, ends = motion.t_ns[:-1][moves], motion.t_ns[1:][moves]
    return np.append(0, begins), np.append(0, ends)


def _whole_numbers(low: Array, high: Array) -> Indices:
    """Return the whole numbers in any of some ranges, both ends included, in order."""
    first, last = np.floor(low).astype(np.int64), np.ceil(high).astype(np.int64)
    order = np.argsort(first, kind="stable")
    first, last = first[order], np.maximum.accumulate(last[order])
    first = np.maximum(first, np.append(first[0], last[:-1] + 1))
    return np.concatenate(
        [np.arange(a, b + 1) for a, b in zip(first, last, strict=True)]
    )


def _objects(run: RunResult) -> Iterator[Message]:
    """Yield object poses at every transfer and every second, and their markers."""
    there: ObjectState | None = None
    spans = [_moving(motion) for motion in run.motions.values()]
    begins, ends = map(np.concatenate, zip(*spans, strict=True))
    seconds = _whole_numbers(begins / NANOSECONDS, (ends + _REPEATED_NS) / NANOSECONDS)
    shown: frozenset[str] | None = None
    for state in object_states(run):
        if there is not None:
            yield from _repeated_poses(there, state.t_ns, seconds)
        there = state
        full_second = state.t_ns % NANOSECONDS == 0
        names = state.frames if full_second else state.changed
        poses = [state.frames[name] for name in names]
        yield Message(state.t_ns, _TF, tf_message(state.t_ns, poses))
        if shown != state.frames.keys():
            shown = frozenset(state.frames)
            markers = [
                _marker(object_frame(item.name), item, item.colour)
                for item in run.tpg.cell.objects
                if item.name in shown
            ]
            yield Message(state.t_ns, _OBJECTS, marker_array(markers))
    if there is not None:
        yield from _repeated_poses(there, run.makespan_ns + 1, seconds)


def _repeated_poses(
    objects: ObjectState, end_ns: int, seconds: Indices
) -> Iterator[Message]:
    """Yield where all objects are at full seconds before a time [ns]: some, and those soon after a change."""
    poses: list[FramePose] = list(objects.frames.values())
    soon = objects.t_ns // NANOSECONDS + np.arange(_REPEATED_NS // NANOSECONDS + 1)
    times = np.union1d(seconds, soon) * NANOSECONDS
    for t_ns in times[(times > objects.t_ns) & (times < end_ns)].tolist():
        yield Message(t_ns, _TF, tf_message(t_ns, poses))


def _marker(
    frame: str, item: Fixture | CellObject, colour: tuple[int, int, int]
) -> Marker:
    """Return what a thing looks like in its frame; its colour is given from 0 to 255."""
    red, green, blue = (channel / 255.0 for channel in colour)
    return Marker(frame, item.name, 0, corners_of(item.shape), (red, green, blue, 1.0))


def _fixture_frame(name: str) -> str:
    return f"fixtures/{name}"


def _name_spaces(robots: Iterable[str]) -> dict[str, str]:
    """Return names of robots as topics may have them: ASCII letters, digits and _, no digit first."""
    out: dict[str, str] = {}
    for robot in robots:
        name = re.sub(r"[^A-Za-z0-9_]", "_", robot)
        if name[:1].isdigit():
            name = f"_{name}"
        while name in out.values():
            name += "_"
        out[robot] = name
    return out

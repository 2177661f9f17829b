"""Motion of a robot within acceleration limits, computed from its commanded positions.

A stretch is a straight segment of a joint-space path that begins and ends at rest. On it, the executed position is the
moving average of the commanded positions over the preceding time ``lag``. Commanded positions are piecewise quadratic
in time, so executed positions are piecewise cubic. Their breakpoints are those of the commanded positions, and the
same shifted by ``lag``. The motion is given by positions and speeds at these breakpoints.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from planning.timing.blended_path import BlendedPath
from planning.timing.braking import StoppedPath
from planning.transforms import Array, Indices
from scheduling.graph.temporal_plan_graph import NodeChain, TemporalPlanGraph
from scheduling.motion_times import node_path, skill_motion
from scheduling.stretch_times import blended_path
from twin.durations.nanoseconds import NANOSECONDS, Nanoseconds
from twin.runs.cubic_motion import with_cubics
from twin.runs.execution_record import ExecutionRecord
from twin.uncertainty.stopped_skills import stopped_skill, stops_of

_STANDS = 1e-7
"""Share of full speed at which a robot stands."""

_BESIDE = 1e-6
"""Share of a stretch by which rounding may keep a robot that stands from a border."""

_FINE_NS = 12e6
"""Farthest that rows around corners are apart, before each gap is cut in three [ns]."""

_STEP_NS = 1.0
"""Way, as time at full speed, by which rounded times may seem to move a robot that stands [ns]."""

_AT_BORDER = 1e-9
"""Share of a stretch within which a position counts as at a border."""

Rows = tuple[Nanoseconds, Array, Array, Array, Indices]
"""Times [ns], configurations, joint speeds and accelerations, and the node of each row."""


def driven_rows(tpg: TemporalPlanGraph, run: ExecutionRecord, k: int) -> Rows:
    """Return the rows of a robot's motion: cubic in time between them.

    Args:
        tpg: the executed plan.
        run: of it.
        k: index of the robot's chain.
    """
    chain = tpg.chains[k]
    parts: list[Rows] = [_row(0, chain.start, -1)]
    assert chain.drive is not None
    begins = np.append(0, np.flatnonzero(chain.drive.rests) + 1)
    commands = run.commands[k]
    for begin, stop in zip(begins, begins[1:], strict=False):
        if run.start_ns[k][begin] < 0 or run.failed_nodes[k] == begin:
            break
        nodes = slice(int(begin), int(stop))
        if chain.drive.ramp[begin] > 0.0:
            low, high = np.searchsorted(commands[:, 1], [begin, stop])
            override = (
                float(run.speed_override[k][begin]) if run.speed_override else 1.0
            )
            parts.append(_stretch_rows(chain, nodes, commands[low:high], override))
        else:
            parts += _skill_rows(tpg, run, k, int(begin))
    t, q, v, a, node = (np.concatenate(column) for column in zip(*parts, strict=True))
    # Where one node ends as the next begins, the robot is still in the one.
    kept = np.append(True, np.diff(t) > 0)
    return t[kept], q[kept], v[kept], a[kept], node[kept]


def _row(t_ns: int, q: Array, node: int) -> Rows:
    still = np.zeros_like(q[None])
    return np.array([t_ns]), q[None], still, still, np.array([node])


def stopped_motion(
    tpg: TemporalPlanGraph, run: ExecutionRecord, k: int, node: int
) -> StoppedPath | None:
    """Return the motion of a skill interrupted by stops at clock times; None without any.

    Args:
        tpg: the executed plan.
        run: of it.
        k: index of the robot's chain.
        node: of it.
    """
    if k >= len(run.commands) or not tpg.chains[k].skill[node]:
        return None
    command = run.commands[k]
    row = int(np.searchsorted(command[:, 1], node))
    if row == len(command) or command[row, 1] != node:
        return None
    begin, duration = int(command[row, 0]), int(command[row, 2])
    return stopped_skill(tpg, (k, node), duration, begin, stops_of(run.stops_ns[k]))


def _skill_rows(
    tpg: TemporalPlanGraph, run: ExecutionRecord, k: int, node: int
) -> Iterator[Rows]:
    """Yield the rows of a node from rest to rest, its path scaled to its duration."""
    chain, robot = tpg.chains[k], tpg.cell.robot(tpg.chains[k].robot)
    stopped = stopped_motion(tpg, run, k, node)
    if stopped is not None:
        seconds, q, v, a = stopped.rows()
        t = np.rint(seconds * NANOSECONDS).astype(np.int64)
        yield t, q, v, a, np.full(len(t), node)
        return
    pace = run.pace(k)
    begin = int(pace.own(run.start_ns[k][node : node + 1])[0])
    begin += int(run.stood_ns[k][node])
    duration = int(run.duration_ns[k][node])
    if duration == 0 or not chain.skill[node] or robot.limits is None:
        q = node_path(chain, node)[-1]
        real = int(pace.real(np.array([begin]))[0])
        yield _row(real, q, node)
        return
    motion = skill_motion(tpg, k, node, robot.limits)
    if motion.seconds > 0.0:
        slower = duration / NANOSECONDS / motion.seconds
        own = begin + np.rint(motion.t * slower * NANOSECONDS).astype(np.int64)
        q, v, a = motion.q, motion.v / slower, motion.a / slower**2
    else:
        # A process that is done standing has a row at its end, too: it is where the node is seen.
        own = np.array([begin, begin + duration])
        q = np.repeat(motion.q, 2, axis=0)
        v, a = np.zeros_like(q), np.zeros_like(q)
    yield pace.real(own), q, v, a, np.full(len(own), node)


def _stretch_rows(
    chain: NodeChain, nodes: slice, commands: Array, override: float
) -> Rows:
    """Return the rows of a stretch.

    Args:
        chain: its robot's nodes.
        nodes: those of the stretch.
        commands: pieces of it, see ``ExecutionRecord``.
        override: share of planned speed at which it was executed.
    """
    drive = chain.drive
    assert drive is not None
    length = drive.cruise[nodes] * NANOSECONDS
    border = np.concatenate([[0.0], np.cumsum(length)])
    lag = float(np.ceil(np.ceil(drive.lag[nodes.start] * NANOSECONDS) / override))
    begin = commands[0, 0]
    # From here on times and lengths count from the beginning of the stretch.
    at = np.maximum.accumulate(commands[:, 0] - begin)
    gone = border[commands[:, 1].astype(np.int64) - nodes.start] + commands[:, 2]
    speed, rate = commands[:, 3], commands[:, 4]
    last = _end_of(at[-1], gone[-1], speed[-1], rate[-1], border[-1])
    edges = np.append(at, last)
    commanded = _PathLength(edges, gone, speed, rate)
    path = blended_path(chain, nodes.start, nodes.stop, drive.cruise[nodes])
    t = np.unique(np.rint(np.concatenate([edges, edges + lag, [0.0]])))
    bends = np.zeros(len(t) - 1, dtype=np.bool_)
    if len(path.window):
        t, bends = _with_corners(t, commanded, lag, path)
    done, pace, rise = commanded.executed(t, lag)
    # Times are whole nanoseconds: a motion within rounding is a standstill.
    moves = (pace > _STANDS) | (np.abs(rise) * lag > _STANDS)
    pace, rise = np.where(moves, pace, 0.0), np.where(moves, rise, 0.0)
    done = np.where(moves, done, _at_border(border, done))
    done = np.clip(done, 0.0, border[-1])
    q, first, second = path.states(done / NANOSECONDS)
    q[done >= border[-1]] = path.points[-1]
    pace, rise = pace[:, None], rise[:, None] * NANOSECONDS
    v, a = pace * first, rise * first + pace**2 * second
    whole = t.astype(np.int64)
    whole, q, v, a = with_cubics(whole, q, v, a, bends)
    # At a border, where it may stand, a robot is still in the node before it.
    inside = np.interp(whole, t, done) - _AT_BORDER * border[-1]
    node = np.searchsorted(border[1:-1], inside, side="left") + nodes.start
    return whole + round(begin), q, v, a, node


def _with_corners(
    t: Array, commanded: _PathLength, lag: float, path: BlendedPath
) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Return row times that resolve the corners, and whether the path bends after each.

    Args:
        t: rising, the first at the begin of the stretch, the last at its end [ns].
        commanded: that was commanded.
        lag: delay of the execution behind the command [ns].
        path: with rounded corners.
    """
    breaks = path.breaks() * NANOSECONDS
    low, high = np.full(len(breaks), t[0]), np.full(len(breaks), t[-1])
    # When each break is passed, to the nanosecond.
    while np.any(high - low > 1.0):
        middle = np.rint(0.5 * (low + high))
        past = commanded.executed(middle, lag)[0] >= breaks
        low, high = np.where(past, low, middle), np.where(past, middle, high)
    t = np.unique(np.concatenate([t, high]))
    middle = commanded.executed(0.5 * (t[1:] + t[:-1]), lag)[0]
    bent = path.bent_pieces()
    piece = np.searchsorted(bent.low * NANOSECONDS, middle) - 1
    inside = (piece >= 0) & (middle < bent.high[piece] * NANOSECONDS)
    # Where a robot stands in a corner, however long, nothing bends.
    inside &= np.diff(commanded.executed(t, lag)[0]) > _STEP_NS
    pieces = np.where(inside, np.ceil(np.diff(t) / _FINE_NS), 1.0).astype(np.int64)
    of = np.repeat(np.arange(len(pieces)), pieces)
    rank = np.arange(len(of)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    fine = np.rint(t[of] + rank / pieces[of] * np.diff(t)[of])
    return np.append(fine, t[-1]), inside[of]


def _at_border(border: Array, done: Array) -> Array:
    """Return the nearest border to each place at which a robot stands, if it is one."""
    k = np.clip(np.searchsorted(border, done), 1, len(border) - 1)
    near = np.where(done - border[k - 1] < border[k] - done, border[k - 1], border[k])
    return np.where(np.abs(near - done) < _BESIDE * border[-1], near, done)


def _end_of(at: float, gone: float, speed: float, rate: float, length: float) -> float:
    """Return when the last piece of a stretch ends: at rest, or at the end of the stretch."""
    if rate < 0.0:
        return float(at - speed / rate)
    left = max(length - gone, 0.0)
    if rate == 0.0:
        return float(at + left / speed) if speed > 0.0 else float(at)
    return float(at + (np.sqrt(speed * speed + 2.0 * rate * left) - speed) / rate)


class _PathLength:
    """Commanded path length over time: quadratic between its edges, at rest before and after.

    Args:
        edges: begins of the pieces, and the end of the last one.
        gone, speed, rate: length, speed and acceleration at the begin of each piece.
    """

    def __init__(self, edges: Array, gone: Array, speed: Array, rate: Array) -> None:
        span = np.diff(edges)
        self._edges = edges
        self._gone, self._speed, self._rate = gone, speed, rate
        self._end = float(gone[-1] + span[-1] * (speed[-1] + 0.5 * rate[-1] * span[-1]))
        # Differences of long sums cancel over a short lag.
        areas = span.astype(np.longdouble) * (
            gone + span * (speed / 2.0 + rate * span / 6.0)
        )
        self._area = np.concatenate([[0.0], np.cumsum(areas)])

    def executed(self, t: Array, lag: float) -> tuple[Array, Array, Array]:
        """Return path length, speed and acceleration at given times: means over the lag before them."""
        late = t - lag
        done = np.asarray((self.area(t) - self.area(late)) / lag, dtype=np.float64)
        pace = (self.gone(t) - self.gone(late)) / lag
        return done, pace, (self.speed(t) - self.speed(late)) / lag

    def _piece(self, t: Array) -> tuple[Indices, Array]:
        piece = np.searchsorted(self._edges, t, side="right") - 1
        piece = np.clip(piece, 0, len(self._gone) - 1)
        since = np.clip(t, self._edges[0], self._edges[-1]) - self._edges[piece]
        return piece, since

    def gone(self, t: Array) -> Array:
        """Return the path length at given times."""
        piece, since = self._piece(t)
        speed, rate = self._speed[piece], self._rate[piece]
        return np.asarray(self._gone[piece] + since * (speed + 0.5 * rate * since))

    def speed(self, t: Array) -> Array:
        """Return the speed at given times."""
        piece, since = self._piece(t)
        inside = (t >= self._edges[0]) & (t < self._edges[-1])
        return np.where(inside, self._speed[piece] + self._rate[piece] * since, 0.0)

    def area(self, t: Array) -> Array:
        """Return the integral of the path length up to given times."""
        piece, since = self._piece(t)
        speed, rate = self._speed[piece] / 2.0, self._rate[piece] / 6.0
        since = since.astype(np.longdouble)
        own = since * (self._gone[piece] + since * (speed + rate * since))
        after = np.maximum(t - self._edges[-1], 0.0) * self._end
        return np.asarray(self._area[piece] + own + after)

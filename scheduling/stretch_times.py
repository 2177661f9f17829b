"""Timing of the nodes of one stretch within speed, acceleration and jerk limits, and its path.

A stretch is a part of a robot's path at whose start and end the robot is at rest.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from planning.errors import PlanInvariantError
from planning.timing.blended_path import BlendedPath
from planning.transforms import Array
from scheduling.graph.temporal_plan_graph import Drive, NodeChain
from scheduling.pace import Pace, Slowing


class Bend(NamedTuple):
    """Corners of a chain that share one curve, see ``RoundedCorners``.

    Attributes:
        begin, stop: its nodes, ``range(begin, stop)``.
        length: time of the whole, in a unit of its own.
        at, window: of its corners, shape (k,).
        corner: shape (k, n).
    """

    begin: int
    stop: int
    length: float
    at: Array
    window: Array
    corner: Array

    def velocity(self, start: Array, end: Array) -> Array:
        """Return the joint velocities on its legs, shape (k + 1, n).

        Args:
            start: where its first node begins, shape (n,).
            end: where its last node ends, shape (n,).
        """
        durations = np.diff(np.concatenate([[0.0], self.at, [self.length]]))
        legs = np.diff(np.vstack([start, self.corner, end]), axis=0)
        return np.asarray(legs / durations[:, None])


def stretch_drive(pace: Pace, chain: NodeChain, begin: int, stop: int) -> Drive:
    """Return the timing limits of the nodes of a stretch; its ``ramp`` is 0 if it does not move.

    Args:
        pace: of the robot.
        chain: its nodes.
        begin, stop: pose nodes ``range(begin, stop)`` of it, a stretch.

    Raises:
        PlanInvariantError: a rounded corner cannot be passed within the limits.
    """
    bends = list(chain_bends(chain, begin, stop))
    if not bends:
        ends = node_ends(chain, begin, stop)
        found, slowing = pace.stretch(begin, ends[0], ends[-1] - ends[0])
        if found.cruise <= 0.0:
            return straight_drive(np.zeros(stop - begin), slowing)
        lengths = np.linalg.norm(np.diff(ends, axis=0), axis=1)
        cruise = found.cruise * lengths / lengths.sum()
        return straight_drive(cruise, slowing, found.ramp, found.lag)
    cruise = _full_speed_times(pace, chain, begin, stop, bends)
    path = blended_path(chain, begin, stop, cruise)
    curve = pace.rounded(begin, path)
    if curve is None:
        raise PlanInvariantError(
            f"a corner of {chain.robot!r} cannot be passed within its limits"
        )
    slowing = pace.rounded_slowing(begin, path, curve)
    drive = straight_drive(cruise, slowing, curve.ramp, curve.lag)
    border = np.concatenate([[0.0], np.cumsum(cruise)])
    for low, high, most in zip(curve.low, curve.high, curve.cap, strict=True):
        zone = (border[1:] > low) & (border[:-1] < high)
        drive.cap[zone] = np.minimum(drive.cap[zone], most)
        drive.ramp[zone] = curve.bent_ramp
    return drive


def straight_drive(
    cruise: Array, slowing: Slowing, ramp: float = 0.0, lag: float = 0.0
) -> Drive:
    """Return the timing limits of nodes of one motion from rest to rest, without corners."""
    count = len(cruise)
    rests = np.arange(1, count + 1) == count
    return Drive(
        cruise,
        np.full(count, ramp),
        np.full(count, lag),
        rests,
        np.full(count, slowing.factor),
        np.full(count, slowing.cause),
        np.ones(count),
    )


def blended_path(chain: NodeChain, begin: int, stop: int, cruise: Array) -> BlendedPath:
    """Return the blended path along the nodes of a stretch.

    Args:
        chain: its robot's nodes.
        begin, stop: nodes ``range(begin, stop)``, a stretch.
        cruise: their times at full speed, shape (stop - begin,) [s].
    """
    border = np.concatenate([[0.0], np.cumsum(cruise)])
    ends = node_ends(chain, begin, stop)[[0, -1]]
    at, points, window = [border[:1]], [ends[:1]], [border[:0]]
    for bend in chain_bends(chain, begin, stop):
        low, high = border[bend.begin - begin], border[bend.stop - begin]
        unit = (high - low) / bend.length
        at.append(low + bend.at * unit)
        window.append(bend.window * unit)
        points.append(bend.corner)
    at.append(border[-1:])
    points.append(ends[1:])
    return BlendedPath(np.concatenate(at), np.vstack(points), np.concatenate(window))


def chain_bends(
    chain: NodeChain, begin: int = 0, stop: int | None = None
) -> Iterator[Bend]:
    """Yield the bends of a chain, in order.

    Args:
        chain: the nodes.
        begin, stop: those that begin within ``range(begin, stop)``; all if nothing else is said.
    """
    rounded = chain.corners
    if rounded is None:
        return
    last = len(chain) if stop is None else stop
    low, high = np.searchsorted(rounded.begin, [begin, last]).tolist()
    for k in range(low, high):
        own = slice(*np.searchsorted(rounded.bend, [k, k + 1]).tolist())
        yield Bend(
            int(rounded.begin[k]),
            int(rounded.stop[k]),
            float(rounded.length[k]),
            rounded.at[own],
            rounded.window[own],
            rounded.corner[own],
        )


def node_ends(chain: NodeChain, begin: int, stop: int) -> Array:
    """Return the start configurations of nodes ``range(begin, stop)``, and the end of the last one."""
    ends = chain.waypoints[chain.first[begin + 1 : stop + 1] - 1]
    return np.vstack([chain.stands_at(begin)[None], ends])


def _full_speed_times(
    pace: Pace, chain: NodeChain, begin: int, stop: int, bends: list[Bend]
) -> Array:
    """Return the time at full speed of each node of a stretch with bends [s].

    How fast a bend is passed on its legs, compared to each other, is part of its form. Where limits
    are others than those that it was rounded for, some legs are not as fast as they could be.
    """
    ends = node_ends(chain, begin, stop)
    length = np.linalg.norm(np.diff(ends, axis=0), axis=1)
    cruise = np.zeros(stop - begin)
    unit, leave, done = 1.0, 0.0, 0
    for bend in bends:
        a, b = bend.begin - begin, bend.stop - begin
        speed = bend.velocity(ends[a], ends[b])
        enter = float(np.linalg.norm(speed[0]))
        # On the way from one bend to the next the robot is as fast as on both their legs.
        unit = 1.0 if done == 0 else enter / leave
        cruise[done:a] = length[done:a] / (enter / unit)
        chords = np.diff(chain.first[bend.begin : bend.stop + 1])
        cruise[a:b] = bend.length * unit * chords / chords.sum()
        leave, done = float(np.linalg.norm(speed[-1])) / unit, b
    cruise[done:] = length[done:] / leave
    path = blended_path(chain, begin, stop, cruise)
    legs = zip(path.points, np.diff(path.points, axis=0), strict=False)
    least = [pace.full_speed_seconds(begin, *leg) for leg in legs]
    return cruise * np.max(np.array(least) / np.diff(path.at))

"""Pieces of timelines, each of which becomes a node of a temporal plan graph.

Time has one grid for all robots. A piece is a straight motion within one cell of it, a stand of
any length, or a stretch of a skill, which counts for the whole time of the skill. If no two
pieces of different robots that share any time come too close, each anywhere on its own, then
the nodes made of them keep every guarantee of the graph: conflicts are left only between nodes
one of which ends before the other starts.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.construction.world.timeline import SAME, RobotTimeline
from planning.transforms import Array

STEP = 0.1
"""Length of the cells of time, and of pose nodes [s]."""


class Pieces(NamedTuple):
    """The motion of one robot from some time on, in order.

    Attributes:
        start, end: the time for which a piece counts, shape (p,) [s]; the last one may never
            end.
        q_a, q_b: ends of its straight motion, shape (p, n).
        whole: True where it counts as a whole all the time, False where the robot is at a
            definite place at each time, shape (p,).
        moment: when it begins to be carried out, shape (p,) [s]; ``start`` but in skills.
    """

    start: Array
    end: Array
    q_a: Array
    q_b: Array
    whole: npt.NDArray[np.bool_]
    moment: Array

    def later(self, k: int) -> Pieces:
        """Return all but the first ``k``."""
        return Pieces._make(values[k:] for values in self)


def cut_timeline(
    line: RobotTimeline,
    start: float,
    until: float,
    step: float,
    changes: Sequence[float] = (),
    cuts: Sequence[float] = (),
) -> Pieces:
    """Return the pieces of a timeline.

    Args:
        line: the timeline.
        start: pieces that end before are left out [s].
        until: the robot is there up to this time, infinity for ever [s].
        step: cells of time begin at its multiples [s].
        changes: times at which pieces end even where the robot stands, such as those at which
            objects change hands.
        cuts: more times at which motions are cut.
    """
    inside = [span for span in line.skills if span[0] <= start < span[1]]
    begin = min([start, *(span[0] for span in inside)])
    last = min(line.end, until)
    skills = [s for s in line.skills if s[1] > begin and s[0] < until]
    given = np.concatenate([line.time, changes, cuts])
    times = _cut_times(begin, last, step, skills, given)
    q = np.stack([np.interp(times, line.time, column) for column in line.path.T], 1)
    if until > last + SAME:
        # It stands from the end of its timeline on.
        later = sorted(c for c in changes if last + SAME < c < until)
        times = np.concatenate([times, later, [until]])
        q = np.vstack([q, np.tile(q[-1], (len(later) + 1, 1))])
    t_a, t_b = times[:-1].copy(), times[1:].copy()
    whole = np.zeros(len(t_a), dtype=np.bool_)
    for a, b in skills:
        whole |= (t_a >= a - SAME) & (t_b <= b + SAME)
    q_a, q_b = q[:-1], q[1:]
    moves = np.any(q_a != q_b, axis=1) | whole
    # Stands that follow each other are one stand, unless something changes in the hand.
    joined = np.zeros(len(t_a), dtype=np.bool_)
    joined[1:] = ~moves[1:] & ~moves[:-1]
    if len(changes):
        nearest = np.searchsorted(np.sort(changes), t_a - SAME)
        bounds = np.append(np.sort(changes), np.inf)
        joined &= bounds[nearest] > t_a + SAME
    first = np.flatnonzero(~joined)
    stop = np.append(first[1:], len(t_a)) - 1
    moment = t_a[first]
    t_a, t_b = t_a[first], t_b[stop]
    whole = whole[first]
    for a, b in skills:
        own = whole & (t_a >= a - SAME) & (t_b <= b + SAME)
        t_a[own], t_b[own] = a, b
    return Pieces(
        t_a,
        t_b,
        np.ascontiguousarray(q_a[first]),
        np.ascontiguousarray(q_b[stop]),
        whole,
        moment,
    )


def _cut_times(
    begin: float,
    last: float,
    step: float,
    skills: Sequence[tuple[float, float]],
    given: Array,
) -> Array:
    """Return the times at which pieces begin and end: of the grid, of skills, and given ones.

    The grid does not cut skills.
    """
    grid = np.arange(np.ceil(begin / step), np.floor(last / step) + 1) * step
    for a, b in skills:
        grid = grid[(grid <= a + SAME) | (grid >= b - SAME)]
    ends = [t for span in skills for t in span]
    times = np.concatenate([[begin], grid, given, ends, [last]])
    times = np.unique(times[(times >= begin) & (times <= max(last, begin))])
    return np.asarray(times[np.concatenate([[True], np.diff(times) > SAME])])

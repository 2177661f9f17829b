"""Work arrays for collision checks of a robot, shared by all scenes that a thread checks."""

from __future__ import annotations

from threading import local
from typing import NamedTuple

from planning.caches import BoundedCache
from planning.geometry.hull_table import HullTable
from planning.geometry.separation import Scratch, make_scratch_for
from planning.geometry.swept import SweptBodies, make_swept

_MOST = 500
"""Number of robots, each with what it holds, whose arrays are kept."""

_OF_THREAD = local()


class WorkArrays(NamedTuple):
    """Work arrays for the bodies of a robot.

    Attributes:
        bodies: the bodies.
        own: the bodies on a stretch of motion.
        above: the same, relative to a joint.
        on_itself: to compare the bodies with each other.
    """

    bodies: HullTable
    own: SweptBodies
    above: HullTable
    on_itself: Scratch


def work_arrays(bodies: HullTable) -> WorkArrays:
    """Return the work arrays of this thread for the bodies of a robot."""
    known: BoundedCache[WorkArrays] | None = getattr(_OF_THREAD, "known", None)
    if known is None:
        known = _OF_THREAD.known = BoundedCache(_MOST)
    return known.get(id(bodies), lambda: _make(bodies))


def _make(bodies: HullTable) -> WorkArrays:
    own = make_swept(bodies)
    n, corners = bodies.q_a.shape[1], bodies.most_corners
    return WorkArrays(
        bodies,
        own,
        own.hulls.on_a_motion().seen_from_base(),
        make_scratch_for(n, n, corners, corners),
    )

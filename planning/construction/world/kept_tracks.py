"""Cache of the swept tracks of fixed timelines."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence

import numpy as np

from planning.cell.workcell import CellObject, PlacedRobot
from planning.construction.world.hands import HandChange
from planning.construction.world.motion_pieces import STEP, cut_timeline
from planning.construction.world.swept_track import SweptTrack, sweep_track
from planning.construction.world.timeline import RobotTimeline

_KEPT = 64
"""Number of cached timelines: a few of each robot of the largest teams."""

_Key = tuple[RobotTimeline, tuple[HandChange, ...]]


class SweptTracks:
    """Keeps the swept tracks of the timelines that were used last.

    While one robot is planned nobody else's timeline changes, and half a dozen checkers are made.
    """

    def __init__(self) -> None:
        self._kept: OrderedDict[_Key, tuple[float, SweptTrack]] = OrderedDict()

    def since(
        self,
        start: float,
        robot: PlacedRobot,
        line: RobotTimeline,
        changes: Sequence[HandChange],
        item: Callable[[str], CellObject],
    ) -> SweptTrack:
        """Return the swept track of a robot from the cell of time on that ``start`` is in.

        Args:
            start: [s].
            robot: who moves.
            line: how.
            changes: what it holds from when on.
            item: returns an object by its name.
        """
        key = (line, tuple(changes))
        known = self._kept.get(key)
        if known is None or known[0] > start:
            first = float(np.floor(start / STEP) * STEP)
            times = [t for t, _ in changes[1:]]
            pieces = cut_timeline(line, first, np.inf, STEP, times)
            known = first, sweep_track(robot, pieces, changes, item)
            self._kept[key] = known
            if len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        return known[1].since(start)

"""What robots on fixed timelines sweep, kept from check to check."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence

import numpy as np

from planning.cell.workcell import CellObject, PlacedRobot
from planning.construction.world.hands import HandChange
from planning.construction.world.motion_pieces import cut_timeline
from planning.construction.world.swept_track import SweptTrack, sweep_track
from planning.construction.world.timeline import RobotTimeline

_KEPT = 64
"""How many timelines are remembered: a few of each robot of the largest teams."""

_Key = tuple[int, float, tuple[HandChange, ...]]


class SweptTracks:
    """Remembers what was swept on the timelines that were asked for last.

    While one robot is planned nobody else's timeline changes, and half a dozen checkers are made.
    """

    def __init__(self) -> None:
        # A timeline is kept so that its id is not given to another one.
        self._kept: OrderedDict[_Key, tuple[RobotTimeline, float, SweptTrack]] = (
            OrderedDict()
        )

    def since(
        self,
        start: float,
        robot: PlacedRobot,
        line: RobotTimeline,
        changes: Sequence[HandChange],
        item: Callable[[str], CellObject],
        step: float,
    ) -> SweptTrack:
        """Return what a robot sweeps from the cell of time on that ``start`` is in, for ever.

        Args:
            start: [s].
            robot: who moves.
            line: how.
            changes: what it holds from when on.
            item: returns an object by its name.
            step: cells of time begin at its multiples [s].
        """
        key = (id(line), step, tuple(changes))
        known = self._kept.get(key)
        if known is None or known[1] > start:
            first = float(np.floor(start / step) * step)
            times = [t for t, _ in changes[1:]]
            pieces = cut_timeline(line, first, np.inf, step, times)
            known = line, first, sweep_track(robot, pieces, changes, item)
            self._kept[key] = known
            if len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        return known[2].since(start)

"""What a robot holds must be at its tool."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planning.transforms import Transform
from twin.audit.motion.executed import ObjectRow
from twin.audit.motion.sampling import Stretch
from twin.audit.tools import Hand, hand_of
from twin.audit.violation import Violation
from twin.audit.wanted import Wanted
from twin.audit.worlds.world import FAR, AuditWorld, Shape

GRIP = 0.005
"""What is held may be this far away from the closed tool of its holder [m]."""


_PLAY = 1e-4
"""A box may be wider than its fingers open by this: rounding of files [m]."""


class GripWatch:
    """Measures once for every hold, when it begins: from then on tool and object move as one.

    Fingers that stand open in the geometry of a tool close by half of what is left of their
    opening beside the thinnest edge of the object.

    Args:
        world: to measure in.
        wanted: how far fingers stand open.
    """

    def __init__(self, world: AuditWorld, wanted: Wanted) -> None:
        self._world, self._wanted = world, wanted
        self._known: dict[str, ObjectRow] = {}
        self._open: dict[str, Violation] = {}
        self._found: list[Violation] = []

    def look(self, stretch: Stretch) -> None:
        """Check what has come into a hand at the start of a stretch."""
        t = float(stretch.t[0])
        tools = {tool.name for tool in self._wanted.tools}
        for name, row in stretch.placements.items():
            if self._known.get(name) is row:
                continue
            self._known[name] = row
            if name in self._open:
                self._found.append(replace(self._open.pop(name), t_end=t))
            if row.holder is not None and name not in tools:
                self._measure(stretch, name, row.holder)
        self._last = float(stretch.t[-1])

    def violations(self) -> list[Violation]:
        """Return the holds that do not fit, from when to when."""
        self._found += [replace(v, t_end=self._last) for v in self._open.values()]
        self._open = {}
        return self._found

    def _measure(self, stretch: Stretch, name: str, holder: str) -> None:
        tracks = [k for k in stretch.moving if k.shape.entity == name]
        arm = tracks[0].holder
        assert arm is not None
        q, rows = stretch.robots[arm].q[0], stretch.placements
        hand = hand_of(self._world, arm, q, rows, self._wanted)
        for track in tracks:
            self._world.place(track.shape, track.pose(0))
        gap, tool = min(
            (self._world.distance(shape, track.shape, FAR), shape.detail)
            for shape in hand.shapes
            for track in tracks
        )
        grip, opening = hand.grip, hand.opening(self._wanted.opening_m)
        closing = max(finger_travel(track.shape, opening) for track in tracks)
        t = float(stretch.t[0])
        if grip is not None and grip.opening is not None:
            width = self._width(name, hand, stretch.placements[name].pose)
            if width is not None and width > opening + _PLAY:
                detail = (
                    f"is {width * 1e3:.2f} mm wide between the fingers of {grip.tool}, which open to"
                    f" {opening * 1e3:.2f} mm"
                )
                self._open[name] = Violation(
                    t, t, name, holder, width - opening, detail, "grip"
                )
                return
        if gap > GRIP + closing:
            detail = f"is held {gap * 1e3:.2f} mm away from {tool}"
            detail += f", which closes by {closing * 1e3:.2f} mm" if closing else ""
            self._open[name] = Violation(t, t, name, holder, gap, detail, "grip")

    def _width(self, name: str, hand: Hand, held: Transform) -> float | None:
        """Return how wide a box is along the axis in which fingers close [m].

        None where that cannot be told: of what is no box, fingers may grip any part.
        """
        item, tool = self._world.cell.object(name), hand.frames.get("tool")
        if tool is None or not item.shape.is_box:
            return None
        return float(np.abs(held[:3, :3].T @ tool[:3, 1]) @ item.size)


def finger_travel(shape: Shape, opening: float) -> float:
    """Return how far each finger closes on the thinnest edge of a shape at most [m]."""
    return max(0.0, 0.5 * (opening - 2.0 * float(np.min(shape.half))))

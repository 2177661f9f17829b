"""How the nodes of a robot, and the corners of its path, are passed within its limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import numpy.typing as npt

from planning.transforms import Array, Indices
from scheduling.graph.columns import SECONDS, Column

BY_JOINTS, BY_TOOL_SPEED, BY_EFFORT = 0, 1, 2
"""What sets the times of a node: speed, acceleration and jerk of joints; the speed of the tool; or,
from ``BY_EFFORT`` on, the effort of the joint that is counted on from there. Below zero, counted down
from -1, is a joint whose effort does not bear the weight, however slow it is."""


@dataclass(frozen=True, eq=False)
class Drive:
    """Times in which the nodes of a chain can be passed, one entry a node.

    Consecutive pose nodes on a straight line in joint space, and around rounded corners of it, are a
    *stretch*: the robot passes the borders between them at speed, and is at rest at both ends of it.
    Skill nodes, and nodes that do not move, begin and end at rest.

    Attributes:
        cruise: time at full speed; of a skill, its least duration [s].
        ramp: time from rest to full speed, longer around rounded corners; 0 for what is no part of
            a stretch [s].
        lag: by how much the executed motion is behind the commanded one, the same for all nodes of
            a stretch; 0 for what is no part of one [s].
        rests: whether the robot is at rest at the end of the node.
        slowed: how many times as long its stretch or skill takes as by the limits of speed,
            acceleration and jerk of joints.
        slowed_by: what asks for that: ``BY_JOINTS``, ``BY_TOOL_SPEED``, or a joint's effort.
        cap: greatest share of full speed at which the node may be passed; 1 but around rounded
            corners.
    """

    cruise: Annotated[Array, SECONDS]
    ramp: Annotated[Array, SECONDS]
    lag: Annotated[Array, SECONDS]
    rests: Annotated[npt.NDArray[np.bool_], Column(("nodes",), np.bool_)]
    slowed: Annotated[Array, SECONDS]
    slowed_by: Annotated[Indices, Column(("nodes",), np.int64)]
    cap: Annotated[Array, Column(("nodes",), least=0.0, most=1.0)]

    @property
    def least(self) -> Array:
        """Least duration of each node [s]."""
        return self.cruise / self.cap

    def cut(self, nodes: slice) -> Drive:
        """Return the entries of some nodes; they end at rest."""
        own = {name: values[nodes] for name, values in vars(self).items()}
        own["rests"] = own["rests"].copy()
        own["rests"][-1:] = True
        return Drive(**own)

    def repeated(self, times: int) -> Drive:
        """Return the entries again and again."""
        return joined_drives([self] * times)


def joined_drives(parts: Sequence[Drive]) -> Drive:
    """Return the entries of some nodes, and then those of others."""
    columns = zip(*(vars(part).values() for part in parts), strict=True)
    return Drive(*map(np.concatenate, columns))


@dataclass(frozen=True, eq=False)
class RoundedCorners:
    """Corners of a chain that are rounded, in order, in *bends*: those of a bend share its curve.

    The pose nodes of a bend are a curve from one straight way to another, see
    ``planning.timing.rounded_path``; their waypoints are on it, so close that chords are as good, and equal
    times apart. It begins where the first node does and ends where the last one does.

    Attributes:
        begin: first node of each bend, shape (b,).
        stop: the node after the last one of each bend, shape (b,).
        length: time of each bend at full speed, in a unit of its own, shape (b,).
        bend: the bend that each corner is part of, shape (k,).
        at: way of each corner since its bend began, in that unit, shape (k,).
        window: over which it is rounded, in that unit, shape (k,).
        corner: where straight ways would meet, shape (k, n).
    """

    begin: Annotated[Indices, Column(("bends",), np.int64)]
    stop: Annotated[Indices, Column(("bends",), np.int64)]
    length: Annotated[Array, Column(("bends",))]
    bend: Annotated[Indices, Column(("corners",), np.int64)]
    at: Annotated[Array, Column(("corners",))]
    window: Annotated[Array, Column(("corners",))]
    corner: Annotated[Array, Column(("corners", "joints"))]

    def inside(self, first: int, stop: int) -> RoundedCorners | None:
        """Return those among nodes ``range(first, stop)``, numbered from ``first``; None for none."""
        own = np.flatnonzero((self.begin >= first) & (self.stop <= stop))
        return self._picked(own, -first)

    def outside(self, first: int, stop: int) -> RoundedCorners | None:
        """Return those of which no node is among nodes ``range(first, stop)``; None for none."""
        return self._picked(
            np.flatnonzero((self.begin >= stop) | (self.stop <= first)), 0
        )

    def repeated(self, times: int, nodes: int) -> RoundedCorners:
        """Return the corners of a chain of some nodes that comes again and again."""
        every = np.tile(np.arange(len(self.begin)), times)
        whole = self._picked(every, 0)
        assert whole is not None
        shift = np.repeat(np.arange(times) * nodes, len(self.begin))
        return RoundedCorners(
            whole.begin + shift, whole.stop + shift, *list(vars(whole).values())[2:]
        )

    def _picked(self, own: Indices, shift: int) -> RoundedCorners | None:
        """Return some bends with their corners, their nodes numbered anew."""
        if not len(own):
            return None
        corners = [np.flatnonzero(self.bend == k) for k in own]
        rows = np.concatenate(corners)
        return RoundedCorners(
            self.begin[own] + shift,
            self.stop[own] + shift,
            self.length[own],
            np.repeat(np.arange(len(own)), [len(part) for part in corners]),
            self.at[rows],
            self.window[rows],
            self.corner[rows],
        )


def joined_corners(
    a: RoundedCorners | None, b: RoundedCorners | None, shift: int
) -> RoundedCorners | None:
    """Return the corners of a chain in order.

    Args:
        a: some of its corners.
        b: others, whose nodes are numbered from ``shift``.
        shift: a node.
    """
    parts = []
    for part, by in ((a, 0), (b, shift)):
        if part is not None:
            own = np.arange(len(part.begin))
            moved = part._picked(own, by)
            assert moved is not None
            parts.append(moved)
    if not parts:
        return None
    counts = [0, *(len(part.begin) for part in parts)]
    whole = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in vars(parts[0])
    }
    bends = [part.bend + counts[k] for k, part in enumerate(parts)]
    joined = RoundedCorners(**whole | {"bend": np.concatenate(bends)})
    return joined._picked(np.argsort(joined.begin), 0)

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
        return joined_corners((self._picked(own), -first))

    def outside(self, first: int, stop: int) -> RoundedCorners | None:
        """Return those of which no node is among nodes ``range(first, stop)``; None for none."""
        own = np.flatnonzero((self.begin >= stop) | (self.stop <= first))
        return joined_corners((self._picked(own), 0))

    def repeated(self, times: int, nodes: int) -> RoundedCorners | None:
        """Return the corners of a chain of some nodes that comes again and again."""
        return joined_corners(*((self, k * nodes) for k in range(times)))

    def _picked(self, own: Indices) -> RoundedCorners:
        """Return some bends with their corners."""
        corners = [np.flatnonzero(self.bend == k) for k in own]
        rows = np.concatenate([*corners, np.empty(0, dtype=np.int64)])
        counts = [len(part) for part in corners]
        return RoundedCorners(
            self.begin[own],
            self.stop[own],
            self.length[own],
            np.repeat(np.arange(len(own)), counts),
            self.at[rows],
            self.window[rows],
            self.corner[rows],
        )


def joined_corners(
    *parts: tuple[RoundedCorners | None, int],
) -> RoundedCorners | None:
    """Return the corners of a chain in order, None for none.

    Args:
        parts: some of its corners, and the node from which their nodes are numbered.
    """
    some = [(part, by) for part, by in parts if part is not None and len(part.begin)]
    if not some:
        return None
    bends = np.cumsum([0, *(len(part.begin) for part, _ in some)])
    moved = [
        vars(part)
        | {"begin": part.begin + by, "stop": part.stop + by, "bend": part.bend + first}
        for (part, by), first in zip(some, bends, strict=False)
    ]
    joined = RoundedCorners(
        **{name: np.concatenate([own[name] for own in moved]) for name in moved[0]}
    )
    return joined._picked(np.argsort(joined.begin))

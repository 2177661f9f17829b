"""Swept volumes of the planned motions of robots, which are obstacles for other robots."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from planning.cell.workcell import Attachment, CellObject, PlacedRobot
from planning.construction.world.fleet import (
    LoadedRobot,
    RobotFleet,
    bodies_of,
    make_fleet,
    make_loaded_robot,
)
from planning.construction.world.timeline import HandChange, MotionPieces, decode_pose
from planning.geometry.swept import (
    SweepRoom,
    Sweeps,
    empty_sweeps,
    make_sweep_room,
    sweep_piece,
)
from planning.kernels import inner_kernel, kernel
from planning.packed import packed
from planning.transforms import Array, Indices


class SweptTrack(NamedTuple):
    """The pieces of one robot's motion, and the swept volume of each.

    Attributes:
        pieces: in order.
        carriers: the robot with each of the things that it holds at some time.
        hand: which of them it is, shape (p,).
        sweeps: its swept volumes.
    """

    pieces: MotionPieces
    carriers: tuple[LoadedRobot, ...]
    hand: Indices
    sweeps: Sweeps

    def since(self, t: float) -> SweptTrack:
        """Return the pieces that end after a time [s]."""
        k = int(np.searchsorted(self.pieces.end, t, side="right"))
        s = self.sweeps
        b, c = s.body_first[k], s.capsule_first[k]
        return SweptTrack(
            self.pieces.later(k),
            self.carriers,
            self.hand[k:],
            Sweeps(
                s.box[k:],
                s.body_first[k:] - b,
                s.body_box[b:],
                s.capsule_first[k:] - c,
                s.capsule_a[c:],
                s.capsule_b[c:],
                s.radius[c:],
            ),
        )


def sweep_track(
    robot: PlacedRobot,
    pieces: MotionPieces,
    changes: Sequence[HandChange],
    item: Callable[[str], CellObject],
) -> SweptTrack:
    """Sweep all pieces of a robot.

    Args:
        robot: the moving robot.
        pieces: how.
        changes: the objects it holds from each time on; pieces end there.
        item: returns an object by its name.
    """
    times = np.array([t for t, _ in changes])
    at = np.searchsorted(times, pieces.moment + 1e-9, side="right") - 1
    used, hand = np.unique(at, return_inverse=True)
    carriers = [
        make_loaded_robot(
            robot,
            [(item(n), Attachment(robot.name, decode_pose(pose))) for n, pose in held],
        )
        for held in (changes[k][1] for k in used.tolist())
    ]
    bodies = np.array([len(c.hulls.joint) for c in carriers])[hand]
    capsules = np.array([len(c.hulls.radius) for c in carriers])[hand]
    sweeps = empty_sweeps(bodies, capsules)
    hand = hand.astype(np.int64)
    q_a, q_b = pieces.q_a, pieces.q_b
    room = make_sweep_room(q_a.shape[1], int(capsules.max(initial=0)))
    _sweep_pieces(make_fleet(carriers), q_a, q_b, hand, packed(sweeps), room)
    return SweptTrack(pieces, tuple(carriers), hand, sweeps)


@kernel
def _sweep_pieces(
    fleet: RobotFleet,
    q_a: Array,
    q_b: Array,
    hand: Indices,
    sweeps: Sweeps,
    room: SweepRoom,
) -> None:
    for p in range(len(hand)):
        sweep_piece(bodies_of(fleet, hand[p]), q_a[p], q_b[p], p, sweeps, room)


class Tracks(NamedTuple):
    """The pieces of many robots' motions.

    Attributes:
        first: pieces of track r are ``range(first[r], first[r + 1])``.
        pieces: of all tracks; configurations are padded to the most joints.
        carrier: which carrier of the fleet a piece is, shape (p,).
        sweeps: what pieces sweep.
    """

    first: Indices
    pieces: MotionPieces
    carrier: Indices
    sweeps: Sweeps


def build_tracks(swept: Sequence[SweptTrack], carriers: int) -> Tracks:
    """Concatenate the swept tracks of robots.

    Args:
        swept: of each robot.
        carriers: how many carriers come before those of the tracks in the fleet.
    """
    counts = np.array([len(s.hand) for s in swept], dtype=np.int64)
    first = np.cumsum([0, *counts])
    hands = carriers + np.cumsum([0, *(len(s.carriers) for s in swept)])
    most = max((s.pieces.q_a.shape[1] for s in swept), default=0)
    none, still = np.empty(0), np.empty((0, most))
    pieces = [MotionPieces(none, none, still, still, none.astype(np.bool_), none)]
    pieces += [_padded(s.pieces, most) for s in swept]
    sweeps = [empty_sweeps(first[:0], first[:0]), *(s.sweeps for s in swept)]
    joined = Sweeps._make(map(np.concatenate, zip(*sweeps, strict=True)))
    tracks = Tracks(
        first,
        packed(MotionPieces._make(map(np.concatenate, zip(*pieces, strict=True)))),
        np.repeat(hands[:-1], counts)
        + np.concatenate([first[:0], *(s.hand for s in swept)]),
        packed(
            joined._replace(
                body_first=_joined([s.body_first for s in sweeps]),
                capsule_first=_joined([s.capsule_first for s in sweeps]),
            )
        ),
    )
    return packed(tracks)


def _padded(pieces: MotionPieces, joints: int) -> MotionPieces:
    """Return pieces with configurations padded with zeros to a number of joints."""
    if pieces.q_a.shape[1] == joints:
        return pieces
    wider = ((0, 0), (0, joints - pieces.q_a.shape[1]))
    return pieces._replace(q_a=np.pad(pieces.q_a, wider), q_b=np.pad(pieces.q_b, wider))


def _joined(firsts: Sequence[Indices]) -> Indices:
    """Return the first row of each piece when the rows of all robots are concatenated."""
    counts = [np.diff(first) for first in firsts]
    return np.cumsum(np.concatenate([[0], *counts])).astype(np.int64)


@inner_kernel
def pieces_at(
    start: Array, end: Array, first: int, last: int, lo: float, hi: float
) -> tuple[int, int]:
    """Return the index range of the pieces ``range(first, last)`` that overlap a time span.

    Args:
        start, end: the time for which each piece counts, shape (p,) [s].
        first, last: the pieces of one track.
        lo, hi: the span; equal for one instant [s].
    """
    eps = 1e-9
    p = first + np.searchsorted(end[first:last], lo + eps, side="right")
    q = max(first + np.searchsorted(start[first:last], hi - eps), p)
    if q == p and hi - lo < eps and p < last and start[p] <= lo + eps:
        q = p + 1
    return int(p), int(q)

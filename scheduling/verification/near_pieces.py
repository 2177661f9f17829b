"""Pairs of pieces that may happen at once and come close: candidates for measuring."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from planning.transforms import Array, Indices
from scheduling.verification.ancestors import Precedence
from scheduling.verification.bodies import Body, Pieces, RobotBodies
from scheduling.verification.object_places import Resting
from scheduling.verification.reference import TOLERANCE, measure

_BLOCK = 48


def over_before(a: RobotBodies, b: RobotBodies, precedence: Precedence) -> Indices:
    """Return, per piece of b, how many first nodes of a are complete before it may begin."""
    begin = b.pieces.begin
    if a.chain is None or b.chain is None:
        return np.zeros(len(begin), dtype=np.int64)
    known = precedence.complete[a.chain][b.chain]
    return np.where(begin >= 0, known[np.maximum(begin, 0)], 0)


def close_pairs(
    pieces_a: Pieces,
    x: Body,
    pieces_b: Pieces,
    y: Body,
    past_a: Indices,
    past_b: Indices,
    limit: float,
) -> Iterator[tuple[Indices, Indices]]:
    """Yield pairs of pieces that may happen at once and in which two spheres come close.

    They come in groups, as positions in ``x.pieces`` and in ``y.pieces``.
    """
    end_a, end_b = pieces_a.end[x.pieces], pieces_b.end[y.pieces]
    past_a, past_b = past_a[y.pieces], past_b[x.pieces]
    for k in range(0, len(x.pieces), _BLOCK):
        block = slice(k, k + _BLOCK)
        j0 = int(np.searchsorted(end_b, past_b[block].min()))
        j1 = int(np.searchsorted(past_a, end_a[block].max(), side="right"))
        if j0 >= j1:
            continue
        centre, radius = x.centre[block], x.radius[block]
        low, high = centre.min(axis=0), centre.max(axis=0)
        others = y.centre[j0:j1]
        room = y.radius[j0:j1] + (float(radius.max()) + limit)
        gap = np.maximum(np.maximum(low - others, others - high), 0.0)
        near = np.flatnonzero(np.einsum("ij,ij->i", gap, gap) < room * room)
        if not len(near):
            continue
        others, room = others[near], y.radius[j0:j1][near]
        step = centre[:, None] - others[None]
        reach = radius[:, None] + room[None] + limit
        hit = np.einsum("ijk,ijk->ij", step, step) < reach * reach
        hit &= end_a[block][:, None] >= past_a[j0:j1][near][None]
        hit &= end_b[j0:j1][near][None] >= past_b[block][:, None]
        rows, columns = np.nonzero(hit)
        if len(rows):
            yield k + rows, j0 + near[columns]


def unsettled(
    a: RobotBodies,
    x: Body,
    b: RobotBodies,
    y: Body,
    close: tuple[Indices, Indices],
    limit: float,
) -> Iterator[tuple[int, int]]:
    """Yield the pairs of pieces that one measurement for many of them does not settle.

    What is measured in the middle of two pieces holds for others as well, less what both parts
    are displaced from there to the middle of the others, and move within them.
    """
    rows, columns = close
    while len(rows):
        k = len(rows) // 2
        row, column = int(rows[k]), int(columns[k])
        i, j = int(x.pieces[row]), int(y.pieces[column])
        gap = measure(
            x.part,
            a.frames[i, x.part.joint + 1],
            y.part,
            b.frames[j, y.part.joint + 1],
        )
        left = gap - _displaced(x, row, rows) - _displaced(y, column, columns)
        unsettled = left < limit - TOLERANCE
        if unsettled[k]:
            unsettled[k] = False
            yield i, j
        rows, columns = rows[unsettled], columns[unsettled]


def _displaced(body: Body, start: int, others: Indices) -> Array:
    """Return how far any point of a body gets from one piece's middle in other pieces [m]."""
    low = min(int(others.min()), start)
    span = slice(low, max(int(others.max()), start) + 1)
    turned = body.turn[span] - body.turn[start]
    shift = body.centre[span] - body.centre[start]
    angle = np.sqrt(np.einsum("ij,ij->i", turned, turned) / 2.0)
    moved = np.sqrt(np.einsum("ij,ij->i", shift, shift))
    within = body.radius[span] - body.part.radius
    return np.asarray((moved + body.part.radius * angle + within)[others - low])


def while_there(
    robot: RobotBodies, rest: Resting, precedence: Precedence
) -> npt.NDArray[np.bool_]:
    """Return, per piece of a robot, whether it may happen while something is at rest."""
    pieces = robot.pieces
    out = np.ones(len(pieces), dtype=np.bool_)
    if robot.chain is None:
        return out
    if rest.put is not None:
        chain, node, waypoint = rest.put
        if chain == robot.chain:
            out &= pieces.until > pieces.moment(node, waypoint)
        else:
            out &= pieces.end >= precedence.complete[robot.chain][chain][node]
    if rest.taken is not None:
        chain, node, waypoint = rest.taken
        if chain == robot.chain:
            out &= pieces.since < pieces.moment(node, waypoint)
        else:
            known = precedence.complete[chain][robot.chain]
            done = np.where(pieces.begin >= 0, known[np.maximum(pieces.begin, 0)], 0)
            out &= done <= node
    return out

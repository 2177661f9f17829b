"""Problems that a verification found, and their wording."""

from __future__ import annotations

import math
from dataclasses import dataclass

from scheduling.verification.bodies import Pieces, RobotBodies
from scheduling.verification.reference import Part

Key = tuple[int, int, bool, bool]
"""Nodes of both sides, and whether each robot stands before its node."""


@dataclass(frozen=True)
class Moment:
    """One side of a problem.

    Attributes:
        robot: name of the robot, None for what rests in the world.
        node: the node, or the node before which the robot stands, -1 where there is none.
        task: its task, -1 where there is none.
        standing: True when the robot stands before the node.
        body: what comes close: ``"<robot>/arm"``, ``"<robot>/tool"``, object or fixture.
    """

    robot: str | None
    node: int
    task: int
    standing: bool
    body: str

    def __str__(self) -> str:
        """Describe it in one phrase."""
        if self.robot is None:
            return f"{self.body} at rest"
        if self.standing:
            return f"{self.body} of {self.robot!r} standing before node {self.node}"
        return f"{self.body} of {self.robot!r} in node {self.node} (task {self.task})"


@dataclass(frozen=True)
class Problem:
    """A violation of the guarantee.

    Attributes:
        kind: ``"cycle"``, ``"order"`` (an edge or a chain against the planned order),
            ``"dependency"``, ``"handling"``, ``"nodes"``, ``"hold"`` or ``"rest"``.
        message: one sentence.
        first, second: the two sides, None for a cycle.
        distance_m: distance measured where it was first seen, NaN where none was [m].
    """

    kind: str
    message: str
    first: Moment | None = None
    second: Moment | None = None
    distance_m: float = math.nan


def moment_of(robot: RobotBodies, part: Part, piece: int) -> Moment:
    """Return the side of a problem that a piece of a robot is."""
    pieces = robot.pieces
    standing = bool(pieces.standing[piece])
    return Moment(
        robot.name,
        int(pieces.node[piece]),
        int(pieces.tasks[piece, 1]),
        standing,
        part.entity,
    )


def conflict(first: Moment, second: Moment, distance: float, kind: str = "") -> Problem:
    """Return the problem of two sides that come too close."""
    standing = first.standing or second.standing
    how = (
        f"overlap by {-distance * 1e3:.2f} mm"
        if distance < 0
        else f"come within {distance * 1e3:.2f} mm"
    )
    return Problem(
        kind or ("hold" if standing else "nodes"),
        f"{first} and {second} {how}, and nothing keeps them apart",
        first,
        second,
        distance,
    )


def key_of(a: Pieces, i: int, b: Pieces, j: int) -> Key:
    """Return the key under which a pair of pieces is reported once."""
    return int(a.node[i]), int(b.node[j]), bool(a.standing[i]), bool(b.standing[j])


def without_repeats(seen: dict[Key, Problem]) -> list[Problem]:
    """Leave out stands next to a motion that is named already: it starts or ends with them."""
    out = []
    for (u, v, u_stands, v_stands), problem in sorted(seen.items(), key=lambda p: p[0]):
        moving = [(n, v, False, v_stands) for n in (u - 1, u) if u_stands]
        moving += [(u, n, u_stands, False) for n in (v - 1, v) if v_stands]
        if not any(key in seen for key in moving):
            out.append(problem)
    return out

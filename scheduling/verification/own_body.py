"""Robots that touch themselves, or touch with an arm what they carry."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from itertools import combinations

import numpy as np
import numpy.typing as npt

from planning.transforms import Array, Indices
from scheduling.verification.bodies import Motion, VerifiedRobot
from scheduling.verification.graph_structure import Moment, Problem
from scheduling.verification.measuring import Measuring
from scheduling.verification.reference import (
    ReferenceBody,
    ReferenceRobot,
    SeenFrom,
    measure,
)
from scheduling.verification.touching import SLACK


def touching_itself(
    robot: VerifiedRobot, reference: ReferenceRobot
) -> Iterator[Problem]:
    """Yield nodes in which parts of a robot touch each other, or what it carries.

    Parts of neighbouring joints touch by design, and those that overlap at HOME only do so because
    hulls are larger than what they contain. What is on the last joint moves with the load.

    Args:
        robot: its pieces, parts and loads.
        reference: its geometry.
    """
    eyes = [_Eyes(robot, reference, joint) for joint in range(-1, reference.dof)]
    parts = [body for body in robot.bodies if not body.load]
    loads = [body for body in robot.bodies if body.load]
    home = reference.joint_frames_along(robot.home[None])[0]
    everything = np.arange(len(robot.pieces))
    for first, second in combinations([body.motions[0].part for body in parts], 2):
        x, y = sorted((first, second), key=lambda part: part.joint)
        if y.joint - x.joint <= 1:
            continue
        if measure(x, home[x.joint + 1], y, home[y.joint + 1]) <= 0.0:
            continue
        yield from _in_pieces(robot, eyes[x.joint + 1], (x, y), everything)
    for body in loads:
        for k, motion in enumerate(body.motions):
            held = np.flatnonzero(body.which == k)
            for arm in parts:
                x = arm.motions[0].part
                if x.joint < motion.part.joint:
                    both = x, motion.part
                    yield from _in_pieces(robot, eyes[x.joint + 1], both, held)


class _Eyes:
    """All knots of a robot as one of its joints sees them, worked out when it is first asked for.

    Args:
        robot: its pieces.
        reference: its geometry.
        joint: index of the joint, -1 for the base.

    Attributes:
        view: the robot in its eyes.
        knots: of the pieces.
    """

    def __init__(
        self, robot: VerifiedRobot, reference: ReferenceRobot, joint: int
    ) -> None:
        self.view = SeenFrom(reference, joint)
        self.knots = robot.pieces.knots

    @cached_property
    def frames(self) -> Array:
        """Poses of base and joints at the knots, shape (s + 1, n + 1, 4, 4)."""
        return self.view.joint_frames_along(self.knots)

    def motion(self, part: ReferenceBody) -> Motion:
        """Return a part in all pieces."""
        frames = self.frames[:, part.joint + 1]
        return Motion(self.view, self.view.seen(part), self.knots, frames)


def _in_pieces(
    robot: VerifiedRobot,
    eyes: _Eyes,
    parts: tuple[ReferenceBody, ReferenceBody],
    pieces: Indices,
) -> Iterator[Problem]:
    """Yield the nodes among some pieces in which two parts touch, the inner one given first."""
    inner, outer = parts
    still = Motion(None, inner, np.zeros((2, 0)), np.tile(np.eye(4), (2, 1, 1)))
    moves = eyes.motion(outer)
    pieces = pieces[_balls_meet(inner, moves, pieces)]
    if not len(pieces):
        return
    low, high = moves.extents(pieces)
    least, most = still.extents(np.zeros(1, dtype=np.int64))
    near = np.all(np.maximum(low - most, least - high) < -SLACK, axis=0)
    left = pieces[near]
    number = 2 * robot.pieces.node[left] + robot.pieces.standing[left]
    found = Measuring().too_close(
        still, moves, (np.zeros_like(left), left), -SLACK, number
    )
    for k, distance in found:
        piece = int(left[k])
        node, task = int(robot.pieces.node[piece]), int(robot.pieces.tasks[piece, 1])
        stands = bool(robot.pieces.standing[piece])
        first, second = (
            Moment(robot.name, node, task, stands, part.entity) for part in parts
        )
        text = f"{first} overlaps {second.body} by {-distance * 1e3:.2f} mm"
        yield Problem("itself", text, first, second, distance)


def _balls_meet(
    inner: ReferenceBody, moves: Motion, pieces: Indices
) -> npt.NDArray[np.bool_]:
    """Tell in which pieces the balls around two parts may meet."""
    outer = moves.part
    frames = moves.frames[np.stack([pieces, pieces + 1])]
    centres = frames[..., :3, :3] @ outer.centre + frames[..., :3, 3]
    away = np.linalg.norm(centres - inner.centre, axis=2).min(axis=0)
    way = np.abs(moves.knots[pieces + 1] - moves.knots[pieces])
    room = inner.radius + outer.radius + 0.5 * way @ outer.weight
    return np.asarray(away < room)

"""Shapes on their way through a stretch of a run, and those that a robot moves, all at once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from planning.transforms import Array, Indices, Transform
from twin.audit.motion.reach import RobotSamples, motion_bounds
from twin.audit.worlds.world import JointAxes, Shape


@dataclass(frozen=True, eq=False)
class Track:
    """A shape during a stretch of m samples.

    Attributes:
        shape: the shape.
        holder: index of the robot that moves it, None for a box at rest.
        link: index of the link it moves with, 0 for the base.
        rotation: shape (m, 3, 3), or (1, 3, 3) at rest.
        centre: of the sphere and the box around it, shape (m, 3), or (1, 3) at rest [m].
        turn: rotation of the box around it, shaped as ``rotation``.
        reach: half edges of the upright box around that box, shaped as ``centre`` [m].
        moved: how far any point of it gets at most from sample to sample, as seen from the base
            and each moved link up to its own, shape (m - 1, link + 1); empty at rest [m].
        at: its pose, where it is at rest.
    """

    shape: Shape
    holder: int | None
    link: int
    rotation: Array
    centre: Array
    turn: Array
    reach: Array
    moved: Array
    at: Transform | None = None

    @property
    def steps(self) -> Array:
        """How far any point of it gets in the world, step by step, shape (m - 1,) [m]."""
        return np.asarray(self.moved[:, 0])

    def pose(self, sample: int) -> Transform:
        """Return its pose at a sample."""
        if self.at is not None:
            return self.at
        out = np.eye(4)
        out[:3, :3], out[:3, 3] = self.rotation[sample], self.centre[sample]
        return out


@dataclass(frozen=True)
class Carried:
    """All that one robot moves: its own shapes, then the objects that it holds.

    Attributes:
        robot: its index.
        shapes: s of them.
        links: that they move with, 0 for the base, shape (s,).
        poses: of the shapes in the frames of their links; None for the robot's own.
        centre: of the spheres and boxes around them, in those frames, shape (s, 3) [m].
        turn: rotations of the boxes, shape (s, 3, 3).
        half: half edges of the boxes, shape (s, 3) [m].
        radius: of the spheres, shape (s,) [m].
    """

    robot: int
    shapes: tuple[Shape, ...]
    links: Indices
    poses: tuple[Transform | None, ...]
    centre: Array
    turn: Array
    half: Array
    radius: Array

    def centres(self, samples: RobotSamples) -> Array:
        """Return where the centres are at m samples, shape (m, s, 3)."""
        turned = np.einsum("msij,sj->msi", samples.rotation[:, self.links], self.centre)
        return np.asarray(turned + samples.position[:, self.links])

    def tracks(
        self, samples: RobotSamples, centre: Array, moved: Array
    ) -> Iterator[Track]:
        """Yield the tracks of all shapes.

        Args:
            samples: m configurations of the robot.
            centre: see ``centres``.
            moved: see ``motion_bounds``.
        """
        turn = samples.rotation[:, self.links] @ self.turn
        reach = np.einsum("msij,sj->msi", np.abs(turn), self.half)
        for k, shape in enumerate(self.shapes):
            link, pose = int(self.links[k]), self.poses[k]
            rotation = samples.rotation[:, link]
            yield Track(
                shape,
                self.robot,
                link,
                rotation if pose is None else rotation @ pose[:3, :3],
                centre[:, k],
                turn[:, k],
                reach[:, k],
                moved[:, k, : link + 1],
            )


def carried(
    robot: int, own: Sequence[Shape], held: Sequence[tuple[Shape, Transform]], hand: int
) -> Carried:
    """Return what a robot moves.

    Args:
        robot: its index.
        own: its shapes.
        held: the objects that it holds, each with its pose in the frame of the hand.
        hand: index of the link that they move with.
    """
    loads = [(shape, hand, pose) for shape, pose in held]
    bodies = [*((s, s.joint + 1, None) for s in own), *loads]
    turns = [s.turn if p is None else p[:3, :3] @ s.turn for s, _, p in bodies]
    centres = [s.centre if p is None else p[:3, 3] for s, _, p in bodies]
    return Carried(
        robot,
        tuple(shape for shape, _, _ in bodies),
        np.array([link for _, link, _ in bodies], dtype=np.int64),
        tuple(pose for _, _, pose in bodies),
        np.array(centres).reshape(-1, 3),
        np.array(turns).reshape(-1, 3, 3),
        np.array([s.half for s, _, _ in bodies]).reshape(-1, 3),
        np.array([s.radius for s, _, _ in bodies]),
    )


@dataclass(frozen=True)
class Sampled:
    """All that one robot moves, at m samples.

    Attributes:
        what: the shapes.
        samples: configurations of the robot.
        centre: of the shapes, shape (m, s, 3) [m].
        bounds: of their motion, see ``motion_bounds``, shape (m - 1, s, n + 1) [m].
    """

    what: Carried
    samples: RobotSamples
    centre: Array
    bounds: Array

    @property
    def steps(self) -> Array:
        """How far any point of any shape gets, step by step, shape (m - 1,) [m]."""
        return np.asarray(self.bounds[:, :, 0].max(axis=1, initial=0.0))

    def tracks(self) -> list[Track]:
        """Return the tracks of all shapes."""
        return list(self.what.tracks(self.samples, self.centre, self.bounds))


def sampled(axes: JointAxes, what: Carried, samples: RobotSamples) -> Sampled:
    """Return what a robot moves at some samples, and how far it gets between them."""
    centre = what.centres(samples)
    bounds = motion_bounds(axes, samples, what.links, centre, what.radius)
    return Sampled(what, samples, centre, bounds)

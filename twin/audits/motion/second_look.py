"""Cross-check of the collision audit: PyBullet must find no overlap that the library coal did not find.

Only samples of the run are checked.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from twin.audits.motion.pairs import ClosePair
from twin.audits.motion.stretches import RunStretch

if TYPE_CHECKING:  # never called without PyBullet
    from twin.audits.worlds.bullet_world import BulletWorld

EVERY_M = 0.8
"""Approximate distance that some point of a robot or its load moves between two samples [m]."""


def sampled_overlaps(
    world: BulletWorld, stretch: RunStretch, pairs: Iterable[ClosePair]
) -> Iterator[tuple[ClosePair, int, float]]:
    """Yield overlaps of pairs of shapes at some samples of a stretch, including the first.

    Args:
        world: to measure in.
        stretch: where everything is.
        pairs: with the samples at which they may meet.

    Yields:
        The pair, the sample and the distance [m].
    """
    looks = np.concatenate([[0.0], np.cumsum(stretch.travel)]) // EVERY_M
    looked = np.append(0, np.flatnonzero(np.diff(looks)) + 1)
    due: dict[int, list[ClosePair]] = {}
    for pair in pairs:
        close = (pair.first <= looked[:, None]) & (looked[:, None] <= pair.last)
        for sample in looked[close.any(axis=1)].tolist():
            due.setdefault(sample, []).append(pair)
    if not due:
        return
    for shape, pose in stretch.resting:
        world.place(shape, pose)
    for sample in sorted(due):
        for robot, path in enumerate(stretch.paths):
            world.configure(robot, path[sample])
        for robot, shape, pose in stretch.held():
            world.place(shape, world.hand(robot) @ pose)
        shapes = [(pair.a, pair.b) for pair in due[sample]]
        for k, gap in world.overlaps(shapes):
            yield due[sample][k], sample, gap

"""Cross-check by PyBullet at samples of a run: it must find no overlap that coal has not."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from twin.audits.motion.pairs import Gap, WatchedPair
from twin.audits.motion.stretches import RunStretch

if TYPE_CHECKING:  # never called without PyBullet
    from twin.audits.worlds.bullet_world import BulletWorld

EVERY_M = 0.4
"""Travel of some point of a robot or its load between two samples, about [m]."""


def sampled_overlaps(
    world: BulletWorld, stretch: RunStretch, pairs: Iterable[WatchedPair]
) -> Iterator[Gap]:
    """Yield overlaps of pairs of shapes at some samples of a stretch, including the first.

    Args:
        world: to measure in.
        stretch: where everything is.
        pairs: with the samples at which they may meet.
    """
    moved = np.cumsum(stretch.movers.steps.max(axis=1, initial=0.0))
    looks = np.concatenate([[0.0], moved]) // EVERY_M
    looked = {0, *(np.flatnonzero(np.diff(looks)) + 1).tolist()}
    due: dict[int, list[WatchedPair]] = {}
    for pair in pairs:
        for sample in looked.intersection(pair.close):
            due.setdefault(sample, []).append(pair)
    if due:
        for track in stretch.boxes.tracks:
            assert track.pose is not None
            world.place(track.shape, track.pose)
    held = [track for track in stretch.movers.tracks if track.pose is not None]
    for sample in sorted(due):
        for k, robot in enumerate(stretch.robots):
            world.configure(k, robot.q[sample])
        for track in held:
            assert track.holder is not None
            assert track.pose is not None
            world.place(track.shape, world.hand(track.holder) @ track.pose)
        for k, distance in world.overlaps([pair.shapes for pair in due[sample]]):
            yield Gap(due[sample][k], sample, sample + 1, distance, distance)

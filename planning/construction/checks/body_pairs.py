"""Pairs of swept bodies, compiled: capsules propose, hulls decide."""

from __future__ import annotations

from planning.construction.checks.scene import Scene
from planning.construction.world.fleet import bodies_of, set_motion
from planning.construction.world.swept_track import Sweeps
from planning.geometry.distance import segment_segment
from planning.geometry.hull_table import HullTable
from planning.geometry.separation import (
    APART,
    Scratch,
    judge_hulls,
    pose_segments,
)
from planning.kernels import ZERO, inner_kernel
from planning.transforms import Array, Indices


@inner_kernel
def proved_apart(
    scratch: Scratch, a: HullTable, i: int, b: HullTable, j: int, limit: float
) -> bool:
    """Tell whether two bodies are proved to keep a distance, each anywhere on its motion.

    Args:
        scratch: room to work in.
        a, i: a carrier on its motion, and a body of it.
        b, j: another one, or the same.
        limit: the distance [m].
    """
    scratch.posed[0] = scratch.posed[1] = -1
    pose_segments(a, ZERO, b, ZERO, scratch)
    return bool(judge_hulls(a, i, b, j, limit, scratch) == APART)


@inner_kernel
def pairs_apart(
    scene: Scene, count: int, limits: Array, other: HullTable, columns: Indices
) -> bool:
    """Tell whether the first of a scene's pairs are proved to keep their distances.

    Args:
        scene: the scene, with the movers swept.
        count: of pairs: the number of an own body times that of bodies in ``other``, plus the
            number of one of these.
        limits: least distance of an own body, by column, shape (o, columns) [m].
        other: what they are looked at against, one segment of it.
        columns: of each body of ``other`` in ``limits``.
    """
    bodies, mover, pairs = scene.fleet.body_first, scene.mover, scene.pairs
    scratch, last = scene.scratch, -1
    scratch.posed[1] = -1
    for c in range(count):
        o, j = pairs[c] // len(columns), pairs[c] % len(columns)
        m = mover[o]
        own = bodies_of(scene.fleet, m)
        if m != last:
            first = scene.joint_first[m]
            set_motion(own, scene.q_a[first:], scene.q_b[first:])
            scratch.posed[0], last = -1, m
        pose_segments(own, ZERO, other, ZERO, scratch)
        limit = limits[o, columns[j]]
        if judge_hulls(own, o - bodies[m], other, j, limit, scratch) != APART:
            return False
    return True


@inner_kernel
def capsules_meet(
    a: Sweeps, first: int, last: int, b: Sweeps, low: int, high: int, limit: float
) -> bool:
    """Tell whether capsules ``range(first, last)`` come within a limit of ``range(low, high)``."""
    a_start, a_end, a_radius = a.capsule_a, a.capsule_b, a.radius
    b_start, b_end, b_radius = b.capsule_a, b.capsule_b, b.radius
    for c in range(first, last):
        for d in range(low, high):
            reach = a_radius[c] + b_radius[d] + limit
            gap = segment_segment(a_start[c], a_end[c], b_start[d], b_end[d])
            if gap <= reach * reach:
                return True
    return False

"""Continuous collision checks of motions in space-time, compiled."""

from __future__ import annotations

import numpy as np

from planning.construction.checks.moving_checks import (
    clear_of_tracks,
    moving_clear_until,
    worth_probing,
)
from planning.construction.checks.scene import Scene, own_at, sweep_between
from planning.construction.checks.still_checks import movers_clear, still_clear_until
from planning.kernels import inner_kernel, kernel
from planning.transforms import Array


@kernel
def clear_throughout(scene: Scene, q0: Array, q1: Array, lo: float, hi: float) -> bool:
    """Tell whether a straight motion is clear of everything, wherever it is in a span.

    Args:
        scene: the scene.
        q0, q1: ends of the motion, shape (n,).
        lo, hi: the span [s].
    """
    clear, _ = still_clear_until(scene, q0, lo, q1, hi, hi - lo)
    if not clear:
        return False
    size = scene.step / (1 << scene.halvings)
    begin = np.floor(lo / size + 1e-6) * size
    finish = np.ceil(hi / size - 1e-6) * size
    sweep_between(scene, q0, q1, lo, hi)
    return clear_of_tracks(scene, begin, finish) and (
        len(scene.begin) == 1 or movers_clear(scene, hi >= lo)
    )


@kernel
def configuration_clear(scene: Scene, q: Array, t: float) -> bool:
    """Tell whether the movers may be at ``q``, shape (n,), at one instant."""
    clear, _ = still_clear_until(scene, q, t, q, t, 0.0)
    # The movers have been swept, if such it may be called, and not cut up.
    return (
        clear
        and clear_of_tracks(scene, t, t)
        and (len(scene.begin) == 1 or movers_clear(scene, clear))
    )


@inner_kernel
def clear_until(
    scene: Scene, q0: Array, t0: float, q1: Array, t1: float
) -> tuple[bool, float]:
    """Tell whether a whole motion is clear, and until when it is.

    Each mover that is free to move by then goes straight, at constant speed.

    Args:
        scene: the scene.
        q0, t0: where it begins, and when, shape (n,).
        q1, t1: where it ends, and when.
    """
    begins = scene.begin
    a, b = np.empty_like(q0), np.empty_like(q1)
    a[:] = q0
    begin = t0
    while begin < t1:
        # A mover that becomes free within the motion appears there.
        end = t1
        for m in range(len(begins)):
            if begin + 1e-9 < begins[m] < end:
                end = begins[m]
        own_at(scene, q0, t0, q1, t1, end, b)
        clear, until = still_clear_until(scene, a, begin, b, end, 0.0)
        if not clear:
            if until <= begin:
                return False, begin
            own_at(scene, q0, t0, q1, t1, until, b)
        moving, first = moving_clear_until(scene, a, begin, b, until)
        if not moving:
            return False, first
        if not clear:
            return False, until
        a[:] = b
        begin = end
    return True, t1


@kernel
def motion_clear(scene: Scene, q0: Array, t0: float, q1: Array, t1: float) -> bool:
    """Tell whether a whole motion is clear: its end and its middle first."""
    if not configuration_clear(scene, q1, t1):
        return False
    if worth_probing(q0, t0, q1, t1):
        q, middle = np.empty_like(q0), 0.5 * (t0 + t1)
        own_at(scene, q0, t0, q1, t1, middle, q)
        if not configuration_clear(scene, q, middle):
            return False
    clear, _ = clear_until(scene, q0, t0, q1, t1)
    return bool(clear)

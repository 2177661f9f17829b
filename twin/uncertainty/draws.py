"""Counter-based random draws: one uniform number per (seed, replication, robot, task, kind, purpose, index).

The generator is Philox 4x64-10 (Salmon et al., SC 2011), a keyed bijection of a counter. A draw depends only on its
key and counter. Two policies with the same seed therefore get the same skill durations (common random numbers), the
order of evaluation does not matter, and many draws can be computed at once.

    key     = (seed, replication)
    counter = (draw index, task, hash of robot, hash of kind and purpose)
"""

from __future__ import annotations

import hashlib
from functools import cache

import numpy as np
import numpy.typing as npt

from planning.kernels import kernel
from planning.transforms import Array

TaskName = tuple[str, int]
"""Robot and task number that key the draws of a task; by default its own."""

Words = npt.NDArray[np.uint64]
"""Unsigned 64-bit words."""

_ROUNDS = 10
_MULTIPLIER_0 = np.uint64(0xD2E7470EE14C6C93)
_MULTIPLIER_1 = np.uint64(0xCA5A826395121157)
_WEYL_0 = np.uint64(0x9E3779B97F4A7C15)
_WEYL_1 = np.uint64(0xBB67AE8584CAA73B)
_LOW = np.uint64(0xFFFFFFFF)
_HALF = np.uint64(32)
_DROP = np.uint64(12)
_SCALE = 2.0**-52

LEAST_UNIFORM = 0.5 * _SCALE
"""Least value that is drawn."""


@kernel
def _high_product(a: np.uint64, b: np.uint64) -> np.uint64:
    """Return the upper 64 bits of the 128-bit product of two words."""
    a0, a1 = a & _LOW, a >> _HALF
    b0, b1 = b & _LOW, b >> _HALF
    middle = a1 * b0 + ((a0 * b0) >> _HALF)
    other = a0 * b1 + (middle & _LOW)
    return a1 * b1 + (middle >> _HALF) + (other >> _HALF)


@kernel
def philox_block(counter: Words, key: Words, out: Words) -> None:
    """Write the Philox 4x64-10 image of a counter.

    Args:
        counter: shape (4,), least significant word first.
        key: shape (2,).
        out: shape (4,), written.
    """
    c0, c1, c2, c3 = counter[0], counter[1], counter[2], counter[3]
    k0, k1 = key[0], key[1]
    for _ in range(_ROUNDS):
        high0, low0 = _high_product(_MULTIPLIER_0, c0), _MULTIPLIER_0 * c0
        high1, low1 = _high_product(_MULTIPLIER_1, c2), _MULTIPLIER_1 * c2
        c0, c1, c2, c3 = high1 ^ c1 ^ k0, low1, high0 ^ c3 ^ k1, low0
        k0 += _WEYL_0
        k1 += _WEYL_1
    out[0], out[1], out[2], out[3] = c0, c1, c2, c3


@kernel
def _uniforms(
    seed: np.uint64,
    replications: Words,
    index: Words,
    task: Words,
    robot: Words,
    purpose: Words,
    out: Array,
) -> None:
    counter = np.empty(4, np.uint64)
    key = np.empty(2, np.uint64)
    block = np.empty(4, np.uint64)
    key[0] = seed
    for i in range(out.shape[0]):
        counter[0], counter[1] = index[i], task[i]
        counter[2], counter[3] = robot[i], purpose[i]
        for r in range(out.shape[1]):
            key[1] = replications[r]
            philox_block(counter, key, block)
            out[i, r] = (np.float64(block[0] >> _DROP) + 0.5) * _SCALE


@cache
def stable_hash(*names: str) -> int:
    """Return a 64-bit hash of names that is the same in every process and version."""
    text = "\0".join(names).encode()
    return int.from_bytes(hashlib.blake2b(text, digest_size=8).digest(), "little")


def uniforms(
    seed: int,
    replications: npt.ArrayLike,
    robots: list[str],
    tasks: npt.ArrayLike,
    kinds: list[str],
    purpose: str,
    indices: npt.ArrayLike = 0,
) -> Array:
    """Return one uniform in (0, 1) for each of n named draws in each of r replications.

    Args:
        seed: of the run, 0 or more.
        replications: their numbers, 0 or more, shape (r,).
        robots: robot of each draw, n names.
        tasks: task index of each draw, shape (n,), or that of all.
        kinds: task kind of each draw, n names.
        purpose: purpose of the draws, such as ``"duration"``.
        indices: number of the draw where one task needs several, shape (n,), or that of all.

    Returns:
        Shape (n, r), the same values whatever else is drawn, and in whatever order; the
        values of one named draw are next to each other.

    Raises:
        ValueError: the seed or a replication is negative or does not fit into 64 bits.
    """
    if not 0 <= seed < 2**64:
        raise ValueError(f"seed must be within 0 and 2**64 - 1, not {seed}")
    numbers = np.asarray(replications, dtype=np.int64)
    if numbers.size and numbers.min() < 0:
        raise ValueError(f"replications must be at least 0, not {numbers.min()}")
    out = np.empty((len(robots), len(numbers)))
    _uniforms(
        np.uint64(seed),
        numbers.astype(np.uint64),
        _words(indices, len(robots)),
        _words(tasks, len(robots)),
        np.array([stable_hash("robot", name) for name in robots], dtype=np.uint64),
        np.array([stable_hash(kind, purpose) for kind in kinds], dtype=np.uint64),
        out,
    )
    return out


def _words(numbers: npt.ArrayLike, count: int) -> Words:
    row = np.broadcast_to(np.asarray(numbers, dtype=np.int64), count)
    return np.ascontiguousarray(row).view(np.uint64)

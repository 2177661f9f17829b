"""Sequences of the variants of products: drawn by their shares, or repeated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

_PURPOSE = "variant"
"""Purpose of the draws of a sequence."""


def sequence_by_shares(
    shares: Mapping[str, float], count: int, seed: int
) -> tuple[str, ...]:
    """Return a random variant for each product.

    A product's variant depends on nothing but the shares, the seed and its number.

    Args:
        shares: of the variants, by name, 0 or more, one of them above 0.
        count: number of products.
        seed: of the draws.
    """
    from twin.uncertainty.draws import uniforms

    names = [name for name, share in shares.items() if share > 0.0]
    own = np.array([shares[name] for name in names])
    # In proportion to the largest, as products of the smallest numbers are inexact.
    ends = np.cumsum(own / own.max())
    numbers = np.arange(1, count + 1)
    drawn = uniforms(seed, [0], [""] * count, numbers, [""] * count, _PURPOSE)[:, 0]
    chosen = np.searchsorted(ends[:-1], drawn * ends[-1], side="right")
    return tuple(names[k] for k in chosen.tolist())


def repeated_sequence(names: Sequence[str], count: int) -> tuple[str, ...]:
    """Return names, repeated until there is one for each product."""
    return tuple(names[k % len(names)] for k in range(count))

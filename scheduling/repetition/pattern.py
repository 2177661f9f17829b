"""What is repeated: a pattern of a few products, and how one copy of it waits for another."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from planning.transforms import Indices


@dataclass(frozen=True)
class Pattern:
    """A plan for some products that is repeated for many.

    At the end of the pattern everything is again as it was at its start: robots at HOME, sources
    full, places empty. So its copies come one after another, and overlap as the graph lets them.

    Attributes:
        products: how many there are to be in all.
        period: products of the pattern.
        product: the product for which each task of the pattern is done, from 1, shape (tasks,).
            What brings parts of a later copy is done for a product of that one, and is left out
            where there is no such product.
        lags: triples (a, b, n), shape (d, 3): task b of the copy that is n later waits for task
            a of a copy.
        objects: by name of an object of the pattern, its part and product: in the copy after it
            is that of product + period.
    """

    products: int
    period: int
    product: Indices
    lags: Indices
    objects: Mapping[str, tuple[str, int]]

    @property
    def copies(self) -> int:
        """Number of copies, of which the last one may be cut short."""
        return -(-self.products // self.period)

    @property
    def reach(self) -> int:
        """Number of copies over which tasks wait for each other at most, at least 1."""
        return int(max(1, *self.lags[:, 2])) if len(self.lags) else 1

    def object_of(self, name: str, copy: int) -> str:
        """Return the name that something has in a copy, counted from 0."""
        if name not in self.objects:
            return name
        part, product = self.objects[name]
        return numbered(part, product + copy * self.period)


def numbered(part: str, product: int) -> str:
    """Return the name of a product's part, counted from 1."""
    return f"{part}.{product}"

"""Samples of a driver that its dispatcher has not heard of yet."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from itertools import islice

from twin.drivers.driver import Sample

_AGAIN_S = 0.5
"""After so long, samples that have not been heard of are told again [s]."""

_MOST = 50_000
"""Samples that are kept for a dispatcher that does not answer."""


class Unheard:
    """Samples, numbered from 0 on, that are told until they have been heard of."""

    def __init__(self) -> None:
        self.kept = 0
        """Number of the oldest one that is left."""
        self._samples: deque[Sample] = deque()
        self._told = 0
        self._again_s = -math.inf

    def add(self, samples: Iterable[Sample]) -> None:
        """Take further ones."""
        self._samples += samples
        while len(self._samples) > _MOST:
            self._drop()

    def heard(self, count: int) -> None:
        """Drop those that have been heard of; a dispatcher that has heard of none is told all that are left.

        Args:
            count: the number of the next one that it wants.
        """
        if not count:
            self._told = self.kept
        while self._samples and self.kept < count:
            self._drop()

    def to_tell(self, now_s: float) -> tuple[int, tuple[Sample, ...]]:
        """Return the number of the first of those that are to be told now, and them."""
        if now_s - self._again_s >= _AGAIN_S:
            self._told, self._again_s = self.kept, now_s
        first = max(self._told, self.kept)
        self._told = self.kept + len(self._samples)
        return first, tuple(islice(self._samples, first - self.kept, None))

    def _drop(self) -> None:
        self._samples.popleft()
        self.kept += 1

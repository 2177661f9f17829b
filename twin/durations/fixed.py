"""Fixed durations."""

from __future__ import annotations

from typing import Literal

import numpy as np

from planning.transforms import Array
from twin.durations.model import DurationModel, Seconds


class Fixed(DurationModel):
    """A constant duration."""

    kind: Literal["fixed"] = "fixed"
    value_s: Seconds

    def _ppf(self, u: Array) -> Array:
        return np.full(np.shape(u), self.value_s)

    def _moments(self) -> tuple[float, float]:
        return self.value_s, 0.0

    def _minimum(self) -> float:
        return self.value_s

"""Progress reports of long computations."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float, float], None]
"""Called with how much is done, and how much there is in all."""


def no_progress(done: float, total: float) -> None:
    """Ignore progress."""

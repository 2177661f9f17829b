"""Progress reports of long computations."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float, float], None]
"""Callback with the amount of completed work and the total amount."""


def no_progress(done: float, total: float) -> None:
    """Ignore progress."""

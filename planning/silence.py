"""Suppression of the terminal output of compiled libraries, and a silent HiGHS solver."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import pulp


@contextmanager
def silence_output() -> Iterator[None]:
    """Discard the terminal output of compiled code, such as the import banner of PyBullet.

    Python's own output uses the same two file descriptors, so no other code should run meanwhile.
    """
    with ExitStack() as stack:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        stack.callback(os.close, nowhere)
        for number, stream in ((1, sys.stdout), (2, sys.stderr)):
            try:
                stream.flush()
                kept = os.dup(number)
            except (OSError, ValueError):  # closed: there is nothing to silence
                continue
            stack.callback(os.close, kept)
            stack.callback(os.dup2, kept, number)
            os.dup2(nowhere, number)
        yield


class QuietHighs(pulp.HiGHS):  # type: ignore[misc]  # PuLP does not say its type
    """HiGHS through PuLP, single-threaded, deterministic and silent.

    Args:
        options: further ones of ``pulp.HiGHS``.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(msg=False, threads=1, random_seed=0, **options)

    def createAndConfigureSolver(self, lp: pulp.LpProblem) -> None:  # noqa: N802, PuLP's name
        """Create the solver of a program."""
        with silence_output():
            super().createAndConfigureSolver(lp)

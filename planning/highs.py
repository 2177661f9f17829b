"""The solver HiGHS without its greeting, which since 1.16 it prints whenever one is made."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import highspy
import pulp

from planning.silence import silenced


def new_highs() -> Any:
    """Return a solver that prints nothing."""
    new_solver: Callable[[], Any] = highspy.Highs
    with silenced():
        solver = new_solver()
    solver.setOptionValue("output_flag", False)
    return solver


class QuietHighs(pulp.HiGHS):  # type: ignore[misc]  # PuLP does not say its type
    """HiGHS as PuLP drives it, on one thread and the same every time; it prints nothing.

    Args:
        options: further ones of ``pulp.HiGHS``.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(msg=False, threads=1, random_seed=0, **options)

    def createAndConfigureSolver(self, lp: pulp.LpProblem) -> None:  # noqa: N802, PuLP's name
        """Make the solver of a program."""
        with silenced():
            super().createAndConfigureSolver(lp)

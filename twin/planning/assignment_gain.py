"""What a search for assignments gained, for the figures of a run."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class AssignmentGain:
    """Gain of the search for an assignment.

    Attributes:
        moves: assignments looked at.
        predicted_start_s: predicted makespan of the integer program's assignment [s].
        predicted_s: that of the best rated assignment that was found, or the least if none was rated [s].
        rated_start_s, rated_s: makespans of both as they are rated, with motions and waits, None
            where no plan was worth that [s].
        taken: whether the plan is of the assignment that was found.
    """

    moves: int
    predicted_start_s: float
    predicted_s: float
    rated_start_s: float | None = None
    rated_s: float | None = None
    taken: bool = False

    def content(self) -> dict[str, Any]:
        """Return the entry of a manifest and a summary."""
        return asdict(self)

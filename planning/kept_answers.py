"""Cache of answers by what was asked, so that each is worked out once.

Keys name what never changes: robot models, placed robots and convex bodies are hashed by identity
(``eq=False``), and a key keeps alive what it names; arrays enter as their bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Answer = TypeVar("Answer")


class KeptAnswers(Generic[Answer]):
    """Answers by what was asked; all are forgotten when there are too many.

    Args:
        most: how many are kept.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._answers: dict[Hashable, Answer] = {}

    def get(self, question: Hashable, work_out: Callable[[], Answer]) -> Answer:
        """Return the answer, worked out unless it is known."""
        known = self._answers.get(question)
        if known is None:
            if len(self._answers) >= self._most:
                self._answers.clear()
            known = self._answers[question] = work_out()
        return known

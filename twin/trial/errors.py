"""Errors raised when files of a run cannot be written, or when a run cannot be resumed."""

from __future__ import annotations

from planning.errors import TwinError


class IncompleteRunError(TwinError):
    """Some files of a run could not be written, so its folder is incomplete."""


class ResumeError(TwinError):
    """A run cannot be resumed, or it differs from its log.

    Attributes:
        row: number of the first row of the log that differs, from 1; None if no row differs.
    """

    def __init__(self, message: str, *, row: int | None = None) -> None:
        self.row = row
        super().__init__(message)

"""The report of a study."""

from __future__ import annotations

from twin.progress import Report
from twin.study.study import StudyResult


def write_report(result: StudyResult, progress: Report) -> None:
    """Write the report."""

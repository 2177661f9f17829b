"""What every format is: files made of a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from twin.exports.recorded_run import RecordedRun


@dataclass(frozen=True)
class ExportOptions:
    """Choices that some formats know.

    Attributes:
        nodes: every node of the temporal plan graph, not one entry a task.
    """

    nodes: bool = False


class Exporter(Protocol):
    """Turns a run into the files of one format."""

    def export(self, run: RecordedRun, options: ExportOptions) -> Mapping[str, bytes]:
        """Return the content of each file by its name.

        Raises:
            OutputError: the run lacks a file that the format is made of.
        """
        ...

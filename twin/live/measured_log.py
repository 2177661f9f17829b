"""Log of the measured samples of a run.

The file ``measured.csv`` contains every sample of every robot as received, so no received sample is lost if the
process is killed.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import TextIO

import numpy as np

from planning.bounds import LATEST_S
from planning.errors import OutputError
from planning.files import open_regular
from twin.drivers.driver import Sample
from twin.durations.nanoseconds import NANOSECONDS
from twin.runs.folder import LARGEST_RESULT

MEASURED = "measured.csv"
"""File of the measured samples of a run."""

_BEGIN = "#begin"
"""First column of the line with the start of the run."""

_LONGEST_LINE = 1 << 16
"""Most bytes of a line."""


class MeasuredLog:
    """Appends samples to a file.

    Args:
        path: of the file; None for nowhere.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._file: TextIO | None = None
        self._first: dict[str, Sample] = {}
        self._last: dict[str, str] = {}

    def begin_s(self) -> float | None:
        """Return the start of the run by the machine's clock [s]; None if unknown."""
        for first, *rest in self._lines():
            with suppress(ValueError, IndexError):
                if first == _BEGIN:
                    return float(rest[0])
        return None

    def before(
        self, known: Mapping[str, tuple[int, int]]
    ) -> Iterator[tuple[str, int, Sample]]:
        """Yield the rows of the file: robot, time in the run [ns], sample; invalid rows are skipped.

        Args:
            known: numbers of joints and of released nodes of each robot.

        Raises:
            OutputError: the file cannot be read, or is too large.
        """
        for robot, *rest in self._lines():
            with suppress(ValueError, KeyError):
                joints, nodes = known[robot]
                t_ns, at_s, begun, done, *q = rest
                time_ns = int(t_ns)
                own = Sample(float(at_s), np.array(q, float), int(begun), int(done))
                if (
                    len(q) == joints
                    and np.isfinite([own.at_s, *own.q]).all()
                    and 0 <= time_ns <= LATEST_S * NANOSECONDS
                    and 0 <= own.done <= own.begun <= min(own.done + 1, nodes)
                ):
                    yield robot, time_ns, own

    def _lines(self) -> Iterator[list[str]]:
        """Yield the columns of every complete line."""
        if self._path is None or not self._path.exists():
            return
        try:
            with open_regular(self._path) as file:
                if os.fstat(file.fileno()).st_size > LARGEST_RESULT:
                    raise OutputError(
                        f"{self._path}: larger than {LARGEST_RESULT >> 20} MiB"
                    )
                for line in iter(lambda: file.readline(_LONGEST_LINE), b""):
                    *columns, end = line.decode(errors="replace").split(",")
                    if columns and end.rstrip("\n") == ";":
                        yield columns
        except OSError as error:
            raise OutputError(f"{self._path}: cannot be read: {error}") from error

    def begin(self, begin_s: float) -> None:
        """Write the start of the run by the machine's clock [s]."""
        self._append(f"{_BEGIN},{begin_s!r}")
        self.flush()

    def write(self, robot: str, t_ns: int, own: Sample) -> None:
        """Append a sample of a robot at a time in the run [ns]; only first and last of a standstill."""
        first, q = self._first.get(robot), ",".join(map(repr, own.q.tolist()))
        line = f"{robot},{t_ns},{own.at_s!r},{own.begun},{own.done},{q}"
        if first is not None and _stands(first, own):
            self._last[robot] = line
            return
        if (last := self._last.pop(robot, None)) is not None:
            self._append(last)
        self._first[robot] = own
        self._append(line)

    def _append(self, line: str) -> None:
        if self._path is None:
            return
        if self._file is None:
            self._file = self._path.open("a", buffering=1 << 16)
            if self._file.tell():  # the last line may not have been written to its end
                self._file.write("\n")
        self._file.write(f"{line},;\n")

    def close(self) -> None:
        """Close the file, with the end of standstills that last."""
        try:
            for line in self._last.values():
                self._append(line)
        finally:
            if self._file is not None:
                self._file.close()

    def flush(self) -> None:
        """Flush the file to the operating system."""
        if self._file is not None:
            self._file.flush()


def _stands(first: Sample, own: Sample) -> bool:
    """Return whether a robot has stood since a sample: between two nodes, or at the same point of one."""
    if (first.begun, first.done) != (own.begun, own.done):
        return False
    return own.begun == own.done or np.array_equal(first.q, own.q)

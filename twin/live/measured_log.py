"""``measured.csv``: every sample of every robot, written as it comes, so that a kill loses none of them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

import numpy as np

from twin.drivers.driver import Sample

_BEGIN = "#begin"
"""First column of the line that says when the run began."""


class MeasuredLog:
    """Appends samples to a file.

    Args:
        path: of the file; None for nowhere.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._file: TextIO | None = None

    def begin_s(self) -> float | None:
        """Return when the run began, by the clock of the machine [s]; None where nothing says so."""
        for first, *rest in self._lines():
            if first == _BEGIN:
                return float(rest[0])
        return None

    def before(self) -> Iterator[tuple[str, int, Sample]]:
        """Yield what is in the file: robot, time in the run [ns], and sample."""
        for robot, *rest in self._lines():
            if robot != _BEGIN:
                t_ns, at_s, begun, done, *q = rest
                own = Sample(float(at_s), np.array(q, float), int(begun), int(done))
                yield robot, int(t_ns), own

    def _lines(self) -> Iterator[list[str]]:
        """Yield the columns of every line; one that was not written to its end is left out."""
        if self._path is not None and self._path.exists():
            for line in self._path.read_text().splitlines():
                *columns, end = line.split(",")
                if end == ";":
                    yield columns

    def begin(self, begin_s: float) -> None:
        """Write when the run begins, by the clock of the machine [s]."""
        self._append(f"{_BEGIN},{begin_s!r}")
        self.flush()

    def write(self, robot: str, t_ns: int, own: Sample) -> None:
        """Append a sample of a robot at a time in the run [ns]."""
        q = ",".join(map(repr, own.q.tolist()))
        self._append(f"{robot},{t_ns},{own.at_s!r},{own.begun},{own.done},{q}")

    def _append(self, line: str) -> None:
        if self._path is None:
            return
        if self._file is None:
            self._file = self._path.open("a", buffering=1 << 16)
        self._file.write(f"{line},;\n")

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()

    def flush(self) -> None:
        """Hand over to the operating system what was written."""
        if self._file is not None:
            self._file.flush()

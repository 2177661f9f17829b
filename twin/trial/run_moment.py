"""Point in time of a run, given by the folder of the run and a time."""

from __future__ import annotations

import math
from dataclasses import dataclass

from planning.errors import RequestError
from twin.durations.nanoseconds import NANOSECONDS
from twin.trial.run_result import RunResult, read_run


@dataclass(frozen=True)
class RunMoment:
    """Point in time of a run.

    Attributes:
        run: result of the run.
        t_s: time since its start [s].
    """

    run: RunResult
    t_s: float

    @classmethod
    def named(cls, text: str) -> RunMoment:
        """Parse RUN@T: the folder of a run, and seconds.

        Raises:
            RequestError: there is no time in it, or it is not within the run.
            OutputError: the folder is that of no run.
        """
        folder, _, seconds = text.rpartition("@")
        try:
            t_s = float(seconds)
        except ValueError:
            t_s = math.nan
        if not folder or math.isnan(t_s):
            raise RequestError(
                f"{text!r} is no time of a run: RUN@T, such as runs/cliff@42 for 42 s"
            )
        return cls(read_run(folder), t_s)

    def __str__(self) -> str:
        """Return the time as text."""
        return f"{self.t_s:g} s"

    @property
    def t_ns(self) -> int:
        """The time [ns].

        Raises:
            RequestError: it is not within the run.
        """
        end = self.run.makespan_ns / NANOSECONDS
        if not 0.0 <= self.t_s <= end:
            raise RequestError(
                f"{self} is not within the run {self.run.name!r}, which went from 0 to {end:.3f} s"
            )
        return round(self.t_s * NANOSECONDS)

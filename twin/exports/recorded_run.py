"""Recorded run: its folder, each file read when it is first asked for."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from planning.errors import OutputError
from twin.durations import NANOSECONDS
from twin.run.events import Event, EventLogError, parse_event, read_log
from twin.run.folder import EVENTS, SUMMARY
from twin.run.written import require_as_written
from twin.scenario.manifest import MANIFEST

if TYPE_CHECKING:
    import pyarrow as pa

    from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
    from twin.durations import Nanoseconds
    from twin.run.trajectory import Trajectory
    from twin.scenario.sections.scenario import Scenario

PLAN = "plan.json"

_MOST_FOLDERS = 8
"""Runs that are named where a folder is none, the newest first."""


@dataclass(frozen=True)
class RecordedRun:
    """Files that a run has written; see docs/reference/formats.md.

    Attributes:
        folder: of the run.
    """

    folder: Path

    @cached_property
    def tpg(self) -> TemporalPlanGraph:
        """The temporal plan graph that was executed."""
        from twin.trial.saved_plan import plan_of_run

        self._there(PLAN)
        return plan_of_run(self.folder)

    @cached_property
    def events(self) -> tuple[Event, ...]:
        """Events of the run; a last line that was not written to its end is left out."""
        path = self._as_written(EVENTS)
        out = []
        for number, line in enumerate(read_log(path), start=1):
            try:
                out.append(parse_event(line))
            except EventLogError as error:
                raise OutputError(f"{path}:{number}: {error}") from error
        return tuple(out)

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The figures; empty for a run that was killed."""
        return self._json(SUMMARY) if (self.folder / SUMMARY).exists() else {}

    @cached_property
    def scenario(self) -> str:
        """Name of the scenario."""
        name = self._json(MANIFEST).get("scenario", {}).get("name")
        return str(name or self.folder.name)

    @cached_property
    def sections(self) -> Scenario:
        """The scenario that was executed, with every default filled in."""
        from twin.scenario.sections.scenario import restored

        return restored(self._json(MANIFEST).get("scenario", {}))

    @cached_property
    def node_times_ns(self) -> tuple[tuple[Nanoseconds, Nanoseconds], ...]:
        """Start and end of every node, a pair of arrays a chain; -1 for what did not happen."""
        times = {
            c.robot: (np.full(len(c), -1, np.int64), np.full(len(c), -1, np.int64))
            for c in self.tpg.chains
        }
        for event in self.events:
            if event.kind in ("started", "completed"):
                if event.robot not in times:
                    raise self._foreign(f"robot {event.robot!r}")
                start, end = times[event.robot]
                if not 0 <= event.node < len(start):
                    raise self._foreign(f"node {event.node} of {event.robot}")
                (start if event.kind == "started" else end)[event.node] = event.t_ns
        return tuple(times.values())

    @cached_property
    def motions(self) -> dict[str, Trajectory]:
        """Motions of the robots of the cell, by robot."""
        from twin.run.folder import TRAJECTORY
        from twin.run.trajectory import Trajectory

        table = self.table(TRAJECTORY)
        names = table["robot"].to_numpy()
        smooth = "v_0" in table.column_names
        found = {}
        for robot in self.tpg.cell.robots:
            own = table.filter(names == robot.name)
            joints = range(len(robot.model.joint_names))
            q, *rates = (
                np.column_stack([own[f"{letter}_{j}"].to_numpy() for j in joints])
                for letter in ("qva" if smooth and robot.limits is not None else "q")
            )
            t_ns = np.rint(own["t_s"].to_numpy() * NANOSECONDS).astype(np.int64)
            node = own["node"].to_numpy()
            found[robot.name] = Trajectory(robot.name, t_ns, q, node, *rates)
        return found

    @property
    def smooth_motions(self) -> dict[str, Trajectory]:
        """Motions of the robots that keep to limits of acceleration, by robot; often none."""
        return {name: m for name, m in self.motions.items() if m.v is not None}

    @property
    def makespan_ns(self) -> int:
        """Time of the last event [ns]."""
        return self.events[-1].t_ns if self.events else 0

    def _foreign(self, what: str) -> OutputError:
        return OutputError(
            f"{self.folder}: {EVENTS} tells of {what}, which {PLAN} does not have"
        )

    def _there(self, name: str) -> Path:
        path = self.folder / name
        if not path.is_file():
            raise OutputError(f"{self.folder}: this run has no {name}")
        return path

    def _as_written(self, name: str) -> Path:
        path = self._there(name)
        require_as_written(self.folder, (name,))
        return path

    def _json(self, name: str) -> dict[str, Any]:
        path = self._as_written(name)
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise OutputError(f"{path}: cannot be read: {error}") from error
        if not isinstance(content, dict):
            raise OutputError(f"{path}: an object was expected")
        return content

    def table(self, name: str) -> pa.Table:
        """Return one of the tables ``trajectory.parquet`` and ``objects.parquet``."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        path = self._as_written(name)
        try:
            return pq.read_table(path)
        except (OSError, pa.ArrowException) as error:
            raise OutputError(f"{path}: cannot be read: {error}") from error


def open_run(folder: Path) -> RecordedRun:
    """Return the run in a folder.

    Raises:
        OutputError: there is none; lists the runs beside it, or in ``logs``, newest first.
    """
    if (folder / MANIFEST).is_file():
        return RecordedRun(folder)
    reason = f"it has no {MANIFEST}" if folder.is_dir() else "there is no such folder"
    near = _runs_in(folder) or _runs_in(folder.parent) or _runs_in(Path("logs"))
    raise OutputError(
        f"{folder}: this is no run, {reason}", choices=tuple(map(str, near))
    )


def _runs_in(folder: Path) -> list[Path]:
    runs = [path.parent for path in folder.glob(f"*/{MANIFEST}")]
    runs.sort(key=lambda run: (run / MANIFEST).stat().st_mtime, reverse=True)
    return runs[:_MOST_FOLDERS]

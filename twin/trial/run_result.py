"""Result of a run, just simulated or read from its folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from planning.errors import OutputError, RequestError, TwinError
from planning.files import read_object, require_own_files
from planning.parquet import read_parquet
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations.nanoseconds import NANOSECONDS, Nanoseconds
from twin.host.arguments import checks_arguments
from twin.registry import FIGURES, HOOKS
from twin.runs.events import Event, EventLogError, read_log
from twin.runs.execution_record import ExecutionRecord
from twin.runs.folder import (
    EVENTS,
    GANTT,
    OBJECTS,
    SUMMARY,
    TRAJECTORY,
    require_recorded_hashes,
)
from twin.runs.summary import summary_rows
from twin.runs.summary_schema import require_figures
from twin.runs.trajectory import Trajectory
from twin.scenario.manifest import MANIFEST
from twin.scenario.sections.scenario import Scenario, restore_scenario
from twin.trial.header import run_figures, run_header
from twin.trial.loaded_scenario import PathOrName
from twin.trial.plan_result import PlanResult, plan_of_run, read_plan

if TYPE_CHECKING:
    import pyarrow as pa

PLAN = "plan.json"

_MOST_FOLDERS = 8
"""Runs that are named where a folder is none, the newest first."""


class Resumed(NamedTuple):
    """Numbers of events repeated from the log and added when a run was resumed."""

    agreed: int
    added: int


class RunResult:
    """One execution of a plan, in memory or in a folder; see docs/reference/formats.md.

    Data that is not in memory is read from the folder at first access.

    Attributes:
        folder: of its files; None for a run that was only simulated.
        record: times of every node; None for a run that was read from its folder.
        resumed: event counts of the resumption; None if it was not resumed.
    """

    def __init__(
        self,
        folder: Path | None = None,
        *,
        plan: PlanResult | None = None,
        history: Sequence[Event] | None = None,
        record: ExecutionRecord | None = None,
        resumed: Resumed | None = None,
    ) -> None:
        """Keep the given data; the rest is read from the folder.

        Args:
            folder: of the files.
            plan: the executed plan; None to read it.
            history: everything that happened, in order; None to read it.
            record: times of every node.
            resumed: event counts of the resumption.
        """
        self.folder, self.record, self.resumed = folder, record, resumed
        self._plan = plan
        self._history = None if history is None else tuple(history)

    @cached_property
    def plan(self) -> PlanResult:
        """The executed plan."""
        return self._plan or read_plan(self.files)

    @cached_property
    def tpg(self) -> TemporalPlanGraph:
        """The temporal plan graph that was executed."""
        if self._plan is not None:
            return self._plan.tpg
        self._require_file(PLAN)
        return plan_of_run(self.files)

    @cached_property
    def name(self) -> str:
        """Name of the scenario."""
        if self._plan is not None:
            return self._plan.scenario.name
        name = self._json(MANIFEST).get("scenario", {}).get("name")
        return str(name or self.files.name)

    @cached_property
    def sections(self) -> Scenario:
        """The scenario that was executed, with every default filled in."""
        if self._plan is not None:
            return self._plan.scenario.sections
        return restore_scenario(self._json(MANIFEST).get("scenario", {}))

    @cached_property
    def history(self) -> tuple[Event, ...]:
        """All events in order, without an incomplete last line."""
        if self._history is not None:
            return self._history
        path = self._as_written(EVENTS)
        out = []
        for number, line in enumerate(read_log(path), start=1):
            try:
                out.append(Event.parse(line))
            except EventLogError as error:
                raise OutputError(f"{path}:{number}: {error}") from error
        return tuple(out)

    @cached_property
    def summary(self) -> Mapping[str, Any]:
        """All figures, with the keys of ``summary.json``; empty for a run that was killed."""
        if self.folder is not None:
            if not (path := self.folder / SUMMARY).exists():
                return {}
            require_figures(found := self._json(SUMMARY), path)
            return found
        if self.record is None:
            raise RequestError("a run without a folder has no files")
        return run_figures(self.plan, self.record, run_header(self.plan))

    @property
    def outcome(self) -> str:
        """Outcome: completed, failed or aborted."""
        return str(self.summary["outcome"])

    @property
    def passed(self) -> bool:
        """True if it was completed and its audit, if any, found nothing."""
        audit = self.summary["audit"]
        return self.outcome == "completed" and not (audit and audit["violations"])

    @property
    def policy(self) -> str:
        """Name of the policy: coordination and release."""
        return str(self.summary["policy"])

    @property
    def seed(self) -> int:
        """Seed of the random draws."""
        return int(self.summary["seed"])

    @property
    def makespan_s(self) -> float:
        """End of the last node, or time of the interrupt [s]."""
        return float(self.summary["makespan_s"])

    @property
    def makespan_ns(self) -> int:
        """Time of the last event [ns]."""
        return self.history[-1].t_ns if self.history else 0

    @property
    def wait_s(self) -> Mapping[str, float]:
        """Waiting time of each robot [s]."""
        return dict(self.summary["wait_s"])

    @property
    def events(self) -> pa.Table:
        """Table of events: t_s, robot, kind, task, node, object, detail."""
        from twin.recorders.run_tables import events_table

        return events_table(self.history)

    @property
    def activities(self) -> pa.Table:
        """Table of activities and waits: robot, state, start_s, end_s, task."""
        table = HOOKS.require("activities", "a table of activities")
        return table(self.tpg, self.history)

    @property
    def trajectory(self) -> pa.Table:
        """Table of robot configurations: t_s, robot, q_0 ... q_k, node."""
        if self.record is None:
            return self._table(TRAJECTORY)
        from twin.recorders.run_tables import trajectory_table
        from twin.runs.trajectory import robot_trajectories

        moved = robot_trajectories(self.tpg, self.record)
        return trajectory_table(moved, tuple(self.record.measured))

    @property
    def objects(self) -> pa.Table:
        """Table of object placements: t_s, object, parent, xyz, quat_wxyz."""
        if self.record is None:
            return self._table(OBJECTS)
        from twin.recorders.run_tables import objects_table
        from twin.runs.trajectory import object_placements

        return objects_table(object_placements(self.tpg, self.record))

    @cached_property
    def node_times_ns(self) -> tuple[tuple[Nanoseconds, Nanoseconds], ...]:
        """Start and end of every node, a pair of arrays per chain; -1 where it did not happen."""
        times = {
            c.robot: (np.full(len(c), -1, np.int64), np.full(len(c), -1, np.int64))
            for c in self.tpg.chains
        }
        for event in self.history:
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
        table = self.trajectory
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

    @cached_property
    def measured(self) -> frozenset[str]:
        """Robots with work that others moved: their motions are where they were measured."""
        about = self.trajectory.schema.metadata or {}
        names = about.get(b"measured", b"").decode().split(",")
        return frozenset(names) & self.tpg.chain_index.keys()

    @property
    def smooth_motions(self) -> dict[str, Trajectory]:
        """Motions of the robots that keep to limits of acceleration, by robot; often none."""
        return {name: m for name, m in self.motions.items() if m.v is not None}

    @property
    def files(self) -> Path:
        """The folder of its files; RequestError for a run that was only simulated."""
        if self.folder is None:
            raise RequestError("a run without a folder has no files")
        return self.folder

    def _foreign(self, what: str) -> OutputError:
        return OutputError(
            f"{self.folder}: {EVENTS} tells of {what}, which {PLAN} does not have"
        )

    def _require_file(self, name: str) -> Path:
        path = self.files / name
        require_own_files(self.files, (name, SUMMARY))
        if not path.is_file():
            raise OutputError(f"{self.folder}: this run has no {name}")
        return path

    def _as_written(self, name: str) -> Path:
        path = self._require_file(name)
        require_recorded_hashes(self.files, (name,))
        return path

    def _json(self, name: str) -> dict[str, Any]:
        return read_object(self._as_written(name), "result of a run")

    def _table(self, name: str) -> pa.Table:
        """Return one of the tables ``trajectory.parquet`` and ``objects.parquet``."""
        return read_parquet(self._as_written(name))

    def __repr__(self) -> str:
        """Return a one-line description, even for a damaged folder."""
        where = "in memory" if self.folder is None else f"in {self.folder}"
        try:
            entries = f"{self.outcome}, {self.policy}, {self.makespan_s:.2f} s, "
            return f"<run of {self.name!r}: {entries}{where}>"
        except (TwinError, KeyError):
            return f"<run without a summary, {where}>"

    def _repr_html_(self) -> str:
        from twin.host.cards import card, inline_picture, run_picture

        rows = [
            (name, f"{value} {note}")
            for name, value, note in summary_rows(self.summary)
        ]
        page = card(self.name, rows)
        if self.record is None:
            return page + run_picture(self.files / GANTT)
        if "run" not in FIGURES:
            return page
        figure = FIGURES.load("run")(
            self.tpg, self.record, self.history, title=self.name, plan=self.plan.name
        )
        return page + inline_picture(figure)


@checks_arguments
def read_run(folder: PathOrName) -> RunResult:
    """Return the run in a folder; each of its files is read when it is first asked for.

    Args:
        folder: such as ``logs/cliff-20260101T120000Z``.

    Raises:
        OutputError: there is no run; lists the runs next to it, or in ``logs``, newest first. A
            file that is not as the run wrote it raises it when it is read.
    """
    place = Path(folder)
    if (place / MANIFEST).is_file():
        return RunResult(place)
    reason = f"it has no {MANIFEST}" if place.is_dir() else "there is no such folder"
    near = _runs_in(place) or _runs_in(place.parent) or _runs_in(Path("logs"))
    raise OutputError(
        f"{folder}: this is no run, {reason}", choices=tuple(map(str, near))
    )


def _runs_in(folder: Path) -> list[Path]:
    runs = [path.parent for path in folder.glob(f"*/{MANIFEST}")]
    runs.sort(key=lambda run: (run / MANIFEST).stat().st_mtime, reverse=True)
    return runs[:_MOST_FOLDERS]

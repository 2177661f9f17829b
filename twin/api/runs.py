"""``twin.simulate`` and ``twin.run``: a plan executed once, in memory or into a folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planning.errors import RequestError, ScenarioError
from twin.api.checks import Check, check
from twin.api.plans import (
    AnyPlan,
    Plan,
    plan_checked,
    planned,
    read_plan,
    require_plan_of,
    scenario_of,
)
from twin.api.scenarios import PathOrName
from twin.audit.worlds.engine import engine_named
from twin.durations import NANOSECONDS
from twin.exports.recorded_run import RecordedRun, open_run
from twin.exports.tables import events_table
from twin.host.progress import Report, report_nothing
from twin.recorders.observers import MemoryRecorder
from twin.run.events import Event
from twin.run.folder import GANTT, OBJECTS, TRAJECTORY, run_folder
from twin.run.policies import NAMED_POLICIES, policy_named
from twin.run.run_record import POLICIES, Run
from twin.run.summary import summary_rows
from twin.trial.trial import Origin, execute, figures, has_passed, prepare, try_plan

if TYPE_CHECKING:
    import pyarrow as pa

Begun = Callable[[Check, Path], None]
"""Told of the check and of the folder of a run, before it is planned."""


@dataclass(frozen=True)
class SimulatedRun:
    """One execution of a plan.

    Attributes:
        plan: what was executed.
        history: everything that happened, in order.
        record: times of every node; None for a run that was read from its folder.
        folder: of its files; None for a run that was only simulated.
    """

    plan: Plan
    history: tuple[Event, ...]
    record: Run | None = None
    folder: Path | None = None

    @cached_property
    def summary(self) -> Mapping[str, Any]:
        """All figures, with the keys of ``summary.json``."""
        if self.record is None or self.folder is not None:
            return self._files.summary
        case, made = self.plan.scenario, self.plan.made
        origin = Origin(made, self.plan.warnings)
        about = prepare(case.sections, made.tpg, case.folder, origin)
        return figures(case.sections, made.tpg, self.record, about)

    @property
    def outcome(self) -> str:
        """How it ended: completed, failed or aborted."""
        return str(self.summary["outcome"])

    @property
    def passed(self) -> bool:
        """True if it was completed, and no audit in it found anything."""
        return has_passed(self.summary)

    @property
    def policy(self) -> str:
        """Name of the policy: which plan, released how."""
        return str(self.summary["policy"])

    @property
    def seed(self) -> int:
        """Seed of its draws."""
        return int(self.summary["seed"])

    @property
    def makespan_s(self) -> float:
        """End of the last node, or when the run was broken off [s]."""
        return float(self.summary["makespan_s"])

    @property
    def wait_s(self) -> Mapping[str, float]:
        """How long each robot waited [s]."""
        return dict(self.summary["wait_s"])

    @property
    def events(self) -> pa.Table:
        """A row an event: t_s, robot, kind, task, node, object, detail."""
        return events_table(self.history)

    @property
    def activities(self) -> pa.Table:
        """What each robot did when: robot, state, start_s, end_s, task; waits are rows, too."""
        import pyarrow as pa

        from twin.run.activities import robot_activities

        told = robot_activities(self.plan.tpg, self.history)
        rows = [(robot, item) for robot, lane in told.items() for item in lane]
        return pa.table(
            {
                "robot": pa.array([robot for robot, _ in rows], pa.string()),
                "state": pa.array([item.state for _, item in rows], pa.string()),
                "start_s": pa.array([i.start_ns / NANOSECONDS for _, i in rows]),
                "end_s": pa.array([i.end_ns / NANOSECONDS for _, i in rows]),
                "task": pa.array([item.task for _, item in rows], pa.int64()),
            }
        )

    @property
    def trajectory(self) -> pa.Table:
        """Where each robot was when: t_s, robot, q_0 ... q_k, node."""
        if self.record is None:
            return self._files.table(TRAJECTORY)
        from twin.recorders.motion_tables import trajectory_table
        from twin.run.trajectory import robot_trajectories

        return trajectory_table(robot_trajectories(self.plan.tpg, self.record))

    @property
    def objects(self) -> pa.Table:
        """Where each object was from when on: t_s, object, parent, xyz, quat_wxyz."""
        if self.record is None:
            return self._files.table(OBJECTS)
        from twin.recorders.motion_tables import objects_table
        from twin.run.trajectory import object_placements

        return objects_table(object_placements(self.plan.tpg, self.record))

    @property
    def _files(self) -> RecordedRun:
        if self.folder is None:
            raise RequestError("a run without a folder has no files")
        return RecordedRun(self.folder)

    def _repr_html_(self) -> str:
        from twin.api.html import card, drawn, shown

        rows = [
            (name, f"{value} {note}")
            for name, value, note in summary_rows(self.summary)
        ]
        page = card(self.plan.scenario.name, rows)
        if self.record is not None:
            from twin.run.gantt import gantt_figure

            tpg, name = self.plan.tpg, self.plan.scenario.name
            return page + drawn(
                gantt_figure(
                    tpg, self.record, self.history, title=name, plan=self.plan.name
                )
            )
        return page + shown(self._files.folder / GANTT)


def simulate(
    plan: AnyPlan,
    values: Mapping[str, Any] | None = None,
    *,
    seed: int | None = None,
    policy: str | None = None,
    progress: Report = report_nothing,
) -> SimulatedRun:
    """Execute a plan once in the twin, and write nothing.

    Args:
        plan: the plan; a scenario, or the path of its file, is planned first.
        values: other values at keys of the execution section, such as
            ``{"stalls.rate_per_h": 60}``; see ``LoadedScenario.varied``.
        seed: of the draws, in place of the scenario's.
        policy: how nodes are released, in place of the scenario's: asynchronous, sequential,
            synchronous or open-loop.
        progress: told how far each stage of planning has come.

    Raises:
        ScenarioError: a value does not fit.
        RequestError: a value would need another plan.
        DeadlockError: no robot could go on.
        TwinError: there is no plan; see ``twin.plan``.
    """
    ready = _with_values(planned(plan, progress), values or {}, seed, policy)
    case, memory = ready.scenario, MemoryRecorder()
    record = execute(case.sections, ready.tpg, case.folder, recorders=(memory,))
    return SimulatedRun(ready, tuple(memory.events), record)


def run(
    plan: AnyPlan,
    *,
    out: PathOrName | None = None,
    recording: bool = True,
    audit: bool = True,
    audit_engine: str | None = None,
    begun: Begun | None = None,
    progress: Report = report_nothing,
) -> SimulatedRun:
    """Check and plan a scenario, execute it in the twin, audit it, and write everything.

    Args:
        plan: a scenario, or the path of its file; a plan is not made again.
        out: folder for the results; by default ``logs/<scenario>-<UTC time>``.
        recording: write ``run.rrd`` for the viewer.
        audit: check what was executed with code of its own.
        audit_engine: pybullet or coal; by default PyBullet where it is installed, else coal.
        begun: told of the check and of the folder, before anything that takes long.
        progress: told how far each stage has come.

    Returns:
        The run; what the audit found is in its summary.

    Raises:
        InvalidScenarioError: the file is not valid, or the check of the cell finds an error.
        OutputError: the folder cannot be written to.
        TwinError: there is no plan, or the run broke off; see ``twin.plan``.
    """
    # Now, not after the planning.
    engine = engine_named(audit_engine) if audit and audit_engine is not None else None
    ready = plan if isinstance(plan, Plan) else None
    case = scenario_of(plan)
    checked = check(case, progress=progress)
    checked.require_ok()
    place = None if out is None else Path(out)
    with run_folder(place, case.name) as folder:
        if begun is not None:
            begun(checked, folder)
        ready = ready or plan_checked(checked, progress)
        trial = try_plan(
            case.sections,
            ready.tpg,
            folder,
            base=case.folder,
            origin=Origin(ready.made, checked.warnings),
            recording=recording,
            audit=engine or audit,
            progress=progress,
        )
    return SimulatedRun(ready, tuple(trial.events), trial.run, folder)


def read_run(folder: PathOrName) -> SimulatedRun:
    """Read a run from its folder.

    Args:
        folder: such as ``logs/cliff-20260101T120000Z``.

    Raises:
        OutputError: there is no run, or a file is not as the run wrote it.
    """
    files = open_run(Path(folder))
    return SimulatedRun(read_plan(folder), files.events, folder=files.folder)


def any_run(run: SimulatedRun | PathOrName) -> SimulatedRun:
    """Return a run as it is, or read it from its folder."""
    return run if isinstance(run, SimulatedRun) else read_run(run)


def _with_values(
    plan: Plan, values: Mapping[str, Any], seed: int | None, policy: str | None
) -> Plan:
    """Return a plan whose scenario is executed with other values."""
    given = {"seed": seed, "policy": policy}
    values = {**values, **{k: v for k, v in given.items() if v is not None}}
    other = plan.scenario.varied(released(values))
    require_plan_of(plan, other)
    return replace(plan, scenario=other)


def released(values: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return values as they are, and refuse a policy that is no way to release nodes.

    Raises:
        ScenarioError: says how to have what is meant.
    """
    policy = values.get("policy")
    if policy is None or policy in POLICIES:
        return values
    try:
        name = policy_named(str(policy))
    except RequestError:
        message = f"policy: there is no {policy!r}"
        raise ScenarioError(message, choices=POLICIES) from None
    plan, release = NAMED_POLICIES[name]
    raise ScenarioError(
        f"policy {name!r} is {release} of the plan {plan}: give --policy {release}; --shortcuts"
        " and the scenario's coordination say which plan it is"
    )

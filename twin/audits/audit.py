"""Audit of a run: replay of the execution and measurement of all distances.

The audit takes only the list of allowed contacts from the plan. Robots are read from their URDF files, and
motion is read from the tables that the run wrote. From the cell, the audit uses names, files, sizes and start
poses, but no precomputed hulls, capsules or kinematics.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from planning.files import require_own_files
from planning.transforms import Transform
from scheduling.graph.plan_files import load_plan
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.audits.balance import balance_violations
from twin.audits.case import (
    AuditCase,
    NodeSpans,
    Violation,
    edge_violations,
    logged_spans,
)
from twin.audits.contacts import Contacts, allowed_contacts
from twin.audits.expectations import Expectations
from twin.audits.grips import grip_violations
from twin.audits.joint_limits import joint_violations
from twin.audits.motion.efforts import (
    GreatestEffort,
    efforts_of_run,
    greatest_efforts,
    tool_speeds_of_run,
)
from twin.audits.motion.executed import Recording, ReplayedRun, Stay, read_recording
from twin.audits.motion.stretches import Sampler, stretches
from twin.audits.motion_limits import (
    effort_violations,
    limit_violations,
    tool_speed_violations,
)
from twin.audits.places import (
    jump_violations,
    leftover_helpers,
    place_violations,
    start_violations,
    tool_violations,
    with_object_names,
)
from twin.audits.processes import process_violations
from twin.audits.resting import hanging_violations
from twin.audits.supports import support_violations
from twin.audits.work_places import rest_violations
from twin.audits.worlds.engines import (
    Engine,
    engine_and_version,
    engine_named,
    second_world,
)
from twin.audits.worlds.world import AuditWorld, overlapping_at_home
from twin.host.atomic_files import finite_or_none
from twin.host.progress import Report, report_nothing

_EVENTS = "events.jsonl"

STATES_APART_S = 1000.0
"""Time from one standing state to the next one in a recording of many [s]."""

AUDIT = "audit"
"""Name of the stage for progress displays."""


@dataclass(frozen=True)
class AuditReport:
    """Result of an audit.

    Attributes:
        configurations: number of different configurations of the whole cell that were checked.
        min_distance_m: least distance that was measured of any two robots with what they carry,
            where they are not meant to touch; negative if they overlap, infinite with fewer than
            two robots [m].
        min_distance_bound_m: nearer than this they were at no moment; at most 0.05 mm
            less than ``min_distance_m`` [m].
        violations: by time; empty when all is well.
        engine: collision engine and its version.
        contact_tolerance_m: how deep a tool may graze a brick in a skill [m].
        deepest_graze_m: how deep one did where it was measured; 0 where none did [m].
        helpers: objects that stay where they only help, such as temporary bricks.
        efforts: the greatest that joints of robots within limits needed, where efforts and masses
            are known; of a whole run only.
    """

    configurations: int
    min_distance_m: float
    min_distance_bound_m: float
    violations: tuple[Violation, ...]
    engine: str
    contact_tolerance_m: float = 0.0
    deepest_graze_m: float = 0.0
    helpers: tuple[str, ...] = ()
    efforts: tuple[GreatestEffort, ...] = ()

    def content(self) -> dict[str, Any]:
        """Return the report for JSON, as ``summary.json`` has it."""
        return {
            "engine": self.engine,
            "configurations": self.configurations,
            "min_distance_m": finite_or_none(self.min_distance_m),
            "min_distance_bound_m": finite_or_none(self.min_distance_bound_m),
            "contact_tolerance_m": self.contact_tolerance_m,
            "deepest_graze_m": self.deepest_graze_m,
            "helpers": list(self.helpers),
            "efforts": [asdict(effort) for effort in self.efforts],
            "violations": [asdict(violation) for violation in self.violations],
        }


def audit_run(
    folder: Path,
    progress: Report = report_nothing,
    *,
    ordered: bool = True,
    engine: Engine | None = None,
    wanted: Expectations | None = None,
    finished: bool = True,
) -> AuditReport:
    """Audit a run that was written to a folder.

    Args:
        folder: with ``plan.npz``, ``plan.json``, ``trajectory.parquet``, ``objects.parquet``;
            ``events.jsonl`` is looked at where it is there.
        progress: receives the progress of the audit.
        ordered: whether the run had to keep the plan's type-2 edges, as all policies but
            open-loop do.
        engine: whether PyBullet looks at samples besides coal; by default where it is installed.
        wanted: places and holds by the scenario; None without a scenario: supports, grips and
            places are not checked then.
        finished: whether the run came to its end, so that all must be in place.

    Raises:
        RequestError: the engine is not installed.
        OutputError: a file is missing or does not fit the others.
    """
    tpg = load_plan(folder)
    require_own_files(folder, (_EVENTS, "trajectory.parquet", "objects.parquet"))
    recording = read_recording(folder, tpg.cell)
    log = folder / _EVENTS
    spans = logged_spans(tpg, log) if log.exists() else {}
    report = audit_recording(
        tpg,
        recording,
        progress,
        ordered=ordered,
        engine=engine,
        wanted=wanted,
        finished=finished,
        spans=spans,
    )
    if not (ordered and spans):
        return report
    found = [*report.violations, *edge_violations(tpg, spans, _EVENTS)]
    return replace(report, violations=_by_time(found))


def audit_recording(
    tpg: TemporalPlanGraph,
    recording: Recording,
    progress: Report = report_nothing,
    *,
    ordered: bool = True,
    engine: Engine | None = None,
    wanted: Expectations | None = None,
    finished: bool = True,
    spans: Mapping[str, NodeSpans] = MappingProxyType({}),
) -> AuditReport:
    """Audit a whole execution by all rules.

    Args:
        tpg: the plan.
        recording: the execution.
        progress: receives the progress of the audit.
        ordered, engine, wanted, finished: see ``audit_run``.
        spans: logged start and end of nodes, by robot or machine, where available.

    Raises:
        RequestError: the engine is not installed.
        OutputError: robots move too fast to be looked at.
    """
    with Auditor(tpg, engine, wanted) as auditor:
        report = auditor.audit(
            recording, progress, ordered=ordered, finished=finished, spans=spans
        )
    replay = ReplayedRun(tpg.cell, recording)
    efforts = efforts_of_run(replay)
    found = [
        *report.violations,
        *start_violations(replay),
        *limit_violations(replay),
        *effort_violations(replay, efforts),
        *tool_speed_violations(tool_speeds_of_run(replay)),
    ]
    return replace(
        report,
        violations=_by_time(found),
        helpers=leftover_helpers(replay, wanted) if finished and wanted else (),
        efforts=tuple(greatest_efforts(tpg.cell, efforts)),
    )


class Auditor(AbstractContextManager["Auditor"]):
    """Audits any number of executions in one cell; a context manager.

    Args:
        tpg: the plan, with cell and allowed contacts.
        engine: whether PyBullet looks at samples besides coal; by default where it is installed.
        wanted: places and holds by the scenario; None without a scenario: supports and grips are
            not checked then.

    Raises:
        RequestError: the engine is not installed.
    """

    def __init__(
        self,
        tpg: TemporalPlanGraph,
        engine: Engine | None = None,
        wanted: Expectations | None = None,
    ) -> None:
        self._tpg, self._wanted = tpg, wanted
        self._allowed = allowed_contacts(tpg)
        self._engine = engine_named(engine)
        self._world = AuditWorld(tpg.cell)
        self._second = second_world(self._world, self._engine)
        self._exempt = overlapping_at_home(self._world)

    def __exit__(self, *error: object) -> None:
        """Release the resources of PyBullet."""
        if self._second is not None:
            self._second.close()

    def audit(
        self,
        recording: Recording,
        progress: Report = report_nothing,
        *,
        within: float = math.inf,
        ordered: bool = True,
        finished: bool = True,
        spans: Mapping[str, NodeSpans] | None = None,
    ) -> AuditReport:
        """Audit an execution.

        The robots are moved along their straight joint-space lines. Between two measured configurations
        distances are bounded by the travel of all points, and the interval is halved where the bound is
        insufficient. A stretch without motion is measured once.

        Args:
            recording: the execution.
            progress: receives the progress of the audit.
            within: robots further apart than this are not measured; the least distance in the
                report is at most this [m].
            ordered: whether type-2 edges had to be kept.
            finished: whether it came to its end, so that all processes must be done.
            spans: logged start and end of nodes, by robot or machine, where available.
        """
        case = AuditCase(self._world, self._tpg, recording, self._wanted, spans)
        case.wanted = with_object_names(case, case.wanted)
        contacts = Contacts(
            case, self._allowed, self._exempt, within, second=self._second
        )
        self._look(case, contacts, progress)
        rules: list[Callable[[AuditCase], Iterable[Violation]]] = [jump_violations]
        if self._wanted is not None:
            rules += [hanging_violations, balance_violations, grip_violations]
            rules += [support_violations, tool_violations]
            if finished:
                rules += [process_violations, place_violations]
                if ordered and spans:
                    rules.append(rest_violations)
        found = [violation for look in rules for violation in look(case)]
        found += joint_violations(
            recording.robots, self._world.limits, recording.measured
        )
        if ordered:
            found += edge_violations(self._tpg, case.moved, "trajectory.parquet")
        return self._report(contacts, found)

    def audit_stands(
        self, recording: Recording, placements: Iterable[Mapping[str, Stay]]
    ) -> Iterator[AuditReport]:
        """Yield a report on each of some states in which all robots stand, with the least distance so far.

        Args:
            recording: robots stand in state k from ``k * STATES_APART_S`` on, for two seconds, with a row
                for each. The first of them is not looked at.
            placements: places of all present objects in each state.
        """
        case = AuditCase(self._world, self._tpg, recording, self._wanted)
        sampler, least = Sampler(self._world, case), math.inf
        clean = set[Hashable]()
        joints = list(joint_violations(recording.robots, self._world.limits))
        for k, there in enumerate(placements):
            contacts = Contacts(
                case,
                self._allowed,
                self._exempt,
                least,
                second=self._second,
                clean=clean,
            )
            t = k * STATES_APART_S + np.arange(1.0, 3.0)
            state = sampler.sample(t, there)
            contacts.look(state)
            contacts.finish()
            least = contacts.least
            beyond = (v for v in joints if v.t_start <= t[1] and v.t_end >= t[0])
            report = self._report(contacts, beyond)
            if not report.violations:
                clean |= {
                    contacts.surroundings(state, n) for n in range(len(state.robots))
                }
            yield report

    def audit_contacts(self, recording: Recording) -> AuditReport:
        """Measure every distance of an execution, without other checks.

        Contacts that the plan means to make are no violation, however deep.

        Args:
            recording: the execution.
        """
        case = AuditCase(self._world, self._tpg, recording)
        contacts = Contacts(
            case,
            self._allowed,
            self._exempt,
            math.inf,
            any_depth=True,
            second=self._second,
        )
        self._look(case, contacts)
        return self._report(contacts)

    def _look(
        self, case: AuditCase, contacts: Contacts, progress: Report = report_nothing
    ) -> None:
        for stretch in stretches(self._world, case):
            contacts.look(stretch)
            progress(AUDIT, float(stretch.t[-1]), case.end)
        contacts.finish()

    def _report(
        self, contacts: Contacts, found: Iterable[Violation] = ()
    ) -> AuditReport:
        return AuditReport(
            contacts.configurations,
            contacts.least,
            contacts.bound,
            _by_time([*found, *contacts.violations()]),
            engine_and_version(self._engine),
            contacts.tolerance,
            contacts.deepest_graze,
        )


def _by_time(found: Iterable[Violation]) -> tuple[Violation, ...]:
    return tuple(sorted(found, key=lambda v: (v.t_start, v.first, v.second)))


def audit_off_bases(
    tpg: TemporalPlanGraph,
    recording: Recording,
    bases: Mapping[str, Transform],
    engine: Engine,
) -> AuditReport:
    """Measure every distance of an execution with base errors.

    Robots and carried objects move with the displaced bases; objects at rest stay at their planned
    poses. Intended contacts absorb the difference: they are no violation, however deep. Only contacts
    are checked.

    Args:
        tpg: the plan, with cell and allowed contacts.
        recording: the execution.
        bases: by robot, shape (4, 4) each.
        engine: to measure with.
    """
    cell = tpg.cell
    robots = tuple(replace(r, base=bases.get(r.name, r.base)) for r in cell.robots)
    off = replace(tpg, cell=replace(cell, robots=robots))
    with Auditor(off, engine) as auditor:
        return auditor.audit_contacts(recording)

"""Audit of a run: an engine of its own replays what was executed and measures every distance.

It shares nothing with the planner but the plan's list of allowed contacts: robots come from
their URDF files, boxes from their sizes, motion from the tables that the run wrote. Of the cell
only names, files, sizes and first poses are read: no hull, no capsule, no kinematics.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, replace
from functools import cache
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from scheduling.graph.plan_files import load_plan
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.audit.grips import SLACK, ContactRule, grip_violations
from twin.audit.keeping import (
    NodeSpans,
    edge_violations,
    held_in_place,
    logged_spans,
    moved_spans,
)
from twin.audit.limit_checks import (
    effort_violations,
    joint_violations,
    limit_violations,
    tool_speed_violations,
)
from twin.audit.motion.efforts import (
    GreatestEffort,
    efforts_of_run,
    greatest_efforts,
    tool_speeds_of_run,
)
from twin.audit.motion.executed import Recording, read_recording
from twin.audit.motion.pairs import Asked, gaps
from twin.audit.motion.replay import Replay
from twin.audit.motion.sampling import RunStretch, stretches
from twin.audit.places import (
    helpers_left,
    jump_violations,
    place_violations,
    start_violations,
)
from twin.audit.processes import process_violations
from twin.audit.resting import hanging_violations, rest_violations
from twin.audit.supports import support_violations
from twin.audit.tools import tool_violations
from twin.audit.violation import Violation
from twin.audit.wanted import Wanted
from twin.audit.worlds.engines import (
    Engine,
    engine_and_version,
    engine_named,
    open_world,
)
from twin.audit.worlds.world import AuditWorld, WatchedShape, overlapping_at_home
from twin.host.guard import finite
from twin.host.progress import Report, report_nothing

_EVENTS = "events.jsonl"

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
        engine: what distances were measured with, and its version.
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
            "min_distance_m": finite(self.min_distance_m),
            "min_distance_bound_m": finite(self.min_distance_bound_m),
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
    wanted: Wanted | None = None,
    finished: bool = True,
) -> AuditReport:
    """Audit a run that was written to a folder.

    Args:
        folder: with ``plan.npz``, ``plan.json``, ``trajectory.parquet``, ``objects.parquet``;
            ``events.jsonl`` is looked at where it is there.
        progress: told how far the audit has come.
        ordered: whether the run had to keep the plan's type-2 edges, as all policies but
            open-loop do.
        engine: to measure with; by default PyBullet where it is installed, else coal.
        wanted: what the scenario says of places and of what holds them; None where there is no
            scenario: what hangs, grips, supports and places are not looked at then.
        finished: whether the run came to its end, so that all must be in place.

    Raises:
        RequestError: the engine is not installed.
        OutputError: a file is missing or does not fit the others.
    """
    tpg = load_plan(folder)
    recording = read_recording(folder, tpg.cell)
    replay = Replay(tpg.cell, recording)
    log = folder / _EVENTS
    spans = logged_spans(tpg, log) if log.exists() else {}
    with Auditor(tpg, engine, wanted) as auditor:
        report = auditor.audit(
            recording, progress, ordered=ordered, finished=finished, spans=spans
        )
    efforts = efforts_of_run(replay)
    found = [
        *report.violations,
        *start_violations(replay),
        *limit_violations(replay),
        *effort_violations(replay, efforts),
        *tool_speed_violations(tool_speeds_of_run(replay)),
    ]
    if finished and wanted is not None:
        found += place_violations(replay, wanted)
        report = replace(report, helpers=helpers_left(replay, wanted))
    if ordered and spans:
        found += edge_violations(tpg, spans, _EVENTS)
        if finished and wanted is not None:
            found += rest_violations(tpg, replay, wanted, spans)
    greatest = tuple(greatest_efforts(tpg.cell, efforts))
    return replace(report, violations=_by_time(found), efforts=greatest)


class Auditor(AbstractContextManager["Auditor"]):
    """Audits any number of executions in one cell; a context manager.

    Args:
        tpg: says what stands in the cell, and who may touch whom.
        engine: to measure with; by default PyBullet where it is installed, else coal.
        wanted: what the scenario says of places and of what holds them; None where there is no
            scenario: what hangs, grips and supports are not looked at then.

    Raises:
        RequestError: the engine is not installed.
    """

    def __init__(
        self,
        tpg: TemporalPlanGraph,
        engine: Engine | None = None,
        wanted: Wanted | None = None,
    ) -> None:
        self._tpg, self._wanted = tpg, wanted
        self._rule = ContactRule(tpg, wanted)
        self._engine = engine_named(engine)
        self._world = open_world(tpg.cell, self._engine)
        self._exempt = overlapping_at_home(self._world)

    def __exit__(self, *error: object) -> None:
        """Let go of the engine's world."""
        self._world.close()

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

        The robots are moved along their straight joint-space lines. What lies between two
        configurations that were measured is bounded by how far joints can move anything there,
        and halved where that excludes nothing. A stretch in which nothing moves is looked at once.

        Args:
            recording: what was executed.
            progress: told how far the audit has come.
            within: robots further apart than this are not measured; the least distance in the
                report is at most this [m].
            ordered: whether type-2 edges had to be kept.
            finished: whether it came to its end, so that all processes must be done.
            spans: when nodes were started and completed, by robot or machine, where a log says so.
        """
        world, wanted, tpg = self._world, self._wanted, self._tpg
        replay = Replay(tpg.cell, recording)
        rule = self._rule.during(recording.robots)
        watch = _Watch(world, rule, self._exempt, within)
        for stretch in stretches(world, replay):
            watch.look(stretch)
            progress(AUDIT, float(stretch.t[-1]), recording.end)
        moved = moved_spans(tpg, recording.robots)
        found = [
            *joint_violations(recording.robots, world.limits),
            *jump_violations(world, replay),
        ]
        if wanted is not None:
            held = held_in_place(tpg, replay, wanted)
            found += hanging_violations(world, replay, wanted, held)
            found += grip_violations(world, replay, wanted)
            found += support_violations(world, tpg, replay, wanted, moved)
            found += tool_violations(world, replay, wanted)
            if finished:
                found += process_violations(world, tpg, replay, wanted, spans or {})
        if ordered:
            found += edge_violations(tpg, moved, "trajectory.parquet")
        return watch.report(engine_and_version(self._engine), found)


class _Watch:
    """Collects what is seen stretch by stretch."""

    def __init__(
        self,
        world: AuditWorld,
        rule: ContactRule,
        exempt: frozenset[tuple[int, int]],
        within: float,
    ) -> None:
        self._world, self._rule, self._exempt = world, rule, exempt
        self._least = self._bound = within
        self._configurations = 0
        self._samples = 0
        self._deepest_graze = 0.0
        # Deepest overlap of each pair by number of the sample: time [s], depth [m], links.
        self._overlaps: dict[tuple[str, str], dict[int, tuple[float, float, str]]] = {}

    def look(self, stretch: RunStretch) -> None:
        """Check one stretch."""
        moved = {
            tuple(int(r.distinct[k]) for r in stretch.robots)
            for k in range(len(stretch.t))
        }
        self._configurations += len(moved) - (self._samples > 0)
        holders = {name: p.holder for name, p in stretch.placements.items()}

        @cache
        def depth_at(first: str, second: str, sample: int) -> float:
            return self._rule.depth(first, second, holders, float(stretch.t[sample]))

        def depth(a: WatchedShape, b: WatchedShape, sample: int) -> float:
            return depth_at(a.entity, b.entity, sample)

        def meant(a: WatchedShape, b: WatchedShape, sample: int) -> bool:
            return depth(a, b, sample) > SLACK

        asked = Asked(lambda: self._least, depth, meant)
        for gap in gaps(self._world, stretch, self._exempt, asked):
            a, b = gap.first, gap.second
            robots = a.robot is not None and b.robot is not None and a.robot != b.robot
            if gap.between_robots:
                self._least = min(self._least, gap.distance)
                self._bound = min(self._bound, gap.bound)
            if gap.distance > 0.0:
                continue
            for sample in range(gap.sample, min(gap.until, len(stretch.t))):
                t, number = float(stretch.t[sample]), self._samples + sample
                limit = depth(a, b, sample)
                if not robots and self._rule.is_of_graze(limit):
                    self._deepest_graze = max(self._deepest_graze, -gap.distance)
                if robots or -gap.distance > limit:
                    seen = self._overlaps.setdefault((a.entity, b.entity), {})
                    if number not in seen or seen[number][1] < -gap.distance:
                        links = f"{a.detail} - {b.detail}"
                        seen[number] = (t, -gap.distance, links)
        self._samples += len(stretch.t)

    def report(self, engine: str, besides: Sequence[Violation] = ()) -> AuditReport:
        """Return everything seen so far, and what was found besides."""
        found = list(besides)
        for pair, seen in self._overlaps.items():
            numbers = np.array(sorted(seen))
            for run in np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1):
                rows = [seen[number] for number in run.tolist()]
                _, depth, detail = max(rows, key=itemgetter(1))
                found.append(Violation(rows[0][0], rows[-1][0], *pair, depth, detail))
        return AuditReport(
            self._configurations,
            self._least,
            self._bound,
            _by_time(found),
            engine,
            self._rule.tolerance,
            self._deepest_graze,
        )


def _by_time(found: Iterable[Violation]) -> tuple[Violation, ...]:
    return tuple(sorted(found, key=lambda v: (v.t_start, v.first, v.second)))

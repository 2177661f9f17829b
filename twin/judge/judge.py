"""Judgement of a plan that somebody else made: the audit, of the plan at its times and under delays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from planning.errors import OutputError, RequestError
from twin.audit.audit import audit_recording
from twin.audit.order import NodeSpans
from twin.audit.violation import Violation
from twin.audit.worlds.engines import (
    Engine,
    engine_and_version,
    engine_named,
    open_world,
)
from twin.host.guard import finite
from twin.host.progress import Report, report_nothing
from twin.judge.delays import CircularWaitsError, delayed_spans
from twin.judge.foreign_execution import (
    ForeignExecution,
    MotionSpan,
    execution,
    makespan_s,
    planned_spans,
)
from twin.judge.foreign_graph import cell_for, graph_of
from twin.judge.meant_contacts import meant_contacts
from twin.judge.open_plan import OpenPlan, read_open_plan
from twin.judge.work_rules import WorkRules
from twin.planning.build_workcell import build_workcell
from twin.planning.kind import assembly_kind
from twin.scenario.shipped import shipped_scenarios
from twin.trial.loaded_scenario import AnyScenario, LoadedScenario, load

DELAYED = "delays"
"""Name of the stage for progress displays."""


@dataclass(frozen=True)
class DelayedRun:
    """A plan as it was executed under delays.

    Attributes:
        seed: of the delays.
        makespan_s: end of the last motion [s].
        contacts: times that two things touched that may not.
        findings: all that the audit found.
    """

    seed: int
    makespan_s: float
    contacts: int
    findings: tuple[Violation, ...]


@dataclass(frozen=True)
class Judgement:
    """What the judge says of a plan.

    Attributes:
        scenario: name of the task.
        planner: who made the plan.
        planning_cpu_s: as its maker says [s].
        waits: whether it says what waits for what.
        planned_s: end of the last motion by its own times [s].
        findings: what is wrong with it at its own times.
        min_distance_m: least distance of two robots then [m].
        engine: that distances were measured with.
        delayed: as executed under delays, one a seed.
    """

    scenario: str
    planner: str
    planning_cpu_s: float | None
    waits: bool
    planned_s: float
    findings: tuple[Violation, ...]
    min_distance_m: float
    engine: str
    delayed: tuple[DelayedRun, ...] = ()

    @property
    def clean(self) -> bool:
        """Whether nothing is wrong with it, at its own times and under delays."""
        return not self.findings and not any(run.findings for run in self.delayed)

    @property
    def mean_s(self) -> float | None:
        """Mean makespan under delays [s]; None where there were none."""
        return float(np.mean(self._makespans)) if self.delayed else None

    @property
    def p95_s(self) -> float | None:
        """So long the plan takes under delays at most in 95 of 100 cases [s]."""
        return float(np.quantile(self._makespans, 0.95)) if self.delayed else None

    @property
    def contacts(self) -> int:
        """Contacts in all executions under delays."""
        return sum(run.contacts for run in self.delayed)

    @property
    def _makespans(self) -> list[float]:
        return [run.makespan_s for run in self.delayed]

    def content(self) -> dict[str, Any]:
        """Return the judgement for JSON."""
        return {
            "scenario": self.scenario,
            "planner": self.planner,
            "clean": self.clean,
            "waits": self.waits,
            "planned_s": self.planned_s,
            "mean_s": self.mean_s,
            "p95_s": self.p95_s,
            "contacts": self.contacts,
            "planning_cpu_s": self.planning_cpu_s,
            "min_distance_m": finite(self.min_distance_m),
            "engine": self.engine,
            "findings": [asdict(found) for found in self.findings],
            "delayed": [asdict(run) for run in self.delayed],
        }


def judge(
    plan: Path,
    scenario: AnyScenario | None = None,
    *,
    seeds: int = 5,
    engine: Engine | None = None,
    progress: Report = report_nothing,
) -> Judgement:
    """Judge an open plan, whoever made it.

    Args:
        plan: its file.
        scenario: its task; by default the one that the file names.
        seeds: how many executions under delays are looked at.
        engine: to measure with; by default PyBullet where it is installed, else coal.
        progress: told how far it has come.

    Raises:
        InvalidScenarioError: the file is no open plan, or does not fit its scenario.
        RequestError: nothing says which scenario; the engine is not installed.
    """
    content = read_open_plan(plan)
    task = load(scenario_of(content, plan) if scenario is None else scenario)
    case = JudgedPlan(content, plan, task, engine)
    own = planned_spans(content)
    findings, least = case.look(own, progress)
    try:
        runs = []
        for seed in range(seeds):
            spans = delayed_spans(content, case.rules.stretch, seed)
            runs.append(case.delayed(seed, spans))
            progress(DELAYED, seed + 1, seeds)
    except CircularWaitsError as error:
        found = Violation(0.0, 0.0, "plan", "after", 0.0, error.message, "edge-order")
        findings, runs = (*findings, found), []
    return Judgement(
        task.name,
        content.planner,
        content.planning_cpu_s,
        content.waits,
        makespan_s(content, own),
        tuple(findings),
        least,
        engine_and_version(case.engine),
        tuple(runs),
    )


def scenario_of(content: OpenPlan, path: Path) -> Path:
    """Return the scenario that a plan names: one that comes with the program, or a file seen from its own.

    Raises:
        RequestError: it names none.
    """
    named = content.scenario
    if named is None:
        raise RequestError(
            f"{path}: names no scenario; give one with --scenario",
            choices=tuple(shipped_scenarios()),
        )
    beside = path.parent / named
    return beside if beside.is_file() else Path(named)


class JudgedPlan:
    """An open plan with all that it is judged by.

    Args:
        plan: the plan.
        path: its file.
        scenario: its task.
        engine: to measure with.

    Attributes:
        plan: see there.
        engine: that distances are measured with.
        rules: how fast and for how long robots work.
        world: the cell as it is measured in.

    Raises:
        InvalidScenarioError: the plan does not fit the scenario.
    """

    def __init__(
        self,
        plan: OpenPlan,
        path: Path,
        scenario: LoadedScenario,
        engine: Engine | None = None,
    ) -> None:
        sections, self.plan = scenario.sections, plan
        self.engine = engine_named(engine)
        kind = assembly_kind(sections.assembly)
        self._wanted = kind.wanted(sections.cell)
        cell = build_workcell(sections, scenario.folder)
        there = {item.name for item in cell.objects}
        more = (o for o in kind.all_objects(scenario.folder) if o.name not in there)
        cell = replace(cell, objects=(*cell.objects, *more))
        cell = cell_for(plan, path, cell, sections.assembly)
        self.rules = WorkRules(sections, scenario.folder, cell)
        bare = graph_of(plan, cell)
        self.world = open_world(cell, self.engine)
        tools = self._wanted.tools
        planned = execution(plan, self.world, tools, planned_spans(plan))
        allowed = meant_contacts(plan, bare, self.world, planned, self._wanted)
        self._graph = replace(bare, allowed=allowed)

    def executed(self, spans: Mapping[str, MotionSpan]) -> ForeignExecution:
        """Return what is executed where motions happen at some times."""
        return execution(self.plan, self.world, self._wanted.tools, spans)

    def look(
        self, spans: Mapping[str, MotionSpan], progress: Report = report_nothing
    ) -> tuple[tuple[Violation, ...], float]:
        """Return what is wrong with an execution, by time, and the least distance of two robots [m]."""
        done = self.executed(spans)
        own = [*done.violations, *self.rules.violations(self.plan, spans)]
        try:
            report = audit_recording(
                self._graph,
                done.recording,
                progress,
                engine=self.engine,
                wanted=self._wanted,
                spans=self._node_spans(spans),
            )
        except OutputError as error:  # nobody can look at what is as fast as that
            words = error.message
            own.append(
                Violation(
                    0.0, done.recording.end, "plan", "", 0.0, words, "joint-speed"
                )
            )
            return tuple(own), np.inf
        found = [*own, *report.violations]
        found.sort(key=lambda v: (v.t_start, v.first, v.second))
        return tuple(found), report.min_distance_m

    def delayed(self, seed: int, spans: Mapping[str, MotionSpan]) -> DelayedRun:
        """Return an execution under delays."""
        found, _ = self.look(spans)
        contacts = sum(violation.kind == "contact" for violation in found)
        return DelayedRun(seed, makespan_s(self.plan, spans), contacts, found)

    def _node_spans(self, spans: Mapping[str, MotionSpan]) -> dict[str, NodeSpans]:
        return {
            name: NodeSpans(
                np.array([spans[motion.id].begin for motion in some]),
                np.array([spans[motion.id].end(motion) for motion in some]),
            )
            for name, some in self.plan.motions.items()
        }

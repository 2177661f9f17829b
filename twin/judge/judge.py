"""Assessment of a plan from another planner: audits of its motions at planned times and with random delays."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from planning.cell.workcell import Workcell
from planning.errors import OutputError, RequestError
from planning.tasks.task import TaskKind
from twin.audits.audit import audit_recording
from twin.audits.case import NodeSpans, Violation
from twin.audits.expectations import scenario_expectations
from twin.audits.worlds.engines import (
    Engine,
    engine_and_version,
    engine_named,
)
from twin.audits.worlds.world import AuditWorld
from twin.durations.model import DurationModel
from twin.host.atomic_files import finite_or_none
from twin.host.progress import Report, report_nothing
from twin.judge.delays import CircularWaitsError, delayed_spans
from twin.judge.intended_contacts import intended_contacts
from twin.judge.open_plan import OpenMotion, OpenPlan, read_open_plan
from twin.judge.open_plan_cell import cell_for
from twin.judge.open_plan_execution import (
    MotionSpan,
    OpenPlanExecution,
    build_open_plan_execution,
    makespan_s,
    planned_spans,
)
from twin.judge.open_plan_graph import build_open_plan_graph
from twin.planning.build_workcell import build_workcell
from twin.scenario.sections.kind import assembly_kind
from twin.scenario.sections.scenario import Scenario
from twin.scenario.shipped import shipped_scenarios
from twin.trial.loaded_scenario import AnyScenario, LoadedScenario, load
from twin.trial.simulation import skill_durations

DELAYED = "delays"
"""Name of the stage for progress displays."""

_ROUNDING = 1e-6
"""Share of a limit by which it may be exceeded."""

_SKILLS_OF_TRANSFER = {
    "take": ("pick", "handover", TaskKind.TAKE_TOOL),
    "put": ("place-down", "place-up", TaskKind.LEAVE_TOOL),
    "give": ("handover",),
}
"""Skills that may contain each kind of transfer; the first one is assumed where a motion names another."""


@dataclass(frozen=True)
class DelayedRun:
    """A plan as it was executed under delays.

    Attributes:
        seed: of the delays.
        makespan_s: end of the last motion [s].
        contacts: number of forbidden contacts.
        findings: all findings of the audit.
    """

    seed: int
    makespan_s: float
    contacts: int
    findings: tuple[Violation, ...]


@dataclass(frozen=True)
class Judgement:
    """Result of judging a plan.

    Attributes:
        scenario: name of the task.
        planner: name of the planner.
        planning_cpu_s: CPU time of planning, as the plan states it [s].
        waits: whether the plan states which motions wait for which.
        planned_s: end of the last motion at its planned times [s].
        findings: violations at its planned times.
        min_distance_m: least distance of two robots at its planned times [m].
        engine: engine that measured the distances.
        delayed: executions under delays, one for each seed.
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
        """Whether it has no violations, at its planned times and under delays."""
        return not self.findings and not any(run.findings for run in self.delayed)

    @property
    def mean_s(self) -> float | None:
        """Mean makespan under delays [s]; None where there were none."""
        return float(np.mean(self._makespans)) if self.delayed else None

    @property
    def p95_s(self) -> float | None:
        """95th percentile of the makespan under delays [s]."""
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
            "min_distance_m": finite_or_none(self.min_distance_m),
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
    """Judge an open plan of any planner.

    Args:
        plan: its file.
        scenario: its task; by default the one that the file names.
        seeds: number of executions under delays.
        engine: engine that measures distances; by default PyBullet where it is installed, else coal.
        progress: receives the progress.

    Raises:
        InvalidScenarioError: the file is no open plan, or does not fit its scenario.
        RequestError: nothing says which scenario; the engine is not installed.
    """
    content = read_open_plan(plan)
    task = load(named_scenario(content, plan) if scenario is None else scenario)
    case = JudgedPlan(content, plan, task, engine)
    own = planned_spans(content)
    findings, least = case.audit_spans(own, progress)
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


def named_scenario(content: OpenPlan, path: Path) -> Path:
    """Return the scenario that a plan names: a shipped one, or a file relative to the plan's.

    Raises:
        RequestError: it names none.
    """
    named = content.scenario
    if named is None:
        raise RequestError(
            f"{path}: names no scenario; give one with --scenario",
            choices=tuple(shipped_scenarios()),
        )
    sibling = path.parent / named
    return sibling if sibling.is_file() else Path(named)


class JudgedPlan:
    """An open plan with the data for judging it.

    Args:
        plan: the plan.
        path: its file.
        scenario: its task.
        engine: engine that measures distances.

    Attributes:
        plan: the plan.
        engine: engine that measures distances.
        rules: limits of speeds and durations.
        world: the cell in which distances are measured.

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
        self._wanted = scenario_expectations(sections)
        cell = build_workcell(sections, scenario.folder)
        there = {item.name for item in cell.objects}
        more = (
            o
            for o in kind.written_out().objects(scenario.folder)
            if o.name not in there
        )
        cell = replace(cell, objects=(*cell.objects, *more))
        cell = cell_for(plan, path, cell, sections.assembly)
        self.rules = WorkRules(sections, scenario.folder, cell)
        bare = build_open_plan_graph(plan, cell)
        self.world = AuditWorld(cell)
        tools = self._wanted.tools
        planned = build_open_plan_execution(
            plan, self.world, tools, planned_spans(plan)
        )
        allowed = intended_contacts(plan, bare, self.world, planned, self._wanted)
        self._graph = replace(bare, allowed=allowed)

    def executed(self, spans: Mapping[str, MotionSpan]) -> OpenPlanExecution:
        """Return the execution with given times of motions."""
        return build_open_plan_execution(
            self.plan, self.world, self._wanted.tools, spans
        )

    def audit_spans(
        self, spans: Mapping[str, MotionSpan], progress: Report = report_nothing
    ) -> tuple[tuple[Violation, ...], float]:
        """Return the violations of an execution, by time, and the least distance of two robots [m]."""
        done = self.executed(spans)
        own = [*done.violations, *self.rules.violations(self.plan, spans)]
        taken = {
            name: NodeSpans(
                np.array([spans[motion.id].begin for motion in some]),
                np.array([spans[motion.id].end(motion) for motion in some]),
            )
            for name, some in self.plan.motions.items()
        }
        try:
            report = audit_recording(
                self._graph,
                done.recording,
                progress,
                engine=self.engine,
                wanted=self._wanted,
                spans=taken,
            )
        except OutputError as error:  # too fast to be sampled
            words = error.message
            end = done.recording.end
            own.append(Violation(0.0, end, "plan", "", 0.0, words, "joint-speed"))
            return tuple(own), np.inf
        found = [*own, *report.violations]
        found.sort(key=lambda v: (v.t_start, v.first, v.second))
        return tuple(found), report.min_distance_m

    def delayed(self, seed: int, spans: Mapping[str, MotionSpan]) -> DelayedRun:
        """Return an execution under delays."""
        found, _ = self.audit_spans(spans)
        contacts = sum(violation.kind == "contact" for violation in found)
        return DelayedRun(seed, makespan_s(self.plan, spans), contacts, found)


class WorkRules:
    """Speed limits and least durations of motions, as a scenario states them.

    Args:
        scenario: the scenario.
        folder: base of relative paths in it.
        cell: its cell.
    """

    def __init__(self, scenario: Scenario, folder: Path, cell: Workcell) -> None:
        self._durations = skill_durations(scenario, folder)
        self._kinds = {item.name: item.kind for item in cell.objects}
        self._sum = None
        if scenario.speed_model == "l1":
            self._sum = scenario.planning.l1_rad_s

    def stretch(self, name: str, motion: OpenMotion, u: float) -> float | None:
        """Return the stretch factor of a skill's motion at a quantile; None for a motion without a skill."""
        model = next(iter(self._skill_models(name, [motion]).values()), None)
        if model is None or model.mean <= 0.0:
            return None
        return float(model.ppf(np.array([u]))[0] / model.mean)

    def violations(
        self, plan: OpenPlan, spans: Mapping[str, MotionSpan]
    ) -> Iterator[Violation]:
        """Yield motions that are too fast, skills that are too short, and missed waits.

        Args:
            plan: the executed plan.
            spans: times of its motions, by id.
        """
        ends = {
            motion.id: spans[motion.id].end(motion) for _, _, motion in plan.placed()
        }
        for _, name, motion in plan.placed():
            begin = spans[motion.id].begin
            for other in motion.after:
                if begin < ends[other] - _ROUNDING:
                    words = f"{motion.id} begins before {other} is over, {ends[other] - begin:.6g} s later"
                    yield Violation(
                        begin, ends[other], name, other, 0.0, words, "edge-order"
                    )
            if name in plan.robots and self._sum is not None and not motion.skill:
                yield from self._too_fast(name, motion, spans[motion.id], self._sum)
        for name, some in plan.motions.items():
            for _, group in groupby(some, lambda motion: motion.task or motion.id):
                yield from self._too_short(name, list(group), spans)

    def _skill_models(
        self, name: str, group: Sequence[OpenMotion]
    ) -> dict[str, DurationModel]:
        """Return the duration models of the skills in consecutive motions, by name: named ones and transfers."""
        found: dict[str, DurationModel] = {}
        for motion in group:
            done = [(motion.skill, motion.object)]
            for event in motion.events:
                called = _SKILLS_OF_TRANSFER.get(event.verb, (motion.skill,))
                if motion.skill not in called:
                    done.append((called[0], event.object))
            for skill, thing in done:
                kind = self._kinds.get(thing or "")
                model = skill and self._durations.model_of(skill, name, kind)
                if skill and model:
                    found.setdefault(skill, model)
        return found

    def _too_fast(
        self, name: str, motion: OpenMotion, span: MotionSpan, limit: float
    ) -> Iterator[Violation]:
        if motion.v is not None or len(motion.t_s) < 2:
            return
        seconds = np.diff(motion.t_s) * span.factor
        displacement = np.abs(np.diff(np.array(motion.q), axis=0)).sum(axis=1)
        over = displacement - limit * (seconds * (1.0 + _ROUNDING) + 1e-8)
        worst = int(np.argmax(over))
        if over[worst] > 0.0:
            t = (
                span.at(motion, motion.t_s[worst]),
                span.at(motion, motion.t_s[worst + 1]),
            )
            speed = displacement[worst] / max(seconds[worst], 1e-9)
            words = f"{speed:.6g} rad/s for all joint speeds added up, their limit is {limit:g} rad/s, in {motion.id}"
            yield Violation(*t, name, "all joints", 0.0, words, "joint-speed")

    def _too_short(
        self, name: str, group: list[OpenMotion], spans: Mapping[str, MotionSpan]
    ) -> Iterator[Violation]:
        works = self._skill_models(name, group)
        least = sum(model.mean for model in works.values())
        took = sum((m.t_s[-1] - m.t_s[0]) * spans[m.id].factor for m in group)
        if took < least * (1.0 - _ROUNDING) - 1e-6:
            begin, end = spans[group[0].id].begin, spans[group[-1].id].end(group[-1])
            skill = " and ".join(works)
            words = f"{group[0].id}: {skill} takes {took:.6g} s, and the task says {least:.6g} s"
            yield Violation(begin, end, name, skill, 0.0, words, "duration")

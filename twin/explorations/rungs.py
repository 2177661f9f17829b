"""Evaluation of a cell design in steps of increasing cost: checks, reachability, plan, full plan and replications.

Each step is called a rung. A design that fails a rung is not evaluated further.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from planning.errors import TwinError, join_lines
from scheduling.graph.rollout import earliest_times
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.planned_motions import PlannedMotions
from twin.checks.check import findings_without_reach, reach_findings
from twin.checks.finding import CheckContext, Finding
from twin.checks.picture import cell_shapes
from twin.explorations.expressions import ExpressionError, KeyValue
from twin.explorations.keys import resolved_value
from twin.explorations.section import ExploreSection
from twin.host.progress import StageWatch
from twin.planning.pipeline import build_plan_graph, plan_motions
from twin.reading.checks import find_problems
from twin.scenario.sections.scenario import Scenario, resolve_scenario
from twin.scenario.variations import Variant, apply_variation, layout_of
from twin.studies.plans import workload
from twin.studies.replications.experiment import Block
from twin.studies.replications.workload import Engines, Workload, pack_workload
from twin.trial.loaded_scenario import LoadedScenario
from twin.trial.plan_result import PlanResult
from twin.trial.planning import plan_until_final
from twin.trial.simulation import scenario_execution

CHECK, REACH, PLAN, FULL, REPLICATIONS = RUNGS = (
    "check",
    "reach",
    "plan",
    "full plan",
    "replications",
)
"""Rungs, in their order."""

CONSTRAINT = "constraints"
"""Where a design that passed all rungs may still be refused."""

Outcome = Literal["done", "refused", "behind"]


@dataclass(frozen=True)
class ExplorationSetting:
    """Common setting of all designs of an exploration.

    Attributes:
        scenario: as it is.
        folder: where relative paths in it start.
        section: the goals.
    """

    scenario: Scenario
    folder: Path
    section: ExploreSection


@dataclass(frozen=True)
class Evaluation:
    """Evaluation of a design.

    Attributes:
        outcome: ``done`` where it passed all rungs and constraints; ``refused``; or ``behind``, where its
            plan without shortcuts was so long that it cannot be the best.
        rung: the last one that it came to.
        reason: why it is refused or behind.
        violation: how far it is from being possible, 0 if it is: rungs that it did not pass, and a share.
        results: its results, by the names of twin.explorations.section.
        goals: values of the goals, each as something to be small; empty where it is not done.
        turns_s: makespan of its plan without shortcuts, NaN where there is none, or of one product of several [s].
        makespans_s: of its replications, NaN where one did not complete [s].
        cpu_s: processor time of each rung [s].
        packed_workload: the workload of its plan, packed, for more replications.
    """

    outcome: Outcome
    rung: str
    reason: str = ""
    violation: float = 0.0
    results: Mapping[str, float] = field(default_factory=dict)
    goals: tuple[float, ...] = ()
    turns_s: float = np.nan
    makespans_s: tuple[float, ...] = ()
    cpu_s: Mapping[str, float] = field(default_factory=dict)
    packed_workload: bytes = b""


def refused_evaluation(
    rung: str, reason: str, share: float = 0.5, **known: Any
) -> Evaluation:
    """Return the evaluation of a design that did not pass a rung.

    Args:
        rung: which.
        reason: why.
        share: of the rung that it did not pass, within 0 and 1.
        known: its results so far.
    """
    left = len(RUNGS) - RUNGS.index(rung) if rung in RUNGS else 0
    return Evaluation("refused", rung, join_lines(reason), left + share, **known)


class RefusedError(Exception):
    """A design that does not pass a rung."""

    def __init__(self, reason: str, share: float = 0.5) -> None:
        super().__init__(reason)
        self.share = share


class RungClimb:
    """Evaluation of one design through the rungs.

    Args:
        setting: of the exploration.
        variant: changes of the design to the scenario.
        longest_turns_s: a plan without shortcuts that is longer is behind [s].
        planner_seed: in place of the scenario's; draws stay those of the scenario.
        began: called at the start of each rung.
    """

    def __init__(
        self,
        setting: ExplorationSetting,
        variant: Variant,
        longest_turns_s: float = np.inf,
        planner_seed: int | None = None,
        *,
        began: Callable[[str], None] = lambda rung: None,
    ) -> None:
        self._setting, self._variant = setting, variant
        self._planner_seed = planner_seed
        self._longest_turns_s, self._began = longest_turns_s, began
        self._rung, self._since = CHECK, time.process_time()
        self._cpu_s = dict[str, float]()
        self._known: dict[str, Any] = {"cpu_s": self._cpu_s}

    def evaluate(self) -> Evaluation:
        """Evaluate the design rung by rung, up to the first refusal."""
        try:
            return self._climb()
        except RefusedError as error:
            return refused_evaluation(
                self._rung, str(error), error.share, **self._known
            )
        except TwinError as error:
            return refused_evaluation(self._rung, str(error), **self._known)
        except Exception as error:  # one of many designs: the others continue
            words = f"a fault of the program: {type(error).__name__}: {error}"
            return refused_evaluation(self._rung, words, **self._known)
        finally:
            self._end()

    def _begin(self, rung: str) -> None:
        self._end()
        self._rung, self._since = rung, time.process_time()
        self._began(rung)

    def _end(self) -> None:
        """Record the time of the rung so far."""
        self._cpu_s[self._rung] = time.process_time() - self._since

    def _climb(self) -> Evaluation:
        setting, section = self._setting, self._setting.section
        self._begin(CHECK)
        own = apply_variation(setting.scenario, self._variant)
        subject = CheckContext(own, setting.folder)
        for _, message in find_problems(own, setting.folder):
            raise RefusedError(message, 1.0)
        results = layout_results(subject, section)
        self._known["results"] = results
        quick = findings_without_reach(subject)
        _require_none(quick)
        self._begin(REACH)
        _require_none(reach_findings(subject, quick))
        self._begin(PLAN)
        layout, part = own, layout_of(self._variant)
        if part != self._variant:
            layout = apply_variation(setting.scenario, part)
        if self._planner_seed is not None:
            layout = layout.changed(seed=self._planner_seed)
        _, turns = _motions(Planned(layout, setting.folder))
        if turns is not None and own.kind.products() == 1:  # it is that of one product
            turns_s = float(earliest_times(turns).makespan)
            self._known["turns_s"] = turns_s
            if turns_s > self._longest_turns_s:
                words = (
                    f"without shortcuts {turns_s:.1f} s: even if these gained more than they ever"
                    f" did, it would not be the best (at most {self._longest_turns_s:.1f} s)"
                )
                return Evaluation("behind", PLAN, words, **self._known)
        self._begin(FULL)
        plan = _full_plan(Planned(layout, setting.folder))
        results["makespan_s"] = plan.makespan_s
        load = _work(own, setting.folder, plan)
        self._known["packed_workload"] = pack_workload(load)
        self._begin(REPLICATIONS)
        if section.replicates:
            # All designs see the same draws in a replication of the same number.
            block = Block(0, 0, section.replications)
            found = Engines(load).compute(block).rows.makespans_s()
            self._known["makespans_s"] = tuple(found.tolist())
            if not np.isfinite(found).any():
                raise RefusedError("no replication completes")
            results |= replicated_results(own, section, found)
        return complete_evaluation(keys_of(own), section, **self._known)


def keys_of(scenario: Scenario) -> KeyValue:
    """Return what gives the values of keys of a scenario, which is resolved once, and only if one is asked for."""
    content = cache(lambda: resolve_scenario(scenario))
    return lambda name: resolved_value(content(), name)


def complete_evaluation(
    key: KeyValue, section: ExploreSection, **known: Any
) -> Evaluation:
    """Return a complete evaluation, with goals, or with violated constraints.

    Args:
        key: gives the values of keys of the design.
        section: the goals.
        known: of its evaluation, with ``results``.
    """
    results = known["results"]
    missed, over = [], 0.0
    try:
        goals = tuple(
            goal.sign * goal.expression.value(results, key) for goal in section.goals
        )
        for one in section.inequalities:
            if excess := one.excess(results, key):
                missed.append(one)
                over += excess
    except ExpressionError as error:
        return refused_evaluation(CONSTRAINT, str(error), 0.99, **known)
    if missed:
        words = ", ".join(f"not {one.text}" for one in missed)
        named = [k for k in results if any(k in one.used for one in missed)]
        at = ", ".join(f"{k} = {results[k]:.6g}" for k in named)
        detail = f"{words} ({at})" if at else words
        return refused_evaluation(CONSTRAINT, detail, over / (1.0 + over), **known)
    return Evaluation("done", REPLICATIONS, goals=goals, **known)


def _require_none(findings: list[Finding]) -> None:
    """Refuse a design with errors of a check; their number is its distance from feasibility."""
    errors = [item.message for item in findings if item.error]
    if errors:
        more = f" (and {len(errors) - 1} more)" if len(errors) > 1 else ""
        raise RefusedError(errors[0] + more, len(errors) / (1.0 + len(errors)))


@dataclass(frozen=True)
class Planned:
    """A layout to plan; equal ones are planned once."""

    scenario: Scenario
    folder: Path

    def __hash__(self) -> int:
        return hash(str(self.folder))


@lru_cache(maxsize=2)
def _motions(wanted: Planned) -> tuple[PlannedMotions, TemporalPlanGraph | None]:
    """Return the motions of a layout, and its sequential plan."""
    scenario, watch = wanted.scenario, StageWatch()
    motions = plan_motions(scenario, wanted.folder, watch)
    if scenario.planning.coordination == "synchronous":
        return motions, None
    return motions, build_plan_graph(motions.motion_plan, watch)


@lru_cache(maxsize=2)
def _full_plan(wanted: Planned) -> PlanResult:
    motions, _ = _motions(wanted)
    case = LoadedScenario(wanted.scenario, wanted.folder)
    return plan_until_final(case, motions=motions)


def _work(scenario: Scenario, folder: Path, plan: PlanResult) -> Workload:
    model = scenario_execution(scenario, folder)
    reasons = tuple(scenario.execution.needs_event_engine())
    return replace(workload(plan.tpg, model, scenario.seed), reasons=reasons)


def layout_results(subject: CheckContext, section: ExploreSection) -> dict[str, float]:
    """Return the results of a design before planning."""
    robots = subject.scenario.cell.robots
    price = sum(
        section.prices.get(name, 0.0)
        for robot in robots
        for name in (robot.model, robot.tool, *robot.tools)
        if name is not None
    )
    return {
        "robots": float(len(robots)),
        "price": float(price),
        "floor_area_m2": floor_area_m2(subject),
    }


def floor_area_m2(subject: CheckContext) -> float:
    """Return the area of the convex hull of a cell, seen from above [m2].

    That is robots at HOME, the fixtures of the file, and objects where they begin.
    """
    corners = [shape.corners for shape in cell_shapes(subject)]
    try:
        return float(ConvexHull(np.concatenate(corners)[:, :2]).volume)
    except (QhullError, ValueError):  # nothing, or all in a line
        return 0.0


def replicated_results(
    scenario: Scenario, section: ExploreSection, makespans_s: np.ndarray[Any, Any]
) -> dict[str, float]:
    """Return the results of replications of a design."""
    known = makespans_s[np.isfinite(makespans_s)]
    mean = float(np.mean(known))
    found = {
        "mean_s": mean,
        "p50_s": float(np.quantile(known, 0.5, method="inverted_cdf")),
        "p90_s": float(np.quantile(known, 0.9, method="inverted_cdf")),
        "failed": 1.0 - len(known) / len(makespans_s),
        "throughput_per_h": 3600.0 * scenario.kind.products() / mean,
    }
    if section.deadline_s is not None:
        late = ~(makespans_s <= section.deadline_s)  # what does not end is late
        found["late"] = float(np.mean(late))
    return found

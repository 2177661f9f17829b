"""Planning of a scenario: all stages in order, with optional improvements of the plan."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from planning.errors import PlanInvariantError, ScenarioError
from planning.tasks.task import TaskKind
from scheduling.build_nodes import build_nodes
from scheduling.conflicts.derived_tpg import OccupantConflicts
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.planned_motions import PlannedMotions
from twin.host.progress import Report, StageWatch, report_nothing
from twin.planning.assignment_gain import AssignmentGain
from twin.planning.idle_robots import find_idle_robots
from twin.planning.pipeline import (
    MOST_CANDIDATES,
    build_plan_graph,
    plan_motions,
    plan_synchronously,
    planned_shortcuts,
    planned_sidesteps,
    shorten_plan,
    wanted_steps,
)
from twin.planning.repetition import plans_of_all_products
from twin.planning.time_parameterization import time_parameterize
from twin.registry import HOOKS
from twin.runs.policies import (
    AT_ONCE,
    IN_SLOTS,
    IN_TURNS,
    SHORTENED,
    SLOTS_SHORTENED,
    WHOLE_PLANS,
)
from twin.scenario.sections.kind import assembly_kind
from twin.scenario.sections.scenario import Scenario
from twin.trial.loaded_scenario import LoadedScenario
from twin.trial.plan_result import PlanResult

if TYPE_CHECKING:
    from planning.tasks.assembly import Assembly
    from planning.tasks.assignment import TaskPlan
    from scheduling.ordering.plan_rating import PlanRater, RatedPlan

CREWS, SEARCH = "who takes part", "shorter assignment"
"""Names of the stages for progress displays."""

_NEAR = 0.05
"""Share of the makespan within which shortcuts may turn the ranks of the plans of two crews."""

_LEAST_GAIN = 0.01
"""Least share by which an assignment must be predicted to end sooner for its motions to be planned."""

_FEWEST_OF_GROUP = 400
"""Fewest shortcuts tried on the plan of a group of products, of those that all groups share."""

_MOST_PLANS = 100
"""Most times that a scenario is planned where plans revise it."""

_NO_SKILLS = {
    TaskKind.TRANSIT,
    TaskKind.STRAIGHT,
    TaskKind.LEAVE_TOOL,
    TaskKind.TAKE_TOOL,
    *TaskKind.SUPPLY,
}

LOSES = 0.2
"""Share of failed attempts that lose the object, where only a failure rate is given; synthetic."""


class PlanStart(Protocol):
    """Where a plan begins, if not with all robots at HOME and all objects at their starts."""

    @property
    def steps(self) -> int:
        """Number of first steps that must be planned."""
        ...

    def continue_with(self, motions: PlannedMotions) -> TemporalPlanGraph:
        """Return the plan of what is left.

        Args:
            motions: of a plan from the beginning.

        Raises:
            RequestError: a robot cannot continue, or nothing is left.
        """
        ...


def plan_scenario(
    scenario: Scenario | LoadedScenario,
    folder: Path = Path(),
    progress: Report = report_nothing,
    *,
    start: PlanStart | None = None,
    keep: bool = False,
    wanted: Collection[str] = (),
    candidates: int = 0,
    motions: PlannedMotions | None = None,
    bound: bool = False,
    clock: Callable[[], float] = time.perf_counter,
) -> PlanResult:
    """Plan a scenario from the cell to the temporal plan graph.

    The seconds of its stages are sequence (where the scenario gives a structure), assignment,
    motion, assignment_search (where it is searched), synchronous (where the plan is made in slots),
    tpg; of a construction checks, search, keyframes, path, tpg.

    Args:
        scenario: a checked scenario.
        folder: where relative paths in it start, that of its file; known of one that was loaded.
        progress: receives the progress of each stage.
        start: where the plan begins; by default with all robots at HOME.
        keep: keep what other plans can be made from: every product is planned by itself, and no more
            than what is wanted, or what the window of the scenario says.
        wanted: names in twin.runs.policies of plans to make from the same motions, in place of the one
            that the scenario says.
        candidates: shortcuts tried on each wanted plan.
        motions: result of ``plan_motions``, where it exists already.
        bound: work out the lower bound of the makespan over all assignments.
        clock: returns the time that stages and ``planning.shortcut_s`` are measured by, wall-clock
            by default [s].

    Raises:
        RobotModelError: a robot description cannot be used.
        ConstructionError: a construction for which no plan was found.
        InfeasibleStepError: a step that no robot, brick and grasp can do.
        TransitError: no collision-free path was found.
        RequestError: see PlanStart, and plan_motions for what is kept.
        PlanInvariantError: the plan breaks a guarantee, which is a fault of this program.
    """
    case, watch = scenario, StageWatch(progress, clock=clock)
    if not isinstance(case, LoadedScenario):
        case = LoadedScenario(case, folder)
    if keep and case.sections.kind.rush_s():
        case = case.varied({"assembly.products.rush_after": []})
    sections = case.sections
    whole, window = keep or start is not None, sections.execution.step_window
    if motions is None:
        first = None
        if keep and window is not None:
            first = window.first
        elif whole:
            first = wanted_steps(sections, 0 if start is None else start.steps)
        motions = plan_motions(sections, case.folder, watch, whole=whole, first=first)
    if start is not None:
        with watch.stage("motion"):
            tpg = start.continue_with(motions)
        name = SHORTENED if planned_shortcuts(sections) else IN_TURNS
        return PlanResult(case, tpg, name, planning_s=watch.seconds)
    if keep and window is not None:
        # Shortened as much as the steps that come after them will be.
        most = sections.execution.recovery.shortcuts
        return _coordinated(case, motions, watch, most)
    most = MOST_CANDIDATES
    grouped = motions.further and len(sections.kind.product_ends()) == 1
    if grouped and sections.planning.shortcut_candidates == "auto":
        # Groups of products are large, and share the candidates.
        shared = planned_shortcuts(sections) // (1 + len(motions.further))
        most = max(shared, _FEWEST_OF_GROUP)
    if wanted:
        return _wanted(case, motions, watch, wanted, min(candidates, most))
    plan = _shortest(case, motions, watch, most)
    if keep:
        return plan
    used = plan.motions
    # What other plans can be made from is no longer needed, and cannot be saved.
    plan = replace(plan, made_of=replace(used, work=None, further=()))
    if sections.kind.products() > 1:
        further = [_shortest(case, other, watch, most) for other in motions.further]
        return _of_all_products([plan, *further], watch)
    if not bound or used.work is None or "makespan bound" not in HOOKS:
        return plan
    least = HOOKS.load("makespan bound")
    found = least(used.cell, used.work, used.task_plan, used.settings)
    return replace(plan, makespan_bound_s=found)


def plan_until_final(case: LoadedScenario, **how: Any) -> PlanResult:
    """Plan a scenario as ``plan_scenario`` does, and again as long as ``AssemblyKind.revised_section`` revises it."""
    for _ in range(_MOST_PLANS):
        made = plan_scenario(case, **how)
        section = made.scenario.sections.kind.revised_section(made.tpg)
        if section is None:
            break
        case = made.scenario.with_assembly(section)
        how.pop("motions", None)
    return made


def _wanted(
    case: LoadedScenario,
    motions: PlannedMotions,
    watch: StageWatch,
    wanted: Collection[str],
    candidates: int,
) -> PlanResult:
    """Return plans by their names for all products, from the motions of the best subset of robots."""
    needed = {*wanted, *(WHOLE_PLANS.get(name) for name in wanted)}
    order = (IN_TURNS, IN_SLOTS, *WHOLE_PLANS)
    units = []
    for unit in (motions, *motions.further):
        promising = _promising_motions(case.sections, unit, watch)
        best = promising.motions[0]
        if len(promising.motions) > 1:
            best = _best_coordinated(case, promising, watch, MOST_CANDIDATES).motions
        made = CoordinatedPlans(
            best, case.sections, lambda: watch, candidates=candidates
        )
        units.append({name: made[name] for name in order if name in needed})
    found = plans_of_all_products(units, case.sections.kind, watch)
    plans = {name: plan for name, plan in found.items() if name in wanted}
    name, tpg = list(plans.items())[-1]
    return PlanResult(case, tpg, name, planning_s=watch.seconds, plans=plans)


def with_failures(
    case: LoadedScenario, tpg: TemporalPlanGraph, chance: float
) -> LoadedScenario:
    """Return a scenario where attempts at every skill of a plan fail with a probability.

    Args:
        case: the scenario; its own failure rates are kept.
        tpg: the plan.
        chance: that an attempt fails.
    """
    skills = {task.kind for task in tpg.tasks} - _NO_SKILLS
    said = case.sections.execution.failures
    return case.varied(
        {
            f"failures.{skill}": {
                "probability": chance,
                "loses": LOSES if skill in TaskKind.HANDLING else 0.0,
            }
            for skill in sorted(skills - said.keys())
        }
    )


def _shortest(
    case: LoadedScenario, motions: PlannedMotions, watch: StageWatch, most: int
) -> PlanResult:
    """Return the shortest plan over assignments and subsets of robots, for the planned products."""
    promising = _promising_motions(case.sections, motions, watch)
    plan, searched = _best_coordinated(case, promising, watch, most), promising.searched
    idle = find_idle_robots(plan.tpg, motions, case.sections.kind)
    if searched is None:
        return replace(plan, idle=idle)
    taken = plan.motions is not motions and plan.motions.task_plan == searched.plan
    return replace(plan, idle=idle, search=replace(searched.gain, taken=taken))


def _best_coordinated(
    case: LoadedScenario, promising: _Promising, watch: StageWatch, most: int
) -> PlanResult:
    """Return the shortest of the plans of promising motions."""
    first, *others = promising.motions
    plan = _coordinated(case, first, watch, most, promising.conflicts)
    for other in others:
        plan = _shorter(plan, other, watch, most)
    return plan


def _shorter(
    plan: PlanResult, motions: PlannedMotions, watch: StageWatch, most: int
) -> PlanResult:
    """Return the plan of other motions if its makespan is shorter, else the given one."""
    try:
        other = _coordinated(plan.scenario, motions, watch, most)
    except PlanInvariantError:  # no reason to go without the plan that holds
        return plan
    return other if other.makespan_s < plan.makespan_s else plan


def _of_all_products(units: Sequence[PlanResult], watch: StageWatch) -> PlanResult:
    """Return the plan of all products from those of the units; the stage is products."""
    plan, kind = units[0], units[0].scenario.sections.kind
    plans = [{IN_TURNS: own.turns or own.tpg, own.name: own.tpg} for own in units]
    found = plans_of_all_products(plans, kind, watch)
    tpg, turns = found[plan.name], found[IN_TURNS]
    idle = tuple(own for own in plan.idle if own.robot in tpg.idle_robots())
    if tpg is turns:
        return replace(plan, tpg=tpg, turns=None, name=IN_TURNS, idle=idle)
    return replace(plan, tpg=tpg, turns=turns, idle=idle)


class CoordinatedPlans:
    """Plans of the same motions by their names in twin.runs.policies, made when they are first asked for.

    Motions within the limits of robots are timed by ``time_parameterize``.

    Args:
        motions: assignment and motions, one task after another.
        scenario: that they are planned of.
        watch: returns a stopwatch for the stages that a plan adds to its base plan.
        candidates: shortcuts tried.
        keep_slots: leave the tasks of a plan in slots there when it is shortened.
        conflicts: what was found for other plans of the same cell.
    """

    def __init__(
        self,
        motions: PlannedMotions,
        scenario: Scenario,
        watch: Callable[[], StageWatch],
        *,
        candidates: int,
        keep_slots: bool = False,
        conflicts: OccupantConflicts | None = None,
    ) -> None:
        self._motions, self._scenario, self._watch = motions, scenario, watch
        self._conflicts = conflicts
        self._candidates, self._keep_slots = candidates, keep_slots
        self._made: dict[str, tuple[TemporalPlanGraph, Mapping[str, float]]] = {}

    def __getitem__(self, name: str) -> TemporalPlanGraph:
        """Return a plan."""
        return time_parameterize(self._untimed(name)[0], self._scenario, self._watch())

    def seconds(self, name: str) -> Mapping[str, float]:
        """Return the wall-clock seconds of the stages of a plan."""
        return self._untimed(name)[1]

    def _untimed(self, name: str) -> tuple[TemporalPlanGraph, Mapping[str, float]]:
        if name not in self._made:
            before: Mapping[str, float] = {}
            if whole := WHOLE_PLANS.get(name):
                tpg, before = self._untimed(whole)
            watch = self._watch()
            if whole:
                tpg = shorten_plan(
                    tpg,
                    self._motions.settings,
                    watch,
                    candidates=self._candidates,
                    seed=self._scenario.seed,
                    sidesteps=planned_sidesteps(self._scenario),
                    seconds=self._scenario.planning.shortcut_s,
                    keep_slots=self._keep_slots,
                    straight=orders_by_straight_lines(self._scenario),
                    conflicts=self._conflicts,
                )
            elif name == IN_SLOTS:
                always = self._scenario.planning.joint_planning == "always"
                slots = plan_synchronously(self._motions, watch, always_jointly=always)
                tpg = build_plan_graph(slots.motion_plan, watch, slots.slot_of_task)
            else:
                tpg = build_plan_graph(self._motions.motion_plan, watch)
            if not tpg.chains:
                raise ScenarioError(
                    "there is nothing to do: every robot stands where it is to be"
                )
            self._made[name] = tpg, {**before, **watch.seconds}
        return self._made[name]


def _coordinated(
    loaded: LoadedScenario,
    first: PlannedMotions,
    watch: StageWatch,
    most: int = MOST_CANDIDATES,
    conflicts: OccupantConflicts | None = None,
) -> PlanResult:
    """Return motions with their graph, ordered and shortened with a limited number of candidates."""
    scenario, turns = loaded.sections, None
    candidates = min(planned_shortcuts(scenario), most)
    plans = CoordinatedPlans(
        first,
        scenario,
        lambda: watch,
        candidates=candidates,
        keep_slots=scenario.execution.policy == "synchronous",
        conflicts=conflicts,
    )
    name = AT_ONCE if assembly_kind(scenario.assembly).space_time else IN_TURNS
    if scenario.planning.coordination == "synchronous":
        name = SLOTS_SHORTENED if candidates else IN_SLOTS
        turns = time_parameterize(build_nodes(first.motion_plan), scenario, watch)
    elif candidates:
        name = SHORTENED
    tpg = plans[name]
    if name == SHORTENED:
        turns = plans[IN_TURNS]
    return PlanResult(loaded, tpg, name, turns, watch.seconds, made_of=first)


def chooses_robot_subset(scenario: Scenario) -> bool:
    """Return whether robots may be left without work where that shortens the plan.

    True if plans are compared by their temporal plan graph and there are more than two robots.
    """
    chosen = scenario.kind.chooses_robots
    in_turns = scenario.planning.coordination == "sequential"
    return chosen and in_turns and len(scenario.cell.robots) > 2


def searches_assignment(scenario: Scenario) -> bool:
    """Return whether assignments are looked for that end sooner than that of the integer program."""
    return orders_by_straight_lines(scenario) and "assignment search" in HOOKS


def orders_by_straight_lines(scenario: Scenario) -> bool:
    """Return whether tasks are ordered for transits along straight lines; not for plans in slots."""
    planning, kind = scenario.planning, scenario.kind
    if planning.coordination != "sequential" or not kind.chooses_robots:
        return False
    if planning.assignment == "auto":
        return kind.searches_assignment
    return planning.assignment == "search"


@dataclass(frozen=True)
class _Searched:
    """A searched assignment.

    Attributes:
        gain: what it gains.
        rated: its plan, None where it is not worth planning or has no motions.
    """

    gain: AssignmentGain
    rated: RatedPlan | None

    @property
    def plan(self) -> TaskPlan | None:
        """The assignment with which motions were found."""
        return None if self.rated is None else self.rated.task_plan


@dataclass(frozen=True)
class _Promising:
    """Motions whose plans may be the shortest.

    Attributes:
        motions: best rated first.
        searched: the searched assignment, None without a search.
        conflicts: found when plans were rated; None where they are not needed again.
    """

    motions: list[PlannedMotions]
    searched: _Searched | None = None
    conflicts: OccupantConflicts | None = None


def _promising_motions(
    scenario: Scenario, first: PlannedMotions, watch: StageWatch
) -> _Promising:
    """Return motions of the integer program's plan, or of better rated ones.

    A rating by straight lines decides. By smoothed paths it is less certain: those of all plans that are rated
    almost as good are compared. Without shortcuts a graph is cheap, and those of all plans are compared.
    """
    from scheduling.ordering.plan_rating import PlanRater
    from scheduling.ordering.robot_subsets import rate_robot_subsets, robot_subset_plans

    crews, searches = chooses_robot_subset(scenario), searches_assignment(scenario)
    if not (crews or searches) or (work := first.work) is None:
        return _Promising([first])
    shortcuts = planned_shortcuts(scenario) > 0
    straight = orders_by_straight_lines(scenario)
    rater = PlanRater(
        first.cell, first.settings, shortcuts=shortcuts, straight=straight
    )
    searched: _Searched | None = None
    others: list[RatedPlan] = []
    if searches:
        with watch.stage("assignment_search", SEARCH):
            searched = _search_assignment(scenario, first, work, rater)
        if searched is not None and searched.rated is not None:
            others = [searched.rated]
    stage = ("assignment", CREWS) if crews else ("assignment_search", SEARCH)
    with watch.stage(*stage):
        plans = robot_subset_plans(work, first.task_plan) if crews else []
        if not (plans or others or (crews and straight)):
            return _Promising([first], searched)
        start = rater.rate_motions(work, first.task_plan, first.motion_plan)
        found = [start]
        if crews:
            found = rate_robot_subsets(rater, plans, start, watch.reporter(CREWS))
    if searched is not None:
        gain = replace(searched.gain, rated_start_s=start.makespan_s)
        searched = replace(searched, gain=gain)
    found = sorted([*found, *others], key=lambda plan: plan.makespan_s)
    if straight and shortcuts:
        found = found[:1]
    longest = found[0].makespan_s * (1.0 + _NEAR) if shortcuts else np.inf
    motions = [
        first if plan is start else _with_plan(scenario, first, plan)
        for plan in found
        if plan is start or plan.makespan_s <= longest
    ]
    return _Promising(motions, searched, rater.conflicts if straight else None)


def _search_assignment(
    scenario: Scenario, first: PlannedMotions, work: Assembly, rater: PlanRater
) -> _Searched | None:
    """Return the best rated assignment that a search finds, where one may pay; None without a search."""
    wanted = scenario.planning.assignment_moves
    moves = None if wanted == "auto" else wanted
    search = HOOKS.load("assignment search")
    found = search(first.cell, work, first.task_plan, first.settings, moves)
    if found is None:
        return None
    best, predicted_s = None, found.plans[0][0]
    for seconds, plan in found.plans:
        if seconds < found.start_s * (1.0 - _LEAST_GAIN):
            rated = rater.rate(work, plan)
            if rated and (best is None or rated.makespan_s < best.makespan_s):
                best, predicted_s = rated, seconds
    gain = AssignmentGain(
        found.moves,
        found.start_s,
        predicted_s,
        rated_s=None if best is None else best.makespan_s,
    )
    return _Searched(gain, best)


def _with_plan(
    scenario: Scenario, first: PlannedMotions, plan: RatedPlan
) -> PlannedMotions:
    """Return the motions that belong to a plan found by search."""
    found = replace(
        first,
        task_plan=plan.task_plan,
        motion_plan=plan.motion_plan,
        work=plan.work,
    )
    return assembly_kind(scenario.assembly).finished(found)

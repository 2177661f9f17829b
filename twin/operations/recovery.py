"""Recovery of assemblies after all attempts at a skill have failed, or after a robot has gone out of service.

A cut divides the graph into nodes that are executed as planned (the committed prefix) and nodes that are replaced, see
``scheduling.rolling.cut``. New plans are made for several cuts, and the best one is used. After a failure, the skill is
retried, its step is restarted, a person is asked, or the step is abandoned together with all steps that depend on it;
see ``failure_triage``. For a restarted step, the integer program chooses grip, object and robot.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import InitVar, dataclass, replace
from functools import partial
from types import MappingProxyType

from planning.errors import (
    InfeasibleStepError,
    PlanInvariantError,
    TransitError,
)
from planning.tasks.task import TaskKind
from planning.worlds.measured import Poses, choices_at_measured_poses
from planning.worlds.supplied import REMOVAL
from planning.worlds.world import World
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.planned_motions import PlannedMotions
from scheduling.rolling.cut import Counts, complete_tasks, planned_steps
from scheduling.rolling.forecast import Clock, forecast_s
from scheduling.rolling.supply import with_pending_objects
from twin.operations.commitment import (
    CommittedPrefix,
    CutPolicy,
    Draw,
    ReplanTrigger,
    TriageResult,
    committed_at,
    executable_lengths,
)
from twin.operations.failure_triage import (
    FailureTriage,
    dependent_steps,
)
from twin.operations.ledger import OperationLedger
from twin.operations.person import Person
from twin.operations.planner import (
    Extension,
    Planner,
    TaskSeeds,
)
from twin.operations.recovery_draft import AssemblyState, Draft, PlanningContext
from twin.operations.step_window import StepWindow
from twin.scenario.sections.scenario import Scenario

_AS_PLANNED = ((CutPolicy(steps=True),), (CutPolicy(evade=True),))
"""Cuts of a plan that only needs more steps, without failures or outages."""


@dataclass(frozen=True)
class Proposal:
    """An extension of the plan from one cut.

    Attributes:
        union, new: the extended graph, and its new part.
        at: the committed prefix.
        state: of the assembly with the extended graph.
        more: number of steps that are abandoned in addition.
    """

    union: TemporalPlanGraph
    new: TemporalPlanGraph
    at: CommittedPrefix
    state: AssemblyState
    more: int

    def end_s(self, clock: Clock | None, planning_s: float) -> float:
        """Return the forecast makespan [s]."""
        return forecast_s(self.union, self.at.counts(self.union), clock, planning_s)


@dataclass
class Recovery(Planner[AssemblyState]):
    """Recovery of an assembly of bricks, goals or parts.

    Attributes:
        scenario: scenario with its recovery section.
        motions: base motions of the first plan.
        tpg: the first plan.
        draw: times of new nodes.
        person: answers questions before a step is abandoned.
        gone: objects that were lost before.
        measured: measured poses of displaced parts.
        undone: steps abandoned before, by number, with the reason.
        cuts: groups of cuts from which plans are proposed, later groups only to avoid abandoning steps.
            The proposal that abandons fewest steps is chosen, of several the one that ends first.
    """

    scenario: Scenario
    motions: InitVar[PlannedMotions]
    tpg: InitVar[TemporalPlanGraph]
    draw: Draw
    person: Person
    gone: InitVar[Collection[str]] = ()
    measured: InitVar[Poses] = MappingProxyType({})
    undone: InitVar[Mapping[int, str]] = MappingProxyType({})
    cuts: tuple[tuple[CutPolicy, ...], ...] = (
        (CutPolicy(), CutPolicy(continuing=True), CutPolicy(evade=True)),
        (CutPolicy(steps=True),),
    )

    def __post_init__(
        self,
        motions: PlannedMotions,
        tpg: TemporalPlanGraph,
        gone: Collection[str],
        measured: Poses,
        undone: Mapping[int, str],
    ) -> None:
        settings = motions.settings
        own = self.scenario.execution.recovery
        seconds = {TaskKind.TAKEN_OUT: own.remove.mean if own.remove else own.remove_s}
        settings = replace(
            settings, skill_seconds={**settings.skill_seconds, **seconds}
        )
        motions = replace(motions, settings=settings)
        chosen, work = motions.task_plan, motions.work
        assert work is not None
        window = StepWindow(self.scenario.execution.step_window, motions)
        self.context = PlanningContext(self.scenario, self.person, window)
        ledger = OperationLedger(
            dependent_steps(tpg.tasks, tpg.allowed, chosen, work.needs),
            given_up=dict(undone),
            gone=frozenset(gone),
            measured=dict(measured),
        )
        removes = work.passing or own.bin
        cell = with_pending_objects(tpg.cell, (), REMOVAL) if removes else tpg.cell
        steps = planned_steps(tpg)
        self.initial = AssemblyState(
            tpg, TaskSeeds.of(tpg), ledger, cell, chosen, steps, motions
        )

    def is_short(self, state: AssemblyState) -> bool:
        """Return whether the plan of a state lacks wanted steps."""
        ledger, planned = state.ledger, len(state.task_plan.choices)
        return self.context.window.is_short(ledger.given_up, ledger.more, planned)

    def never_begun(self, state: AssemblyState) -> Mapping[int, str]:
        """Return infeasible steps of wanted products, by number, with the reason."""
        ledger, planned = state.ledger, len(state.task_plan.choices)
        if not ledger.closed or not self.context.window.in_products:
            return {}
        last = self.context.window.last(ledger.given_up, ledger.more)
        return dict.fromkeys(range(planned + 1, last + 1), ledger.closed)

    def begun(self, state: AssemblyState, counts: Sequence[int]) -> set[int]:
        """Return the steps started by given numbers of executed nodes of each chain."""
        complete, cell = complete_tasks(state.tpg, counts), state.tpg.cell
        world = World(cell.start_state(), state.steps, complete=complete)
        return set(world.begun())

    def due(self, state: AssemblyState, released: Sequence[int]) -> bool:
        """Return whether further steps are due for planning."""
        planned, ledger = len(state.task_plan.choices), state.ledger
        last = self.context.window.last(ledger.given_up, ledger.more)
        return not ledger.closed and self.context.window.due(
            state.tpg, released, planned, ledger.undone, last
        )

    def unplanned(self, state: AssemblyState) -> int:
        """Return the number of steps not planned yet, 0 if no more will be."""
        return (
            0 if state.ledger.closed else self.context.window.unplanned(state.task_plan)
        )

    def new_steps(self, before: AssemblyState, after: AssemblyState) -> range:
        """Return the numbers of the steps that are planned for the first time."""
        first = len(before.task_plan.choices) + 1
        return range(first, len(after.task_plan.choices) + 1)

    def extend(
        self,
        state: AssemblyState,
        trigger: ReplanTrigger,
        *,
        more_steps: bool = True,
    ) -> tuple[AssemblyState, Extension]:
        """Return the next state and an extended graph, see ``Planner``."""
        draft = self._draft(state)
        ledger, window = draft.ledger, self.context.window
        if more_steps:
            draft.reach = len(state.task_plan.choices)
            if self.due(state, trigger.released):
                last = window.last(ledger.given_up, trigger.more)
                draft.reach = window.after(draft.reach, last)
            draft.motions = window.of_first(draft.motions, draft.reach)
            ledger.more = trigger.more
        allows = partial(
            self.context.elsewhere.allows, draft.motions.work, draft.task_plan
        )
        about = self.scenario.execution, ledger, self.person, allows
        is_named = draft.work.is_named
        triage = FailureTriage(*about, is_named).decide(state.tpg, trigger)
        there = ledger.measured
        draft.task_plan = choices_at_measured_poses(draft.work, draft.task_plan, there)
        return self._from_best_cut(draft, trigger, triage)

    def _draft(
        self,
        state: AssemblyState,
        motions: PlannedMotions | None = None,
        reach: int = 0,
    ) -> Draft:
        """Return a draft of a state, which is not changed."""
        return Draft(
            self.context,
            state.tpg,
            state.seeds,
            state.ledger.draft(),
            state.cell,
            state.task_plan,
            state.steps,
            motions or state.motions,
            state.past,
            state.measure,
            reach,
        )

    def _from_best_cut(
        self,
        draft: Draft,
        trigger: ReplanTrigger,
        triage: TriageResult,
    ) -> tuple[AssemblyState, Extension]:
        """Return the best proposal of all cuts, or the end of the operation without one."""
        before, found, why = draft.state(), list[Proposal](), ""
        motions, tpg = draft.motions, draft.tpg
        planning_s = self.scenario.execution.recovery.planning_s
        for cuts in self._cuts(tpg, trigger):
            stuck = False
            for counts, evade in cuts:
                at = committed_at(tpg, counts, trigger, triage)
                attempt = self._draft(before, motions, draft.reach)
                try:
                    union, new = attempt.onward(at, evade=evade)
                except (PlanInvariantError, TransitError, InfeasibleStepError) as error:
                    why = str(error)
                else:
                    more = len(attempt.ledger.given_up) - len(before.ledger.given_up)
                    found.append(Proposal(union, new, at, attempt.state(), more))
                # Spare objects stay among the candidates from cut to cut.
                motions, stuck = attempt.motions, stuck or attempt.stuck
            if found and (any(not item.more for item in found) or not stuck):
                break  # infeasible from every cut
        if found:
            about = trigger.clock, planning_s
            best = min(found, key=lambda item: (item.more, item.end_s(*about)))
            state = replace(best.state, motions=motions)
            return state, (best.union, best.new, best.at)
        ended = self._draft(before, motions, draft.reach)
        extension = ended.nothing_further(at, why)
        return ended.state(), extension

    def _cuts(
        self, tpg: TemporalPlanGraph, trigger: ReplanTrigger
    ) -> Iterator[list[tuple[Counts, bool]]]:
        """Yield cuts and whether robots make way there, in groups of decreasing preference, without duplicates."""
        planning_s = self.scenario.execution.recovery.planning_s
        tried = set[tuple[Counts, bool]]()
        for policies in _AS_PLANNED if trigger.due else self.cuts:
            cuts = [(p.counts(tpg, trigger, planning_s), p.evade) for p in policies]
            yield [cut for cut in dict.fromkeys(cuts) if cut not in tried]
            tried.update(cuts)

    def end(
        self,
        state: AssemblyState,
        trigger: ReplanTrigger,
        why: str,
    ) -> tuple[AssemblyState, Extension]:
        """Return the state with all remaining steps abandoned, and the committed graph alone."""
        draft = self._draft(state)
        about = self.scenario.execution, draft.ledger, self.person
        triage = FailureTriage(*about).decide(state.tpg, trigger)
        counts = executable_lengths(state.tpg, trigger)
        at = committed_at(state.tpg, counts, trigger, triage)
        extension = draft.nothing_further(at, why)
        return draft.state(), extension

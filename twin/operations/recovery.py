"""Recovery of assemblies after all attempts at a skill have failed, or after a robot has gone out of service.

A cut divides the graph into nodes that are executed as planned (the committed prefix) and nodes that are replaced, see
``scheduling.rolling.cut``. New plans are made for several cuts, and the best one is used. After a failure, the skill is
retried, its step is restarted, a person is asked, or the step is abandoned together with all steps that depend on it;
see ``failure_triage``. For a restarted step, the integer program chooses grip, object and robot.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import InitVar, dataclass, fields, replace
from functools import partial
from itertools import chain
from types import MappingProxyType

from planning.errors import (
    InfeasibleStepError,
    PlanInvariantError,
    TransitError,
)
from planning.tasks.task import StepTasks, TaskKind
from planning.worlds.measured import Poses, choices_at_measured_poses
from planning.worlds.supplied import REMOVAL
from planning.worlds.world import World
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.planned_motions import PlannedMotions
from scheduling.rolling.cut import Counts, complete_tasks, planned_steps
from scheduling.rolling.forecast import Clock, forecast_s
from scheduling.rolling.supply import with_pending_objects
from twin.host.progress import StageWatch
from twin.operations.commitment import (
    CommittedPrefix,
    CutPolicy,
    Draw,
    ReplanTrigger,
    TriageResult,
    committed_at,
    executable_lengths,
    failed_task,
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
        context = PlanningContext(self.scenario, self.person, window)
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
            tpg, TaskSeeds.of(tpg), ledger, cell, chosen, steps, motions, context
        )

    def is_short(self, state: AssemblyState) -> bool:
        """Return whether the plan of a state lacks wanted steps."""
        ledger, planned = state.ledger, len(state.task_plan.choices)
        return state.context.window.is_short(ledger.given_up, ledger.more, planned)

    def never_begun(self, state: AssemblyState) -> Mapping[int, str]:
        """Return infeasible steps of wanted products, by number, with the reason."""
        ledger, planned = state.ledger, len(state.task_plan.choices)
        if not ledger.closed or not state.context.window.in_products:
            return {}
        last = state.context.window.last(ledger.given_up, ledger.more)
        return dict.fromkeys(range(planned + 1, last + 1), ledger.closed)

    def begun(self, state: AssemblyState, counts: Sequence[int]) -> set[int]:
        """Return the steps started by given numbers of executed nodes of each chain."""
        complete, cell = complete_tasks(state.tpg, counts), state.tpg.cell
        world = World(cell.start_state(), state.steps, complete=complete)
        return set(world.begun())

    def due(self, state: AssemblyState, released: Sequence[int]) -> bool:
        """Return whether further steps are due for planning."""
        planned, ledger = len(state.task_plan.choices), state.ledger
        last = state.context.window.last(ledger.given_up, ledger.more)
        return not ledger.closed and state.context.window.due(
            state.tpg, released, planned, ledger.undone, last
        )

    def unplanned(self, state: AssemblyState) -> int:
        """Return the number of steps not planned yet, 0 if no more will be."""
        window = state.context.window
        return 0 if state.ledger.closed else window.unplanned(state.task_plan)

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
        before, state = state, self._with_rush(state, trigger)
        draft = self._draft(state)
        ledger, window = draft.ledger, state.context.window
        if more_steps:
            draft.reach = len(state.task_plan.choices)
            if state is not before or self.due(state, trigger.released):
                last = window.last(ledger.given_up, trigger.more)
                draft.reach = window.after(draft.reach, last)
            draft.motions = window.of_first(draft.motions, draft.reach)
            ledger.more = trigger.more
        allows = partial(
            state.context.elsewhere.allows, draft.motions.work, draft.task_plan
        )
        about = self.scenario.execution, ledger, self.person, allows
        is_named = draft.work.is_named
        triage = FailureTriage(*about, is_named).decide(state.tpg, trigger)
        there = ledger.measured
        draft.task_plan = choices_at_measured_poses(draft.work, draft.task_plan, there)
        return self._from_best_cut(draft, trigger, triage)

    def rush_after(self, state: AssemblyState) -> tuple[int, ...]:
        """Return how many products were begun before each one of a rush order that has come in."""
        return state.context.rush_after

    def _with_rush(self, state: AssemblyState, trigger: ReplanTrigger) -> AssemblyState:
        """Return a state in which products of rush orders come next of those that are not begun.

        Steps are numbered in the new order; of those that are not begun nothing is planned any more.
        """
        context, ledger, ahead = state.context, state.ledger, state.motions.ahead
        come = trigger.rushed - len(context.rush_after)
        if come <= 0 or ahead is None:
            return state
        begun = {step for step, _ in ledger.tries} | {ask.step for ask in ledger.asks}
        begun |= {failed_task(state.tpg, failed).step for failed in trigger.failures}
        for counts, _ in chain.from_iterable(self._cuts(state.tpg, trigger)):
            begun |= self.begun(state, counts)
        count = bisect_left(ahead.ends, max(begun)) + 1 if begun else 0
        last = ahead.ends[count - 1] if count else 0
        first = max([count, *(before + 1 for before in context.rush_after)])
        rush_after = (*context.rush_after, *range(first, first + come))
        kind = self.scenario.kind.written_out().with_rush(rush_after)
        ahead = kind.ahead(state.motions.cell, StageWatch())
        motions = replace(state.motions, ahead=ahead, work=ahead.first(last))
        window = StepWindow(self.scenario.execution.step_window, motions)
        after = [task for own in state.steps if own.step > last for task in own.tasks]
        refills = (
            ahead.built.supply.refills.items()
        )  # of parts, as nothing else is rushed
        brings = {name: step for step, own in refills for name, _ in own.parts}
        steps = [brings.get(task.object, task.step) for task in after]
        past = (StepTasks(k, (t,), (), ()) for k, t in zip(steps, after, strict=True))
        given_up = {k: why for k, why in ledger.given_up.items() if k <= last}
        return replace(
            state,
            ledger=replace(ledger, given_up=given_up, closed=""),
            task_plan=replace(state.task_plan, choices=state.task_plan.choices[:last]),
            steps=tuple(own for own in state.steps if own.step <= last),
            past=(*state.past, *past),
            motions=motions,
            context=replace(context, window=window, rush_after=rush_after),
        )

    def _draft(
        self,
        state: AssemblyState,
        motions: PlannedMotions | None = None,
        reach: int = 0,
    ) -> Draft:
        """Return a draft of a state, which is not changed."""
        own = {item.name: getattr(state, item.name) for item in fields(state)}
        own |= {"ledger": state.ledger.draft(), "motions": motions or state.motions}
        return Draft(**own, reach=reach)

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
            # A rush order does not wait for what would be begun meanwhile.
            own = (p for p in policies if not (trigger.rushed and p.continuing))
            cuts = [(p.counts(tpg, trigger, planning_s), p.evade) for p in own]
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

"""Draft of a recovery plan: the planned extension of the executed plan, and the abandoned steps.

A draft belongs to one cut, which divides the nodes of the executed plan into kept and replaced nodes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace

from planning.cell.workcell import Workcell, WorldState
from planning.errors import (
    InfeasibleStepError,
    TransitError,
)
from planning.motion.motion_cache import MotionCache
from planning.tasks.assembly import Assembly, Disposal
from planning.tasks.assignment import TaskPlan
from planning.tasks.task import StepTasks, TaskKind
from planning.worlds.measured import MeasuredWork
from planning.worlds.onward import (
    BlockedStep,
    ReplanningState,
    find_blocked_step,
    fix_choices,
)
from planning.worlds.world import World, robots_with_unfinished_steps, unfinished_steps
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.planned_motions import PlannedMotions
from twin.host.progress import StageWatch
from twin.operations.commitment import CommittedPrefix
from twin.operations.failure_triage import (
    dependent_steps,
    find_infeasible_steps,
    interrupted_steps,
    processes,
    request_replacement,
)
from twin.operations.ledger import LedgerDraft
from twin.operations.person import Person
from twin.operations.planner import (
    Extension,
    RecoveryState,
    TaskSeeds,
    append_extension,
    empty_extension,
)
from twin.operations.replanning import plan_from
from twin.operations.step_window import StepWindow
from twin.operations.termination import NO_PROGRESS, RevisionMeasure
from twin.scenario.sections.scenario import Scenario


@dataclass(frozen=True)
class AssemblyState(RecoveryState):
    """State of the plan of an assembly.

    Attributes:
        cell: with the objects that have come up.
        task_plan: the choices.
        steps, past: tasks, as of a world.
        motions: candidates of all steps, with spare objects that are used.
        context: settings and caches.
    """

    cell: Workcell
    task_plan: TaskPlan
    steps: tuple[StepTasks, ...]
    motions: PlannedMotions
    context: PlanningContext
    past: tuple[StepTasks, ...] = ()


@dataclass(frozen=True)
class PlanningContext:
    """Settings and caches of a recovery, which only rush orders change.

    Attributes:
        scenario: scenario with its recovery section.
        person: answers questions before a step is abandoned.
        window: how many first steps are planned.
        known: motions that were planned before.
        elsewhere: candidates with parts where they were measured.
        rush_after: how many products come before each one of a rush order that has come in.
    """

    scenario: Scenario
    person: Person
    window: StepWindow
    known: MotionCache = field(default_factory=MotionCache)
    elsewhere: MeasuredWork = field(default_factory=MeasuredWork)
    rush_after: tuple[int, ...] = ()


@dataclass
class Draft:
    """Mutable draft of the next state, from one cut.

    Attributes:
        context: settings and caches.
        tpg, seeds, ledger, cell, task_plan, steps, motions, past, measure: of the state.
        reach: number of first steps that are planned.
        stuck: whether a step was abandoned because no motion was found.
    """

    context: PlanningContext
    tpg: TemporalPlanGraph
    seeds: TaskSeeds
    ledger: LedgerDraft
    cell: Workcell
    task_plan: TaskPlan
    steps: tuple[StepTasks, ...]
    motions: PlannedMotions
    past: tuple[StepTasks, ...]
    measure: RevisionMeasure | None
    reach: int = 0
    stuck: bool = False

    def state(self) -> AssemblyState:
        """Return the resulting state."""
        own = {item.name: getattr(self, item.name) for item in fields(AssemblyState)}
        return AssemblyState(**own | {"ledger": self.ledger.recorded()})

    @property
    def work(self) -> Assembly:
        """All candidates, with parts at their measured poses."""
        elsewhere = self.context.elsewhere
        return elsewhere.of(self.motions.work, self.ledger.measured)

    def nothing_further(self, at: CommittedPrefix, why: str) -> Extension:
        """Abandon all steps beyond the committed prefix."""
        world = self._world(at)
        left = {item.step.step for item in unfinished_steps(world, {}) if not item.ends}
        done = world.begun().keys() - left
        self.ledger.closed = why.partition("\n")[0] or NO_PROGRESS
        for step in self.context.window.all_steps(self.task_plan):
            if step not in done:
                self.ledger.give_up(step, why)
        return empty_extension(at, self.cell)

    def _world(self, at: CommittedPrefix) -> World:
        """Return the world at the end of the committed prefix."""
        complete = set(at.complete)
        for task in at.tried:
            if task.step in at.triage.reopened or task.step in self.ledger.undone:
                complete.add(task.index)
        pending = self.ledger.pending(at.committed.tasks)
        where = self.ledger.where(at.state.attachments, pending, self.cell)
        return World(
            WorldState(at.state.configurations, where),
            self.steps,
            self.past,
            frozenset(complete),
            frozenset(self.ledger.gone | self.ledger.unpickable) | at.out,
            len(at.committed.tasks),
            at.ago,
        )

    def onward(
        self, at: CommittedPrefix, *, evade: bool
    ) -> tuple[TemporalPlanGraph, TemporalPlanGraph]:
        """Return the extended graph and its new part; infeasible steps are abandoned."""
        watch, evading = StageWatch(), frozenset[str]()
        questions = len(self.ledger.asks)
        emptied: dict[int, frozenset[str]] = {}
        machines = {item.name for item in self.cell.machines}
        if evade:
            evading = (
                robots_with_unfinished_steps(unfinished_steps(self._world(at), {}))
                - at.out
                - machines
            )
        while True:
            self._extend_to_orders()
            world = self._world(at)
            reopened = {
                **at.triage.reopened,
                **interrupted_steps(self.ledger, at.out, world),
                **emptied,
            }
            begun = world.begun().keys() - reopened.keys()
            # A step that has rejected a part is reported as given up, wanted or not.
            for step in at.unwanted - begun - self.ledger.rejected.keys():
                self.ledger.drop(step)
            for steps in self.work.passing.values():
                self.ledger.leave_off(set(steps) - world.begun().keys(), steps)
            rejected = dict(self._rejected(world, reopened))
            for step in self._to_repeat(world, questions):
                reopened.setdefault(step, frozenset())
            given_up = self.ledger.undone
            for step in given_up & world.begun().keys():
                reopened.setdefault(step, frozenset())
            now = ReplanningState(
                *(world, self.task_plan, reopened, given_up, evading),
                rejected=rejected,
                reworked=self.ledger.reworked,
            )
            work, undoable = find_infeasible_steps(self.work, now, self.cell)
            if not self.context.elsewhere.keep(work, self.ledger.measured):
                self.motions = replace(self.motions, work=work)
            if undoable:
                there = self.ledger.retry_unpicked_objects()
                asked = not there and any(
                    self._asks_for(step, why, now) for step, why in undoable.items()
                )
                if not there and not asked:
                    for step, why in undoable.items():
                        self.ledger.give_up(step, why)
                    self._end_before_infeasible(undoable)
                continue
            try:
                onward, tpg = plan_from(
                    replace(self.motions, work=self.work),
                    self.context.scenario,
                    self.cell,
                    now,
                    at.committed.tasks,
                    watch,
                    candidates=self.context.scenario.execution.recovery.shortcuts,
                    known=self.context.known,
                )
            except (InfeasibleStepError, TransitError) as error:
                others = frozenset[str]()
                if isinstance(error, TransitError):
                    left = unfinished_steps(world, reopened)
                    others = (
                        robots_with_unfinished_steps(left, but=error.step)
                        - world.out
                        - machines
                    )
                if others - evading:
                    evading |= others
                elif not self.ledger.retry_unpicked_objects():
                    why_not = find_blocked_step(self.cell, self.work.problem, now)
                    if why_not and why_not.robot and why_not.later not in emptied:
                        emptied[why_not.later] = self._emptied(world, why_not.robot)
                    elif not self._retreat(now, error, why_not):
                        raise
                continue
            come_up = onward.motions.cell.objects[len(self.cell.objects) :]
            self.cell = replace(self.cell, objects=(*self.cell.objects, *come_up))
            known = onward.motions.dependencies, onward.motions.windows
            union, new, self.cell = append_extension(
                at, tpg, self.cell, self.ledger, *known
            )
            if len(onward.task_plan.choices) > len(self.task_plan.choices):
                self.ledger.resting = dependent_steps(
                    union.tasks, union.allowed, onward.task_plan, self.work.needs
                )
                if self.ledger.falls():
                    continue
            self.task_plan = onward.task_plan
            self.steps, self.past = onward.steps, onward.past
            return union, new

    def _to_repeat(self, world: World, questions: int) -> Iterator[int]:
        """Yield the steps whose processes are repeated, as a person brings other parts after a number of questions."""
        undone, asks = self.ledger.undone, self.ledger.asks[questions:]
        helpful = (ask for ask in asks if ask.helps and ask.step not in undone)
        fresh = {ask.object for ask in helpful} - {None}
        for step, own in world.begun().items():
            done = (t for t in own.tasks if t.index in world.complete)
            if step not in undone and any(t.object in fresh for t in processes(done)):
                yield step

    def _rejected(
        self, world: World, reopened: dict[int, frozenset[str]]
    ) -> Iterator[tuple[int, Disposal]]:
        """Yield the rejected parts on which nothing rests, by step, and abandon what else was to be done with them.

        Robots that have only approached them for that retreat. A person takes what a robot failed to.
        """
        ledger, place = self.ledger, self.context.scenario.execution.recovery.bin
        places = [
            (k, task.object)
            for k, own in world.begun().items()
            for task in own.tasks
            if task.kind == "place-down" and task.index in world.complete
        ]
        for step, name in ledger.rejected.items():
            assert place is not None
            own = {k for k, part in places if part == name}
            above = {k for one in own for k in ledger.resting.get(one, ())}
            rests = {part for k, part in places if k in above} - {name}
            if rests & world.state.attachments.keys():
                continue
            done = set(world.done_steps()) - reopened.keys()
            for one in sorted({*self.work.steps_at(name), *above} - done):
                ledger.give_up(one, f"{name} is scrapped")
                if one in world.begun():
                    robots = {task.robot for task in world.begun()[one].tasks}
                    reopened.setdefault(one, frozenset(robots))
            failed = any(ledger.tries[step, kind] for kind in TaskKind.HANDLING)
            # Deliveries to a source wait for a person who frees their place.
            sourced = not own and name in self.work.passing
            if place == "person" or failed or sourced:
                yield step, Disposal(step, name, None)
            else:
                yield step, Disposal(step, name, place.pose_in(self.cell))

    def _asks_for(self, step: int, why: str, now: ReplanningState) -> bool:
        """Ask a person for the object that a step lacks; return whether the ledger changed."""
        lost = self.ledger.gone - now.world.state.attachments.keys()
        whole = fix_choices(self.work.problem, now.kept, now.world.out - lost, {})
        own = [c for c in whole.primaries if c.step == step and c.object in lost]
        if not own or whole.lacking(step) is not None:
            return False
        name = min(own, key=lambda c: (c.cost, c.object)).object
        if name in self.work.passing:
            return False  # others lie by now where it came from
        about = self.ledger, self.context.person, self.cell
        return request_replacement(*about, step, name, why)

    def _extend_to_orders(self) -> None:
        """Extend the planned steps to the number of ordered products, replacing failed ones."""
        ledger, motions = self.ledger, self.motions
        assert motions.work is not None
        ordered = 0
        if self.context.window.ordered_at_once and not ledger.closed:
            ordered = self.context.window.last(ledger.given_up, ledger.more)
        count = max(len(self.task_plan.choices), self.reach, ordered)
        if count != len(motions.work.problem.steps):
            self.motions = self.context.window.of_first(motions, count)

    def _end_before_infeasible(self, infeasible: Mapping[int, str]) -> None:
        """End the assembly before an infeasible step of the window."""
        planned = len(self.task_plan.choices)
        if new := [step for step in infeasible if step > planned]:
            first, ledger = min(new), self.ledger
            count = self.context.window.whole_products(first - 1)
            self.reach = count
            ledger.closed = f"step {first} is given up"
            if reason := infeasible[first].partition("\n")[0]:
                ledger.closed += f": {reason}"
            for step in self.context.window.all_steps(self.task_plan):
                if step > count and step != first:
                    ledger.give_up(step, f"step {first} is given up")
            if self.context.window.in_products:
                # Of a product that cannot be made nothing is begun; nor was it there before.
                for step in [k for k in ledger.given_up if k > count]:
                    del ledger.given_up[step]

    def _emptied(self, world: World, robot: str) -> frozenset[str]:
        """Have a held object removed, so that its robot is free; return that robot."""
        self.ledger.gone |= {name for name, at in world.held() if at.holder == robot}
        return frozenset({robot})

    def _retreat(
        self,
        now: ReplanningState,
        error: InfeasibleStepError | TransitError,
        why_not: BlockedStep | None,
    ) -> bool:
        """Abandon a step, or ask for its missing object; return whether there was one.

        It is the step of the error, an infeasible one, or the one with the fewest dependents.
        """
        undone = self.ledger.undone
        left = [c.step for c in self.task_plan.choices if c.step not in undone]
        named = why_not and why_not.step
        if isinstance(error, TransitError):
            named = error.step
        if named not in left:
            steps = [step for step in left if step not in now.kept]
            if not steps:
                return False
            named = min(steps, key=lambda k: (len(self.ledger.resting.get(k, ())), -k))
        assert named is not None
        self.stuck = True
        lacks, why = isinstance(error, InfeasibleStepError), str(error)
        robots = {name.partition("/")[0] for name in error.blocked_by if "/" in name}
        if in_the_way := sorted(now.world.out & robots):
            why = f"{' and '.join(in_the_way)}, out of service, is in the way: {why}"
        if not lacks or not self._asks_for(named, why, now):
            self.ledger.give_up(named, why)
        return True

"""What is done when a skill has failed for good, or a robot is out: a ladder of plans from the world as it is.

The skill again, or its step with what is left: another grip, another object of the kind, another robot, as
the integer program chooses; else the step is given up with what rests on it, and the rest goes on.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import InitVar, dataclass, field, replace
from functools import partial
from types import MappingProxyType

from planning.cell.workcell import WorldState, start_state
from planning.errors import (
    InfeasibleStepError,
    PlanInvariantError,
    TransitError,
)
from planning.motion.known_motions import KnownMotions
from planning.tasks.assignment import TaskPlan
from planning.tasks.task import TAKEN_OUT
from planning.tasks.work import AssemblyWork
from planning.worlds.measured import MeasuredWork, Poses, chosen_there
from planning.worlds.onward import Hindered, Situation, hindered, narrowed
from planning.worlds.supplied import REMOVAL
from planning.worlds.world import World, leftovers, standing
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.planned_motions import PlannedMotions
from scheduling.rolling.cut import Counts, complete_tasks, planned_steps
from scheduling.rolling.supply import coming
from twin.host.progress import StageWatch
from twin.operate.committed import (
    Committed,
    Draw,
    Incident,
    Judged,
    Recut,
    Version,
    as_far_as_planned,
    committed_at,
)
from twin.operate.going import (
    Extension,
    Found,
    Going,
    Luck,
    Planner,
    appended,
    nothing_new,
)
from twin.operate.judging import (
    Judging,
    asks_for_another,
    hopeless,
    interrupted,
    resting_steps,
)
from twin.operate.person import Ledger, Person
from twin.operate.replanning import plan_from
from twin.operate.step_window import StepWindow
from twin.operate.termination import NO_PROGRESS
from twin.scenario.sections.scenario import Scenario

_AS_PLANNED = ((Recut(steps=True),), (Recut(aside=True),))
"""Where a plan is cut in which nothing has happened but that more steps come next."""


@dataclass
class Recovery(Planner[Going]):
    """Plans what is left of an assembly whenever something has failed.

    Attributes:
        scenario: its recovery section says how.
        motions: what the first plan was made of.
        tpg: the first plan.
        draw: times of new nodes.
        gone: objects that are lost already.
        measured: where parts lie that were found beside their places.
        undone: steps that are given up already, by number, with the reason.
        person: who is asked before something is given up.
        cuts: from which it is planned, those that come later only where something has to be given up else; of all
            that from which least is, and of these that from which all is done soonest.
    """

    scenario: Scenario
    motions: PlannedMotions
    tpg: InitVar[TemporalPlanGraph]
    draw: Draw
    person: Person
    gone: InitVar[Collection[str]] = ()
    measured: InitVar[Poses] = MappingProxyType({})
    undone: InitVar[Mapping[int, str]] = MappingProxyType({})
    cuts: tuple[tuple[Recut, ...], ...] = (
        (Recut(), Recut(going=True), Recut(aside=True)),
        (Recut(steps=True),),
    )
    _known: KnownMotions = field(default_factory=KnownMotions)
    _elsewhere: MeasuredWork = field(default_factory=MeasuredWork)
    _stuck: bool = False
    _reach: int = 0

    def __post_init__(
        self,
        tpg: TemporalPlanGraph,
        gone: Collection[str],
        measured: Poses,
        undone: Mapping[int, str],
    ) -> None:
        settings = self.motions.settings
        seconds = {TAKEN_OUT: self.scenario.execution.recovery.remove_s}
        settings = replace(
            settings, skill_seconds={**settings.skill_seconds, **seconds}
        )
        self.motions = replace(self.motions, settings=settings)
        chosen, work = self.motions.task_plan, self.motions.work
        assert work is not None
        self._window = StepWindow(self.scenario.execution.window, self.motions)
        ledger = Ledger(
            resting_steps(tpg.tasks, tpg.allowed, chosen, work.needs),
            given_up=dict(undone),
            gone=set(gone),
            measured=dict(measured),
        )
        cell = coming(tpg.cell, (), REMOVAL) if work.passing else tpg.cell
        steps = planned_steps(tpg)
        self._executed = Going(Luck.of(tpg), ledger, cell, chosen, steps)
        self._planned = self._executed
        self._restore(self._executed)

    @property
    def short(self) -> bool:
        """Whether less is made, by what is executed, than is wanted."""
        ledger, planned = self._executed.ledger, len(self._executed.task_plan.choices)
        return self._window.is_short(ledger.given_up, ledger.more, planned)

    @property
    def never_begun(self) -> Mapping[int, str]:
        """Steps of products that are wanted and that nobody can begin, by number, with the reason."""
        ledger, planned = self._executed.ledger, len(self._executed.task_plan.choices)
        if not ledger.closed or not self._window.in_products:
            return {}
        last = self._window.last(ledger.given_up, ledger.more)
        return dict.fromkeys(range(planned + 1, last + 1), ledger.closed)

    def begun(self, tpg: TemporalPlanGraph, counts: Sequence[int]) -> set[int]:
        """Return the steps that have begun once so many nodes of each chain are executed."""
        complete = complete_tasks(tpg, counts)
        steps = self._executed.steps
        return set(World(start_state(tpg.cell), steps, complete=complete).begun())

    def due(self, tpg: TemporalPlanGraph, released: Sequence[int]) -> bool:
        """Tell whether it is time to plan more steps of what is executed."""
        planned, ledger = len(self._executed.task_plan.choices), self._executed.ledger
        last = self._window.last(ledger.given_up, ledger.more)
        return not ledger.closed and self._window.due(
            tpg, released, planned, ledger.undone, last
        )

    def _unplanned(self, state: Going) -> int:
        return 0 if state.ledger.closed else self._window.unplanned(state.task_plan)

    @property
    def work(self) -> AssemblyWork:
        """All candidates, with parts where they were measured."""
        return self._elsewhere.of(self.motions.work, self._ledger.measured)

    def _after(self, tpg: TemporalPlanGraph, incident: Incident) -> Extension:
        """Decide what is done about failures, and plan that; see ``plan_alone``."""
        allows = partial(self._elsewhere.allows, self.motions.work, self._task_plan)
        about = self.scenario.execution, self._ledger, self.person
        judged = Judging(*about, allows).judged(tpg, incident)
        there = self._ledger.measured
        self._task_plan: TaskPlan = chosen_there(self.work, self._task_plan, there)
        return self._from_some_cut(tpg, incident, judged)

    def plan(self, tpg: TemporalPlanGraph, incident: Incident) -> Version:
        """Return the graph that goes on, from the best cut from which anything does."""
        begin = time.process_time()
        self._restore(self._executed)
        planned = executed = len(self._task_plan.choices)
        if self.due(tpg, incident.released):
            last = self._window.last(self._ledger.given_up, incident.more)
            planned = self._window.after(executed, last)
        self._reach = planned
        self.motions = self._window.of_first(self.motions, planned)
        self._ledger.more = incident.more
        found = self._after(tpg, incident)
        self._planned = self._state()
        new = range(executed + 1, len(self._task_plan.choices) + 1)
        return self._version(tpg, incident, found, begin, new)

    def plan_alone(self, tpg: TemporalPlanGraph, incident: Incident) -> Extension:
        """Return what goes on, see ``Planner``."""
        found = self._after(tpg, incident)
        self._planned = self._executed = self._state()
        return found

    def _state(self) -> Going:
        known = self._executed.luck, self._ledger.copy(), self._cell
        return Going(*known, self._task_plan, self._steps, self._past)

    def _restore(self, going: Going) -> None:
        self._cell, self._steps, self._past = going.cell, going.steps, going.past
        self._task_plan = going.task_plan
        self._ledger: Ledger = going.ledger.copy()

    def _from_some_cut(
        self, tpg: TemporalPlanGraph, incident: Incident, judged: Judged
    ) -> Extension:
        """Return the longer graph, the new one, and what was there before."""
        before, found, why = self._state(), list[Found](), ""
        reach = self._reach
        planning_s = self.scenario.execution.recovery.planning_s
        tried = set[tuple[Counts, bool]]()
        for cuts in _AS_PLANNED if incident.due else self.cuts:
            self._stuck = False
            for cut in cuts:
                counts = cut.counts(tpg, incident, planning_s)
                if (counts, cut.aside) in tried:
                    continue
                tried.add((counts, cut.aside))
                at = committed_at(tpg, counts, incident, judged)
                self._reach = reach
                try:
                    union, new = self._onward(at, aside=cut.aside)
                except (PlanInvariantError, TransitError, InfeasibleStepError) as error:
                    why = str(error)
                else:
                    more = len(self._ledger.given_up) - len(before.ledger.given_up)
                    found.append(Found(union, new, at, self._state(), more))
                self._restore(before)
            if found and (any(not item.more for item in found) or not self._stuck):
                break  # what nobody can do can be done from nowhere else
        if found:
            about = incident.clock, planning_s
            best = min(found, key=lambda item: (item.more, item.end_s(*about)))
            self._restore(best.going)
            return best.union, best.new, best.at
        return self._nothing_further(at, why)

    def _ended(self, tpg: TemporalPlanGraph, incident: Incident, why: str) -> Extension:
        self._restore(self._executed)
        about = self.scenario.execution, self._ledger, self.person
        judged = Judging(*about).judged(tpg, incident)
        at = committed_at(tpg, as_far_as_planned(tpg, incident), incident, judged)
        found = self._nothing_further(at, why)
        self._planned = self._state()
        return found

    def _nothing_further(self, at: Committed, why: str) -> Extension:
        """Give up all steps that are not done once what is committed is complete."""
        world = self._world(at)
        left = {item.step.step for item in leftovers(world, {}) if not item.ends}
        done = world.begun().keys() - left
        self._ledger.closed = why.partition("\n")[0] or NO_PROGRESS
        for step in self._window.all_steps(self._task_plan):
            if step not in done:
                self._ledger.give_up(step, why)
        return nothing_new(at, self._cell)

    def _world(self, at: Committed) -> World:
        """Return the world once all that is committed is complete."""
        complete = set(at.complete)
        for task in at.tried:
            if task.step in at.judged.reopened or task.step in self._ledger.undone:
                complete.add(task.index)
        pending = self._ledger.pending(at.committed.tasks)
        where = self._ledger.where(at.state.attachments, pending, self._cell)
        return World(
            WorldState(at.state.configurations, where),
            self._steps,
            self._past,
            frozenset(complete),
            frozenset(self._ledger.gone | self._ledger.shunned) | at.out,
            len(at.committed.tasks),
            at.ago,
        )

    def _onward(
        self, at: Committed, *, aside: bool
    ) -> tuple[TemporalPlanGraph, TemporalPlanGraph]:
        """Return the longer graph and the new one, giving up what cannot be done."""
        watch, goes_aside = StageWatch(), frozenset[str]()
        emptied: dict[int, frozenset[str]] = {}
        machines = {item.name for item in self._cell.machines}
        if aside:
            goes_aside = standing(leftovers(self._world(at), {})) - at.out - machines
        while True:
            self._look_at_what_is_ordered()
            world = self._world(at)
            reopened = {
                **at.judged.reopened,
                **interrupted(self._ledger, at.out, world),
                **emptied,
            }
            for step in at.unwanted - (world.begun().keys() - reopened.keys()):
                self._ledger.drop(step)
            for steps in self.work.passing.values():
                self._ledger.leave_off(set(steps) - world.begun().keys(), steps)
            given_up = self._ledger.undone
            for step in given_up & world.begun().keys():
                reopened.setdefault(step, frozenset())
            now = Situation(
                world, self._task_plan, reopened, given_up, aside=goes_aside
            )
            work, undoable = hopeless(self.work, now, self._cell)
            if not self._elsewhere.keep(work, self._ledger.measured):
                self.motions = replace(self.motions, work=work)
            if undoable:
                there = self._ledger.takes_what_is_there()
                asked = not there and any(
                    self._asks_for(step, why, now) for step, why in undoable.items()
                )
                if not there and not asked:
                    for step, why in undoable.items():
                        self._ledger.give_up(step, why)
                    self._look_no_further(undoable)
                continue
            try:
                onward, tpg = plan_from(
                    replace(self.motions, work=self.work),
                    self.scenario,
                    self._cell,
                    now,
                    at.committed.tasks,
                    watch,
                    candidates=self.scenario.execution.recovery.shortcuts,
                    known=self._known,
                )
            except (InfeasibleStepError, TransitError) as error:
                others = frozenset[str]()
                if isinstance(error, TransitError):
                    left = leftovers(world, reopened)
                    others = standing(left, but=error.step) - world.out - machines
                if others - goes_aside:
                    goes_aside |= others
                elif not self._ledger.takes_what_is_there():
                    why_not = hindered(self._cell, self.work.problem, now)
                    if why_not and why_not.robot and why_not.later not in emptied:
                        emptied[why_not.later] = self._emptied(world, why_not.robot)
                    elif not self._retreat(now, error, why_not):
                        raise
                continue
            come_up = onward.motions.cell.objects[len(self._cell.objects) :]
            self._cell = replace(self._cell, objects=(*self._cell.objects, *come_up))
            known = onward.motions.dependencies, onward.motions.windows
            union, new, self._cell = appended(at, tpg, self._cell, self._ledger, *known)
            if len(onward.task_plan.choices) > len(self._task_plan.choices):
                self._ledger.resting = resting_steps(
                    union.tasks, union.allowed, onward.task_plan, self.work.needs
                )
                if self._ledger.falls():
                    continue
            self._task_plan = onward.task_plan
            self._steps, self._past = onward.steps, onward.past
            return union, new

    def _asks_for(self, step: int, why: str, now: Situation) -> bool:
        """Ask a person for an object for a step if that is what it lacks; return whether there is anything new."""
        lost = self._ledger.gone - now.world.state.attachments.keys()
        whole = narrowed(self.work.problem, now.kept, now.world.out - lost, {})
        own = [c for c in whole.primaries if c.step == step and c.object in lost]
        if not own or whole.lacking(step) is not None:
            return False
        name = min(own, key=lambda c: (c.cost, c.object)).object
        if name in self.work.passing:
            return False  # others lie by now where it came from
        about = self._ledger, self.person, self._cell
        return asks_for_another(*about, step, name, why)

    def _look_at_what_is_ordered(self) -> None:
        """Look at the steps of as many products as are ordered, in place of others that are not made among them."""
        ledger, motions = self._ledger, self.motions
        assert motions.work is not None
        ordered = 0
        if self._window.ordered_at_once and not ledger.closed:
            ordered = self._window.last(ledger.given_up, ledger.more)
        count = max(len(self._task_plan.choices), self._reach, ordered)
        if count != len(motions.work.problem.steps):
            self.motions = self._window.of_first(motions, count)

    def _look_no_further(self, hopeless: Mapping[int, str]) -> None:
        """End the assembly before a step that comes into the window and that nobody can do."""
        planned = len(self._task_plan.choices)
        if new := [step for step in hopeless if step > planned]:
            first, ledger = min(new), self._ledger
            count = self._window.whole_products(first - 1)
            self._reach = count
            ledger.closed = f"step {first} is given up"
            if reason := hopeless[first].partition("\n")[0]:
                ledger.closed += f": {reason}"
            for step in self._window.all_steps(self._task_plan):
                if step > count and step != first:
                    ledger.give_up(step, f"step {first} is given up")
            if self._window.in_products:
                # Of a product that cannot be made nothing is begun; nor was it there before.
                for step in [k for k in ledger.given_up if k > count]:
                    del ledger.given_up[step]

    def _emptied(self, world: World, robot: str) -> frozenset[str]:
        """Let what a robot holds be taken from its hand, so that it can do something else; return who that is."""
        self._ledger.gone |= {name for name, at in world.held() if at.holder == robot}
        return frozenset({robot})

    def _retreat(
        self,
        now: Situation,
        error: InfeasibleStepError | TransitError,
        why_not: Hindered | None,
    ) -> bool:
        """Give up a step, or ask for what it lacks, and tell whether there was one.

        It is that of the error, or one that nobody can do, else what fewest rest on.
        """
        undone = self._ledger.undone
        left = [c.step for c in self._task_plan.choices if c.step not in undone]
        named = why_not and why_not.step
        if isinstance(error, TransitError):
            named = error.step
        if named not in left:
            steps = [step for step in left if step not in now.kept]
            if not steps:
                return False
            named = min(steps, key=lambda k: (len(self._ledger.resting.get(k, ())), -k))
        assert named is not None
        self._stuck = True
        lacks, why = isinstance(error, InfeasibleStepError), str(error)
        robots = {name.partition("/")[0] for name in error.blocked_by if "/" in name}
        if in_the_way := sorted(now.world.out & robots):
            why = f"{' and '.join(in_the_way)}, out of service, is in the way: {why}"
        if not lacks or not self._asks_for(named, why, now):
            self._ledger.give_up(named, why)
        return True

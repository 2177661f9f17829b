"""What is done when a skill has failed for good, or a robot is out: a ladder of plans from the world as it is.

The skill again, or its step with what is left: another grip, another object of the kind, another robot, as
the integer program chooses; else the step is given up with what rests on it, and the rest goes on.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import InitVar, dataclass, field, replace

import numpy as np

from planning.cell.workcell import Workcell, start_state
from planning.errors import (
    InfeasibleStepError,
    PlanInvariantError,
    TransitError,
    TwinError,
)
from planning.motion.known_motions import KnownMotions
from planning.tasks.assignment import TaskPlan
from planning.tasks.task import (
    GONE,
    HANDLING,
    TAKEN_OUT,
    TRANSIT,
    Handling,
    StepTasks,
    Task,
)
from planning.tasks.work import AssemblyWork
from planning.worlds.onward import Situation, narrowed
from planning.worlds.world import Leftover, World, leftovers, pose_of
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.rolling.cut import (
    complete_tasks,
    cut_after,
    planned_steps,
    state_at,
)
from scheduling.rolling.extension import committed_part, extended
from scheduling.rolling.supply import brought_by, supply_waits
from twin.durations.model import NANOSECONDS
from twin.host.progress import StageWatch
from twin.operate.committed import (
    Committed,
    Judged,
    cause_of,
    committed_at,
    not_executed,
    tried_task,
)
from twin.operate.dependents import resting_steps
from twin.operate.ledger import Ledger
from twin.operate.luck import Luck
from twin.operate.rolling import Failure, Incident, Version
from twin.operate.step_window import StepWindow
from twin.planning.kind import PlannedMotions
from twin.planning.onward import plan_from
from twin.scenario.sections.scenario import Scenario
from twin.uncertainty.draws import TaskName
from twin.uncertainty.node_times import NodeTimes

Draw = Callable[[TemporalPlanGraph, Mapping[int, TaskName]], NodeTimes]
"""Returns the times of the nodes of a graph, given the names of the draws of tasks."""


@dataclass(frozen=True)
class Recut:
    """Where a plan is cut, and how it goes on there.

    Attributes:
        steps: whether robots bring their steps to an end before it; their tasks only otherwise.
        aside: whether every robot goes HOME first with what it has to bring to an end, and comes back.
    """

    steps: bool
    aside: bool = False


@dataclass(frozen=True)
class _Going:
    """What is known of a plan from which it can be gone on.

    Attributes:
        cell: with the objects that have come up.
        task_plan: the choices.
        steps, past: tasks, as of a world.
        luck: of its tasks.
        ledger: what has become of steps and objects.
    """

    cell: Workcell
    task_plan: TaskPlan
    steps: tuple[StepTasks, ...]
    luck: Luck
    ledger: Ledger
    past: tuple[StepTasks, ...] = ()


@dataclass
class Recovery:
    """Plans what is left of an assembly whenever something has failed.

    What it knows is that of the graph that is executed; of one that is planned and does not take its place,
    because more happens before, nothing is kept.

    Attributes:
        scenario: its recovery section says how.
        motions: what the first plan was made of.
        tpg: the first plan.
        draw: times of new nodes.
        cuts: that are tried, in this order, until nothing has to be given up; else that from which least is.
    """

    scenario: Scenario
    motions: PlannedMotions
    tpg: InitVar[TemporalPlanGraph]
    draw: Draw
    cuts: tuple[Recut, ...] = (Recut(steps=True), Recut(steps=False, aside=True))
    _known: KnownMotions = field(default_factory=KnownMotions)

    def __post_init__(self, tpg: TemporalPlanGraph) -> None:
        settings = self.motions.settings
        seconds = {TAKEN_OUT: self.scenario.execution.recovery.remove_s}
        settings = replace(
            settings, skill_seconds={**settings.skill_seconds, **seconds}
        )
        self.motions = replace(self.motions, settings=settings)
        plan, chosen = self.motions.motion_plan, self.motions.task_plan
        self._window = StepWindow(self.scenario.execution.window, self.motions)
        self._executed = _Going(
            tpg.cell,
            chosen,
            planned_steps(tpg),
            Luck.of(tpg),
            Ledger(resting_steps(plan.tasks, plan.allowed, chosen)),
        )
        self._planned = self._executed
        self._restore(self._executed)

    @property
    def given_up(self) -> Mapping[int, str]:
        """Steps that are not done any more in what is executed, by number, with the reason."""
        return self._executed.ledger.given_up

    @property
    def dropped(self) -> Mapping[int, str]:
        """Steps that are not wanted any more in what is executed, or rest on one, likewise."""
        return self._executed.ledger.dropped

    def begun(self, tpg: TemporalPlanGraph, counts: Sequence[int]) -> set[int]:
        """Return the steps that have begun once so many nodes of each chain are executed."""
        complete = complete_tasks(tpg, counts)
        steps = self._executed.steps
        return set(World(start_state(tpg.cell), steps, complete=complete).begun())

    def swapped(self) -> None:
        """Take note that what was planned last has taken its place."""
        self._executed = self._planned

    def due(self, tpg: TemporalPlanGraph, released: Sequence[int]) -> bool:
        """Tell whether it is time to plan more steps of what is executed."""
        planned, ledger = len(self._executed.task_plan.choices), self._executed.ledger
        return not ledger.closed and self._window.due(
            tpg, released, planned, ledger.undone
        )

    @property
    def work(self) -> AssemblyWork:
        """All candidates."""
        assert self.motions.work is not None
        return self.motions.work

    def plan(self, tpg: TemporalPlanGraph, incident: Incident) -> Version:
        """Return the graph that goes on, from the best cut from which anything does."""
        begin = time.process_time()
        self._restore(self._executed)
        planned = executed = len(self._task_plan.choices)
        if self.due(tpg, incident.released):
            planned = self._window.after(executed)
        self.motions = self._window.of_first(self.motions, planned)
        judged = self._judged(tpg, incident)
        union, new, at = self._from_some_cut(tpg, incident, judged)
        self._luck: Luck = self._luck.onward(union, len(at.committed.tasks))
        counts = at.lengths
        self._planned = self._state()
        return Version(
            union,
            tuple(counts.get(chain.robot, 0) for chain in union.chains),
            tuple(chain.robot for chain in new.chains),
            self.draw(new, self._luck.names),
            round(self.scenario.execution.recovery.planning_s * NANOSECONDS),
            time.process_time() - begin,
            cause_of(tpg, incident, range(executed + 1, planned + 1)),
            judged.words,
        )

    def _state(self) -> _Going:
        return _Going(
            self._cell,
            self._task_plan,
            self._steps,
            self._luck,
            self._ledger.copy(),
            self._past,
        )

    def _restore(self, going: _Going) -> None:
        self._cell, self._task_plan = going.cell, going.task_plan
        self._steps, self._past, self._luck = going.steps, going.past, going.luck
        self._ledger = going.ledger.copy()

    def _from_some_cut(
        self, tpg: TemporalPlanGraph, incident: Incident, judged: Judged
    ) -> tuple[TemporalPlanGraph, TemporalPlanGraph, Committed]:
        """Return the longer graph, the new one, and what was there before."""
        never, why = not_executed(tpg, incident), ""
        before, found = self._state(), []
        for cut in self.cuts:
            counts = cut_after(tpg, incident.released, never, steps=cut.steps)
            at = committed_at(tpg, counts, incident, judged)
            try:
                union, new = self._onward(at, aside=cut.aside)
            except (PlanInvariantError, TransitError, InfeasibleStepError) as error:
                why = str(error)
            else:
                more = len(self._ledger.given_up) - len(before.ledger.given_up)
                found.append((more, union, new, at, self._state()))
            self._restore(before)
            if found and found[-1][0] == 0:
                break
        if found:
            _, union, new, at, after = min(found, key=lambda item: item[0])
            self._restore(after)
            return union, new, at
        world = self._world(at)
        left = {item.step.step for item in leftovers(world, {}) if not item.ends}
        done = world.begun().keys() - left
        self._ledger.closed = True
        for step in self._window.all_steps(self._task_plan):
            if step not in done:
                self._ledger.give_up(step, why)
        nothing = committed_part(at.committed, [0] * len(at.committed.chains))
        waits = np.empty((0, 2), dtype=np.int64)
        union = extended(at.committed, nothing, self._cell, waits, order=at.robots)
        return union, nothing, at

    def _world(self, at: Committed) -> World:
        """Return the world once all that is committed is complete."""
        complete = set(at.complete)
        for task in at.tried:
            if task.step in at.judged.reopened or task.step in self._ledger.undone:
                complete.add(task.index)
        return World(
            at.state,
            self._steps,
            self._past,
            frozenset(complete),
            frozenset(self._ledger.gone | self._ledger.shunned) | at.out,
            len(at.committed.tasks),
        )

    def _onward(
        self, at: Committed, *, aside: bool
    ) -> tuple[TemporalPlanGraph, TemporalPlanGraph]:
        """Return the longer graph and the new one, giving up what cannot be done."""
        watch, goes_aside = StageWatch(), frozenset[str]()
        if aside:
            goes_aside = _standing(leftovers(self._world(at), {})) - at.out
        while True:
            world = self._world(at)
            reopened = {**at.judged.reopened, **self._interrupted(at.out, world)}
            for step in at.unwanted - (world.begun().keys() - reopened.keys()):
                self._ledger.drop(step)
            given_up = self._ledger.undone
            for step in given_up & world.begun().keys():
                reopened.setdefault(step, frozenset())
            now = Situation(
                world, self._task_plan, reopened, given_up, aside=goes_aside
            )
            if hopeless := self._hopeless(now):
                if not self._ledger.takes_what_is_there():
                    for step, why in hopeless.items():
                        self._ledger.give_up(step, why)
                    self._look_no_further(hopeless)
                continue
            try:
                found = plan_from(
                    self.motions,
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
                    others = _standing(left, but=error.step) - world.out
                if others - goes_aside:
                    goes_aside |= others
                elif not self._ledger.takes_what_is_there() and not self._retreat(
                    now, error
                ):
                    raise
                continue
            onward = found.onward
            come_up = onward.motions.cell.objects[len(self._cell.objects) :]
            self._cell = replace(self._cell, objects=(*self._cell.objects, *come_up))
            brought = brought_by(at.committed.tasks)
            late = supply_waits(found.tpg.tasks[now.world.tasks :], brought)
            waits = np.concatenate([onward.motions.dependencies, late])
            union = extended(
                at.committed, found.tpg, self._cell, waits, order=at.robots
            )
            if len(onward.task_plan.choices) > len(self._task_plan.choices):
                self._ledger.resting = resting_steps(
                    union.tasks, union.allowed, onward.task_plan
                )
                if self._ledger.falls():
                    continue
            self._task_plan = onward.task_plan
            self._steps, self._past = onward.steps, onward.past
            return union, found.tpg

    def _hopeless(self, now: Situation) -> dict[int, str]:
        """Return the steps that nobody can do any more, with the reason."""
        problem = narrowed(self.work.problem, now.kept, now.world.out, {})
        return {
            step: problem.lacking(step) or ""
            for step in problem.impossible
            if step not in now.kept
        }

    def _look_no_further(self, hopeless: Mapping[int, str]) -> None:
        """End the assembly before a step that comes into the window and that nobody can do."""
        planned = len(self._task_plan.choices)
        if new := [step for step in hopeless if step > planned]:
            first = min(new)
            self.motions = self._window.of_first(self.motions, first - 1)
            self._ledger.closed = True
            for step in self._window.all_steps(self._task_plan):
                if step > first:
                    self._ledger.give_up(step, f"step {first} is given up")

    def _retreat(self, now: Situation, error: TwinError) -> bool:
        """Give up a step, and tell whether there was one: that of the error, else what fewest rest on."""
        undone = self._ledger.undone
        left = [c.step for c in self._task_plan.choices if c.step not in undone]
        named = error.step if isinstance(error, TransitError) else None
        if named not in left:
            steps = [step for step in left if step not in now.kept]
            if not steps:
                return False
            named = min(steps, key=lambda k: (len(self._ledger.resting.get(k, ())), -k))
        assert named is not None
        self._ledger.give_up(named, str(error))
        return True

    def _judged(self, tpg: TemporalPlanGraph, incident: Incident) -> Judged:
        """Decide what is done about each failure, and what becomes of the object."""
        words, changes, reopened = [], [], dict[int, frozenset[str]]()
        for failure in incident.failures:
            task = tried_task(tpg, failure)
            change = self._changes(tpg, incident, failure, task)
            changes.append(change)
            self._ledger.tries[task.step, task.kind] += not failure.missing
            often = self._ledger.tries[task.step, task.kind]
            if often > self.scenario.execution.recovery.again:
                self._ledger.give_up(task.step, f"{task.label} failed {often} times")
                words.append(f"step {task.step} is given up")
            elif change or task.kind == "pick":
                reopened[task.step] = frozenset({task.robot})
                how = "is lost" if change else "is left where it is"
                how = "has not come yet" if failure.missing else how
                words.append(f"step {task.step} is begun anew: {task.object} {how}")
            else:
                words.append(f"{task.label} is done again")
        return Judged(tuple(words), tuple(changes), reopened)

    def _changes(
        self,
        tpg: TemporalPlanGraph,
        incident: Incident,
        failure: Failure,
        task: Task,
    ) -> tuple[Handling, ...]:
        """Return what becomes of the object of a skill that failed: nothing, unless it is lost."""
        name = task.object
        if name is None or task.kind not in HANDLING:
            return ()
        if failure.missing:
            self._ledger.shunned.add(name)
            return ()
        # What it holds does not change any more before its robot goes on.
        counts = cut_after(
            tpg, incident.released, not_executed(tpg, incident), steps=False
        )
        state = state_at(tpg, counts)
        at = state.attachments.get(name)
        retries = self.scenario.execution.failures[task.kind].retries
        if failure.attempts > retries or at is None:
            if task.kind == "pick":
                self._ledger.shunned.add(name)
            return ()
        self._ledger.gone.add(name)
        if at.holder is None:
            return (Handling(name, 1, GONE, at.pose),)
        pose = pose_of(tpg.cell, state, name)
        return Handling(name, 1, None, pose), Handling(name, 1, GONE, pose)

    def _interrupted(
        self, out: frozenset[str], world: World
    ) -> dict[int, frozenset[str]]:
        """Return the steps in the middle of which a robot is out; what it holds is lost."""
        self._ledger.gone |= {name for name, at in world.held() if at.holder in out}
        found = {}
        for number, step in world.begun().items():
            left = [t for t in step.tasks if t.index not in world.complete]
            if any(t.robot in out and t.kind != TRANSIT for t in left):
                self._ledger.gone |= {t.object for t in left if t.object is not None}
                found[number] = out
        return found


def _standing(left: Sequence[Leftover], but: int | None = None) -> frozenset[str]:
    """Return the robots that have something to bring to an end where they stand, but in one step."""
    return frozenset(
        task.robot
        for item in left
        if not item.ends and item.step.step != but
        for task in item.tasks
    )

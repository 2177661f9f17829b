"""What is done when a skill has failed for good, or a robot is out: a ladder of plans from the world as it is.

The skill again, or its step with what is left: another grip, another object of the kind, another robot, as
the integer program chooses; else the step is given up with what rests on it, and the rest goes on.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from planning.cell.workcell import Workcell
from planning.errors import (
    InfeasibleStepError,
    PlanInvariantError,
    TransitError,
    TwinError,
)
from planning.motion.known_motions import KnownMotions
from planning.tasks.assignment import TaskPlan
from planning.tasks.task import GONE, TAKEN_OUT, TRANSIT, Handling, StepTasks, Task
from planning.tasks.work import AssemblyWork
from planning.worlds.onward import Situation, narrowed
from planning.worlds.world import World, leftovers
from scheduling.graph.dispatcher import earliest_times
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.rolling.attempt import with_attempt
from scheduling.rolling.cut import complete_tasks, cut_after, world_at
from scheduling.rolling.extension import committed_part, extended
from twin.durations.model import NANOSECONDS
from twin.host.progress import StageWatch
from twin.operate.dependents import resting_steps
from twin.operate.rolling import Failure, Incident, Version
from twin.planning.kind import PlannedMotions
from twin.planning.onward import plan_from
from twin.scenario.sections.scenario import Scenario
from twin.uncertainty.chain_draws import HANDLING
from twin.uncertainty.node_times import NodeTimes

Draw = Callable[[TemporalPlanGraph], NodeTimes]
"""Returns the times of the nodes of a graph."""


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
    """What is known of a plan from which it can be gone on."""

    cell: Workcell
    task_plan: TaskPlan
    steps: tuple[StepTasks, ...] | None
    past: tuple[StepTasks, ...]
    given_up: dict[int, str]
    gone: frozenset[str]
    shunned: frozenset[str]


@dataclass
class Recovery:
    """Plans what is left of an assembly whenever something has failed.

    Attributes:
        scenario: its recovery section says how.
        motions: what the first plan was made of.
        cell: as it was at the start, with the objects that have come up since.
        draw: times of new nodes.
        given_up: steps that are not done any more, by number, with the reason.
        planning_s: processor seconds of each plan.
        cuts: that are tried; the one from which least is given up, and the sooner end is seen, is taken.
    """

    scenario: Scenario
    motions: PlannedMotions
    cell: Workcell
    draw: Draw
    given_up: dict[int, str] = field(default_factory=dict)
    planning_s: list[float] = field(default_factory=list)
    cuts: tuple[Recut, ...] = (Recut(steps=True), Recut(steps=False, aside=True))
    _known: KnownMotions = field(default_factory=KnownMotions)
    _steps: tuple[StepTasks, ...] | None = None
    _past: tuple[StepTasks, ...] = ()
    _gone: set[str] = field(default_factory=set)
    _shunned: set[str] = field(default_factory=set)
    _tries: Counter[tuple[int, str]] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        settings = self.motions.settings
        seconds = {TAKEN_OUT: self.scenario.execution.recovery.remove_s}
        settings = replace(
            settings, skill_seconds={**settings.skill_seconds, **seconds}
        )
        self.motions = replace(self.motions, settings=settings)
        self._task_plan = self.motions.task_plan
        self._contacts = resting_steps(self.motions)

    @property
    def work(self) -> AssemblyWork:
        """All candidates."""
        assert self.motions.work is not None
        return self.motions.work

    def plan(self, tpg: TemporalPlanGraph, incident: Incident) -> Version:
        """Return the graph that goes on, from the best cut from which anything does."""
        begin = time.process_time()
        judged = self._judged(tpg, incident)
        union, new, counts = self._from_some_cut(tpg, incident, judged)
        self.planning_s.append(time.process_time() - begin)
        times = self.draw(new)
        drawn = {
            chain.robot: (
                times.motion[k],
                times.stood[k],
                times.standstills[k],
                times.failed[k],
            )
            for k, chain in enumerate(new.chains)
        }
        return Version(
            union,
            tuple(counts.get(chain.robot, 0) for chain in union.chains),
            drawn,
            round(self.scenario.execution.recovery.planning_s * NANOSECONDS),
            self._cause(tpg, incident),
            judged.words,
        )

    def _state(self) -> _Going:
        return _Going(
            self.cell,
            self._task_plan,
            self._steps,
            self._past,
            dict(self.given_up),
            frozenset(self._gone),
            frozenset(self._shunned),
        )

    def _restore(self, plan: _Going) -> None:
        self.cell, self._task_plan = plan.cell, plan.task_plan
        self._steps, self._past = plan.steps, plan.past
        self.given_up = dict(plan.given_up)
        self._gone, self._shunned = set(plan.gone), set(plan.shunned)

    def _from_some_cut(
        self, tpg: TemporalPlanGraph, incident: Incident, judged: _Judged
    ) -> tuple[TemporalPlanGraph, TemporalPlanGraph, dict[str, int]]:
        """Return the longer graph, the new one, and how many nodes of each robot were there before."""
        never, why = _never(tpg, incident), ""
        before, found = self._state(), []
        for cut in self.cuts:
            counts = cut_after(tpg, incident.released, never, steps=cut.steps)
            committed = self._committed(tpg, counts, incident, judged)
            own = {chain.robot: len(chain) for chain in committed.chains}
            try:
                union, new = self._onward(tpg, committed, counts, incident, judged, cut)
            except (PlanInvariantError, TransitError, InfeasibleStepError) as error:
                why = str(error)
            else:
                ends = len(self.given_up), earliest_times(union).makespan
                found.append((ends, union, new, own, self._state()))
            self._restore(before)
        if found:
            _, union, new, own, after = min(found, key=lambda item: item[0])
            self._restore(after)
            return union, new, own
        world = self._world(tpg, committed, counts, incident, judged)
        left = {item.step.step for item in leftovers(world, {}) if not item.ends}
        done = world.begun().keys() - left
        for choice in self._task_plan.choices:
            if choice.step not in done:
                self._give_up(choice.step, why)
        nothing = committed_part(committed, [0] * len(committed.chains))
        order = [chain.robot for chain in tpg.chains]
        waits = np.empty((0, 2), dtype=np.int64)
        union = extended(committed, nothing, self.cell, waits, order=order)
        return union, nothing, own

    def _committed(
        self,
        tpg: TemporalPlanGraph,
        counts: Sequence[int],
        incident: Incident,
        judged: _Judged,
    ) -> TemporalPlanGraph:
        committed = committed_part(tpg, counts)
        for failure, changes in zip(incident.failures, judged.changes, strict=True):
            robot = tpg.chains[failure.chain].robot
            committed = with_attempt(committed, tpg, robot, failure.node, changes)
        return committed

    def _world(
        self,
        tpg: TemporalPlanGraph,
        committed: TemporalPlanGraph,
        counts: Sequence[int],
        incident: Incident,
        judged: _Judged,
    ) -> World:
        """Return the world once all that is committed is complete."""
        full = [len(chain) for chain in committed.chains]
        complete = set(complete_tasks(tpg, counts))
        for failure in incident.failures:
            task = tpg.tasks[int(tpg.chains[failure.chain].task[failure.node])]
            if task.step in judged.reopened or task.step in self.given_up:
                complete.add(task.index)
        steps = self._steps
        if steps is None:
            steps = world_at(tpg, counts, borders=False).steps
        return World(
            world_at(committed, full, borders=False).state,
            steps,
            self._past,
            frozenset(complete),
            frozenset(self._gone | self._shunned) | incident.out,
            len(committed.tasks),
        )

    def _onward(
        self,
        tpg: TemporalPlanGraph,
        committed: TemporalPlanGraph,
        counts: Sequence[int],
        incident: Incident,
        judged: _Judged,
        cut: Recut,
    ) -> tuple[TemporalPlanGraph, TemporalPlanGraph]:
        """Return the longer graph and the new one, giving up what cannot be done."""
        watch, aside = StageWatch(), frozenset[str]()
        if cut.aside:
            aside = frozenset(self._standing(tpg, counts)) - incident.out
        while True:
            world = self._world(tpg, committed, counts, incident, judged)
            reopened = {**judged.reopened, **self._interrupted(incident.out, world)}
            for step in self.given_up.keys() & world.begun().keys():
                reopened.setdefault(step, frozenset())
            given_up = frozenset(self.given_up)
            now = Situation(world, self._task_plan, reopened, given_up, aside=aside)
            hopeless = self._hopeless(now)
            if hopeless:
                if self._shunned:
                    self._shunned.clear()
                    continue
                for step, why in hopeless.items():
                    self._give_up(step, why)
                continue
            try:
                found = plan_from(
                    self.motions,
                    self.scenario,
                    self.cell,
                    now,
                    committed.tasks,
                    watch,
                    candidates=self.scenario.execution.recovery.shortcuts,
                    known=self._known,
                )
            except (InfeasibleStepError, TransitError) as error:
                others = self._in_the_way(now, error)
                if others - aside:
                    aside |= others
                    continue
                if not self._retreat(now, error):
                    raise
                continue
            onward = found.onward
            come_up = onward.motions.cell.objects[len(self.cell.objects) :]
            cell = replace(self.cell, objects=(*self.cell.objects, *come_up))
            union = extended(
                committed,
                found.tpg,
                cell,
                onward.motions.dependencies,
                order=[chain.robot for chain in tpg.chains],
            )
            self.cell, self._task_plan = cell, onward.task_plan
            self._steps, self._past = onward.steps, onward.past
            return union, found.tpg

    def _standing(self, tpg: TemporalPlanGraph, counts: Sequence[int]) -> Iterator[str]:
        """Yield the robots that have something to bring to an end where they stand."""
        world = world_at(tpg, counts, borders=False)
        steps = world.steps if self._steps is None else self._steps
        world = replace(world, steps=steps)
        for item in leftovers(world, {}):
            if not item.ends:
                yield from (task.robot for task in item.tasks)

    def _in_the_way(self, now: Situation, error: TwinError) -> frozenset[str]:
        """Return the robots that stand with something to bring to an end, but in the step of an error."""
        if not isinstance(error, TransitError):
            return frozenset()
        robots = {
            task.robot
            for item in leftovers(now.world, now.reopened)
            if not item.ends and item.step.step != error.step
            for task in item.tasks
        }
        return frozenset(robots - now.world.out)

    def _hopeless(self, now: Situation) -> dict[int, str]:
        """Return the steps that nobody can do any more, with the reason."""
        problem = narrowed(self.work.problem, now.kept, now.world.out, {})
        return {
            step: problem.lacking(step) or ""
            for step in problem.impossible
            if step not in now.kept and step not in self.given_up
        }

    def _retreat(self, now: Situation, error: TwinError) -> bool:
        """Give up a step, and tell whether there was one: that of the error, else what fewest rest on."""
        left = [c.step for c in self._task_plan.choices if c.step not in self.given_up]
        named = error.step if isinstance(error, TransitError) else None
        if named not in left:
            steps = [step for step in left if step not in now.kept]
            if not steps:
                return False
            named = min(steps, key=lambda k: (len(self._contacts.get(k, ())), -k))
        assert named is not None
        self._give_up(named, str(error))
        return True

    def _give_up(self, step: int, why: str) -> None:
        """Give up a step with all that rests on it."""
        todo = [step]
        while todo:
            one = todo.pop()
            if one not in self.given_up:
                words = why if one == step else f"it rests on step {step}"
                self.given_up[one] = words.splitlines()[0]
                todo += [k for k in self._contacts.get(one, ()) if k > one]

    def _judged(self, tpg: TemporalPlanGraph, incident: Incident) -> _Judged:
        """Decide what is done about each failure, and what becomes of the object."""
        words, changes, reopened = [], [], dict[int, frozenset[str]]()
        for failure in incident.failures:
            chain = tpg.chains[failure.chain]
            task = tpg.tasks[int(chain.task[failure.node])]
            change = self._changes(tpg, incident, failure, task)
            changes.append(change)
            self._tries[task.step, task.kind] += 1
            often = self._tries[task.step, task.kind]
            if often > self.scenario.execution.recovery.again:
                self._give_up(task.step, f"{task.label} failed {often} times")
                words.append(f"step {task.step} is given up")
            elif change or task.kind == "pick":
                reopened[task.step] = frozenset({task.robot})
                how = "is lost" if change else "is left where it is"
                words.append(f"step {task.step} is begun anew: {task.object} {how}")
            else:
                words.append(f"{task.label} is done again")
        return _Judged(tuple(words), tuple(changes), reopened)

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
        # What it holds does not change any more before its robot goes on.
        counts = cut_after(tpg, incident.released, _never(tpg, incident), steps=False)
        world = world_at(tpg, counts, borders=False)
        at = world.state.attachments.get(name)
        retries = self.scenario.execution.failures[task.kind].retries
        if failure.attempts > retries or at is None:
            if task.kind == "pick":
                self._shunned.add(name)
            return ()
        self._gone.add(name)
        if at.holder is None:
            return (Handling(name, 1, GONE, at.pose),)
        pose = world.pose_of(tpg.cell, name)
        return Handling(name, 1, None, pose), Handling(name, 1, GONE, pose)

    def _interrupted(
        self, out: frozenset[str], world: World
    ) -> dict[int, frozenset[str]]:
        """Return the steps in the middle of which a robot is out; what it holds is lost."""
        self._gone |= {name for name, at in world.held() if at.holder in out}
        found = {}
        for number, step in world.begun().items():
            left = [t for t in step.tasks if t.index not in world.complete]
            if any(t.robot in out and t.kind != TRANSIT for t in left):
                self._gone |= {t.object for t in left if t.object is not None}
                found[number] = out
        return found

    def _cause(self, tpg: TemporalPlanGraph, incident: Incident) -> str:
        words = [
            tpg.tasks[int(tpg.chains[f.chain].task[f.node])].label + " failed"
            for f in incident.failures
        ]
        words += [f"{name} is out" for name in sorted(incident.out)]
        return "; ".join(words)


def _never(tpg: TemporalPlanGraph, incident: Incident) -> list[tuple[int, int]]:
    """Return the nodes that are not executed any more, nor what waits for them."""
    index = tpg.chain_index
    never = [(failure.chain, failure.node) for failure in incident.failures]
    never += [
        (index[robot], incident.released[index[robot]])
        for robot in sorted(incident.out & index.keys())
    ]
    return never


@dataclass(frozen=True)
class _Judged:
    """What is done about failures.

    Attributes:
        words: for people, one entry a failure.
        changes: what becomes of the object of each.
        reopened: steps that are begun anew, with the robots that have nothing to bring to an end in them.
    """

    words: tuple[str, ...]
    changes: tuple[tuple[Handling, ...], ...]
    reopened: dict[int, frozenset[str]]

"""Remaining work of a run at a given time, planned from the world state at that time.

Parts of the old plan that were not executed are discarded. Steps that have begun keep the robots, objects, grips and
supports of their tasks; the choices of all other steps are made again.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from planning.cell.workcell import Begun
from planning.errors import RequestError
from planning.tasks.assembly import Assembly
from planning.tasks.assignment import AssignmentProblem, StepChoice, TaskPlan
from planning.tasks.task import (
    Handling,
    StepTasks,
    Task,
    TaskKind,
    changed_tools,
)
from planning.worlds.measured import MeasuredWork
from planning.worlds.supplied import REMOVAL
from planning.worlds.world import World, picked_steps
from scheduling.graph.plan_files import plan_sha256
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.planned_motions import PlannedMotions
from scheduling.rolling.cut import Counts, complete_tasks, planned_steps
from scheduling.rolling.supply import drop_history, resume_machines
from twin.operations.commitment import (
    CommittedPrefix,
    CutPolicy,
    Failure,
    ReplanTrigger,
)
from twin.operations.person import Person
from twin.operations.planner import Planner
from twin.operations.recovery import Recovery
from twin.planning.pipeline import planned_shortcuts
from twin.registry import RECOVERIES
from twin.scenario.sections.scenario import Scenario
from twin.uncertainty.draws import TaskName
from twin.uncertainty.node_times import NodeTimes

_SAME = 1e-6
"""Joint values of a task that differ by less, in turns, are the same."""


@dataclass(frozen=True)
class RunRemainder:
    """What a run leaves to do from a cut on, as the start of another plan.

    Attributes:
        scenario: assembly and planning settings.
        tpg: the executed plan.
        counts: number of nodes of each chain complete at the cut.
        failures: skills that have failed for good, and of which nothing was made.
        out: robots that are out from then on.
        left_s: machines that are at work when all robots are at rest there, with how long still [s].
        ago: how long before all robots are at rest there tasks ended that opened windows of time, by index [s].
        when: the time, for people.
        undone: abandoned or dropped steps, by number, with the reason.
    """

    scenario: Scenario
    tpg: TemporalPlanGraph
    counts: Counts
    failures: tuple[Failure, ...]
    out: frozenset[str]
    left_s: Mapping[str, float]
    ago: Mapping[int, float]
    when: str
    undone: Mapping[int, str]

    @property
    def steps(self) -> int:
        """Number of steps of the executed plan."""
        return max((task.step for task in self.tpg.tasks), default=0)

    def continue_with(self, motions: PlannedMotions) -> TemporalPlanGraph:
        """Return the plan of the remainder, beginning in the world at the cut.

        Args:
            motions: of a plan of all of it.

        Raises:
            RequestError: a robot cannot continue, or nothing is left.
        """
        tpg, counts = self.tpg, self.counts
        done = complete_tasks(tpg, counts)
        world = World(tpg.cell.start_state(), planned_steps(tpg), complete=done)
        planner = self._planner(motions, world)
        trigger = ReplanTrigger(self.failures, self.out, frozenset(), counts, self.ago)
        state, extension = planner.extend_initial(trigger)
        union, new, at = extension
        first = len(at.committed.tasks)
        _require_whole(state.ledger.given_up, new, at, self.undone)
        if not len(new.tasks) > first:
            raise RequestError(f"nothing is left to do at {self.when}")
        kinds = Counter(tpg.tasks[k].kind for k in done)
        after = f"{self.scenario.name} {plan_sha256(tpg)[:12]} at {self.when}"
        counted = tuple(sorted(kinds.items()))
        steps = tuple(world.done_steps())
        begun = Begun(after, counted, tuple(sorted(self.out)), steps)
        own = drop_history(new, first, begun, room=len(self.left_s))
        return resume_machines(own, union, at.lengths, self.left_s)

    def _planner(self, motions: PlannedMotions, world: World) -> Planner[Any]:
        """Return what plans the remainder; begun steps keep their choices."""
        scenario, tpg = self.scenario, self.tpg
        before = [h for h in tpg.handlings if h.node < self.counts[h.robot]]
        gone = frozenset(h.object for h in before if h.holder == Handling.GONE)
        nobody = Person(None, scenario.seed)
        if (kind := scenario.assembly.kind) in RECOVERIES:
            planner: Planner[Any] = RECOVERIES.load(kind)(
                scenario, motions, tpg, _no_draws, nobody, gone, steps=False
            )
            return planner
        measured = {
            h.object: h.pose
            for h in before
            if tpg.task_of(h).kind == TaskKind.FAILED
            and tpg.task_of(h).object == h.object
            and h.holder is None
            and h.object not in gone
        }
        assert motions.work is not None
        _require_tried_once(tpg, world)
        work = MeasuredWork().find(motions.work, measured) or motions.work
        work = _with_used_objects(work, world.begun())
        known = {k: own for k, own in world.begun().items() if k not in self.undone}
        chosen = _choices_of(work, motions.task_plan, known)
        return Recovery(
            _with_shortcuts(scenario),
            replace(motions, task_plan=chosen, work=work),
            tpg,
            _no_draws,
            nobody,
            gone,
            measured,
            self.undone,
            cuts=((CutPolicy(),), (CutPolicy(evade=True),)),
        )


def _require_tried_once(tpg: TemporalPlanGraph, world: World) -> None:
    """Refuse a cut within a step that failed later: its state is not recorded in the run.

    Raises:
        RequestError: names the step.
    """
    failed = {
        task.step
        for task in tpg.tasks
        if task.kind == TaskKind.FAILED and task.index not in world.complete
    }
    for number, step in world.begun().items():
        left = {
            t.index for t in step.tasks if t.kind != TaskKind.TRANSIT
        } - world.complete
        if number in failed and left:
            raise RequestError(
                f"step {number} is in the middle then, and fails later in this run: take a time before it was begun or"
                " after it last failed"
            )


def _require_whole(
    given_up: Mapping[int, str],
    new: TemporalPlanGraph,
    at: CommittedPrefix,
    known: Collection[int],
) -> None:
    """Refuse a remainder that cannot be planned.

    Raises:
        RequestError: it cannot; names object and reason.
    """
    for name, place in at.state.attachments.items():
        if place.holder in at.out:
            raise RequestError(
                f"{place.holder!r} is out and has {name!r} in its hand: only a person can take it from there"
            )
    if steps := [
        f"step {k}: {why}" for k, why in sorted(given_up.items()) if k not in known
    ]:
        raise RequestError("not all steps can be done from there: " + "; ".join(steps))
    for task in new.tasks[len(at.committed.tasks) :]:
        if task.kind == TaskKind.TAKEN_OUT and task.robot != REMOVAL:
            raise RequestError(
                f"{task.robot!r} has {task.object!r} in its hand, which has nowhere to go"
            )


def _with_shortcuts(scenario: Scenario) -> Scenario:
    """Return a scenario with the shortcut effort of a whole plan."""
    own = scenario.execution
    recovery = own.recovery.changed(shortcuts=planned_shortcuts(scenario))
    return scenario.changed(execution=own.changed(recovery=recovery))


def _no_draws(_graph: TemporalPlanGraph, _names: Mapping[int, TaskName]) -> NodeTimes:
    raise AssertionError("a plan is made and not executed")


def _with_used_objects(work: Assembly, begun: Mapping[int, StepTasks]) -> Assembly:
    """Return the work with the spare objects used so far."""
    for number, step in sorted(begun.items()):
        known = {item.object for item in work.problem.primaries if item.step == number}
        picked = {t.object for t in step.tasks if t.kind == "pick" and t.object}
        if picked - known:
            work = work.with_spares(number, picked - known) or work
    return work


def _choices_of(
    work: Assembly, plan: TaskPlan, begun: Mapping[int, StepTasks]
) -> TaskPlan:
    """Return choices that keep the tasks of started steps.

    Raises:
        RequestError: a started step matches no known candidate.
    """
    every = {task.index for step in begun.values() for task in step.tasks}
    plan = replace(plan, taken=picked_steps(begun, every))
    for number, step in sorted(begun.items()):
        skills = [
            task for task in step.tasks if task.kind != TaskKind.TRANSIT or task.goal
        ]
        for choice in _choices(work.problem, plan, number, skills):
            tried = plan.with_choice(choice)
            fresh = work.expand(tried, number, 0).tasks
            # Which tools were changed before it depends on what had failed by then.
            tools = changed_tools(fresh)
            needed = [
                task
                for task in fresh
                if (task.kind != TaskKind.TRANSIT or task.goal)
                and task.object not in tools
            ]
            if all(any(_alike(a, b) for b in skills) for a in needed):
                plan = tried
                break
        else:
            raise RequestError(
                f"step {number} was done in a way that is none of those of its scenario"
            )
    return plan


def _choices(
    problem: AssignmentProblem, plan: TaskPlan, step: int, done: Sequence[Task]
) -> Iterator[StepChoice]:
    """Yield the candidates of a step with its robots, the planned one first."""
    robots = {task.robot for task in done}
    yield plan[step]
    for p in problem.primaries_of.get(step, ()):
        primary = problem.primaries[p]
        if primary.robot not in robots:
            continue
        if not problem.needs_support[step - 1]:
            yield StepChoice(primary)
            continue
        for s in problem.supports_of.get(step, ()):
            support = problem.supports[s]
            if support.robot in robots and problem.compatible(p, s):
                yield StepChoice(primary, support)


def _alike(one: Task, other: Task) -> bool:
    """Return whether two tasks are equal up to their numbers and full turns of joints."""
    names = one.robot, one.kind, one.object, one.path.shape
    if names != (other.robot, other.kind, other.object, other.path.shape):
        return False
    away = (one.path - other.path) / (2.0 * np.pi)
    return bool(np.all(np.abs(away - np.rint(away)) <= _SAME))

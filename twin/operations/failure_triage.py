"""Triage of skills whose attempts have all failed.

The possible decisions are to retry the skill, to restart its step, to ask a person, or to abandon the step.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from planning.cell.workcell import Workcell
from planning.errors import PlanInvariantError
from planning.tasks.assembly import Assembly
from planning.tasks.assignment import AssignmentProblem, TaskPlan
from planning.tasks.task import AllowedContact, Handling, Task, TaskKind
from planning.transforms import Transform
from planning.worlds.measured import Poses, offset_on_surface
from planning.worlds.onward import ReplanningState, fix_choices
from planning.worlds.world import World, object_pose
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.invariant import check_invariant
from scheduling.rolling.cut import complete_tasks, world_state_after
from scheduling.rolling.extension import committed_subgraph, with_attempt
from twin.operations.commitment import (
    Failure,
    ReplanTrigger,
    TriageResult,
    cut_at,
    failed_task,
)
from twin.operations.ledger import LedgerDraft
from twin.operations.person import AGAIN, Person, Question
from twin.scenario.sections.execution import ExecutionSection
from twin.uncertainty.disturbances import SkillFailure
from twin.uncertainty.draws import uniforms

_NO_PROCESS = (
    *(
        *TaskKind.HANDLING,
        *TaskKind.SUPPLY,
        TaskKind.TRANSIT,
        TaskKind.STRAIGHT,
        TaskKind.HOLD,
        TaskKind.FAILED,
        TaskKind.LEFT_OUT,
    ),
    *(TaskKind.LEAVE_TOOL, TaskKind.TAKE_TOOL, TaskKind.TAKEN_OUT),
)


def processes(tasks: Iterable[Task]) -> Iterator[Task]:
    """Yield the processes among tasks."""
    return (task for task in tasks if task.kind not in _NO_PROCESS)


class ObjectOutcome(StrEnum):
    """Outcome for the object of a failed skill; the value is its text."""

    LOST = "is lost"
    SLIPPED = "has slipped in the hand"
    WRONG = "is a wrong part"
    BESIDE = "lies beside its place"


@dataclass(frozen=True)
class FailureTriage:
    """Decides the recovery from each failure, and enters it into the ledger.

    Attributes:
        section: execution section: failures and number of retries.
        ledger: state of the operation; it is updated.
        person: answers questions before a step is abandoned.
        allows: returns whether parts can be used at their measured poses.
        is_named: returns whether a step has one of some names.
    """

    section: ExecutionSection
    ledger: LedgerDraft
    person: Person
    allows: Callable[[Poses], bool] = lambda _: False
    is_named: Callable[[int, Collection[str]], bool] = lambda *_: False

    def decide(self, tpg: TemporalPlanGraph, trigger: ReplanTrigger) -> TriageResult:
        """Decide the recovery from each failure, and the change of its object."""
        words, changes, reopened = [], [], dict[int, frozenset[str]]()
        for failure in trigger.failures:
            task = failed_task(tpg, failure)
            change, fate = self._object_changes(tpg, trigger, failure, task)
            changes.append(change)
            self.ledger.tries[task.step, task.kind] += not failure.missing
            often, said = self.ledger.tries[task.step, task.kind], self._said(task)
            limit = said.most(self.section.recovery.again)
            if task.step in self.ledger.rejected:
                words.append(f"{task.object} is left to a person")
            elif often > limit and not self._requests_repair(task):
                self.ledger.give_up(task.step, f"{task.label} failed {often} times")
                self._reject(task, said)
                reopened[task.step] = frozenset({task.robot})
                words.append(f"step {task.step} is given up")
            elif fate or task.kind == "pick":
                reopened[task.step] = frozenset({task.robot})
                how = fate or "is left where it is"
                how = "has not come yet" if failure.missing else how
                words.append(f"step {task.step} is begun anew: {task.object} {how}")
            elif said.then == "scrap":
                self.ledger.give_up(task.step, f"{task.object} is scrapped")
                self._reject(task, said)
                reopened[task.step] = frozenset({task.robot})
                words.append(f"step {task.step} is given up: {task.object} is scrapped")
            elif said.then == "rework" and (
                before := self._processes_at(tpg, trigger, task)
            ):
                order = (work.step for work in before if said.named)
                self.ledger.reworked[task.step] = tuple(order)
                reopened |= {work.step: frozenset[str]() for work in before}
                reopened[task.step] = frozenset({task.robot})
                *most, last = [work.label for work in before]
                several = f"{', '.join(most)} and {last} are" if most else f"{last} is"
                words.append(f"{several} done again, and then {task.label}")
            else:
                words.append(f"{task.label} is done again")
        return TriageResult(tuple(words), tuple(changes), reopened)

    def _requests_repair(self, task: Task) -> bool:
        """Ask a person to fix a repeated failure; return whether that helps."""
        rework = self._said(task).rework
        if task.step in self.ledger.undone or (rework and rework.then == "scrap"):
            return False
        words = (
            f"{task.label} failed again and again: will you see to step {task.step}?"
        )
        count = self.ledger.asked_for(task.step)
        question = Question(task.step, count, task.kind, task.object, words)
        ask = self.person.asked(self.ledger.asks, question)
        if ask is None or not self.ledger.answered(ask):
            return False
        self.ledger.tries[task.step, task.kind] = 0
        return True

    def _processes_at(
        self, tpg: TemporalPlanGraph, trigger: ReplanTrigger, task: Task
    ) -> list[Task]:
        """Return the processes to be repeated before a failed one, by step.

        Those done to its part since that was last handled, or the named ones, apart from abandoned steps.
        """
        named = self._said(task).named
        clock, counts = trigger.clock, trigger.released
        if clock is not None:
            counts = tuple(map(len, clock.ended_s))
        done = complete_tasks(tpg, counts)
        own = [t for t in tpg.tasks if t.object == task.object and t.step < task.step]
        came = [t.step for t in own if t.handlings or t.kind in TaskKind.HANDLING]
        since = max(came, default=0)
        works = {
            t.step: t
            for t in processes(own)
            if t.step > since and t.index in done
            if not named or self.is_named(t.step, named)
        }
        return [works[k] for k in sorted(works.keys() - self.ledger.undone)]

    def _said(self, task: Task) -> SkillFailure:
        """Return the section of failures of a skill."""
        never = SkillFailure(probability=0.0)
        return self.section.failures.get(task.kind, never)

    def _reject(self, task: Task, said: SkillFailure) -> None:
        """Record the part of an abandoned process as rejected, if there is a bin for it."""
        if said.then != "again" and self.section.recovery.bin and task.object:
            self.ledger.rejected[task.step] = self.ledger.lost(task.object)

    def _object_outcome(self, task: Task, *, held: bool) -> ObjectOutcome:
        """Return the outcome for the object of a failed skill."""
        said = self.section.failures.get(task.kind)
        if said is None:
            return ObjectOutcome.LOST
        drawn = self._draw(task, "fate")
        if drawn < (said.slips if held else said.wrong):
            return ObjectOutcome.SLIPPED if held else ObjectOutcome.WRONG
        beside = not held and drawn < said.wrong + said.beside
        return ObjectOutcome.BESIDE if beside else ObjectOutcome.LOST

    def _draw(self, task: Task, what: str, index: int = 0) -> float:
        """Return the uniform draw in [0, 1) for the failure of a task."""
        number = task.step + self.ledger.tries[task.step, task.kind] * AGAIN
        mine = [self.person.replication]
        about = self.person.seed, mine, [task.kind], number, [what], "failure"
        return float(uniforms(*about, index)[0][0])

    def _displacement(
        self,
        tpg: TemporalPlanGraph,
        trigger: ReplanTrigger,
        failure: Failure,
        task: Task,
    ) -> Handling | None:
        """Return the measured pose of a displaced part; None where it cannot be used there."""
        name = str(task.object)
        planned = self.ledger.lost(name)
        lay = self.ledger.measured.get(planned, tpg.cell.object(name).start)
        offset = self.section.failures[task.kind].offset
        far, around, turned = (self._draw(task, "offset", k) for k in range(3))
        angle = 2.0 * np.pi * around
        displacement = (
            offset.m * np.sqrt(far) * np.array([np.cos(angle), np.sin(angle)])
        )
        pose = offset_on_surface(lay, displacement, offset.rad * (2.0 * turned - 1.0))
        found = Handling(name, 1, None, pose)
        who = tpg.chains[failure.chain].robot
        committed = committed_subgraph(tpg, cut_at(tpg, trigger))
        there = with_attempt(committed, tpg, who, failure.node, (found,))
        try:
            # The others continue a plan that has the part at its nominal pose.
            check_invariant(DerivedTpg(there))
        except PlanInvariantError:
            return None
        poses = {**self.ledger.measured, planned: pose}
        return found if self.allows(poses) else None

    def _object_changes(
        self,
        tpg: TemporalPlanGraph,
        trigger: ReplanTrigger,
        failure: Failure,
        task: Task,
    ) -> tuple[tuple[Handling, ...], str]:
        """Return the change of a failed skill's object, and a message if it is lost."""
        name = task.object
        if name is None or task.kind not in TaskKind.HANDLING:
            return (), ""
        if failure.missing:
            self.ledger.unpickable.add(self.ledger.lost(name))
            return (), ""
        # A held object stays in the hand until its robot continues.
        state = world_state_after(tpg, cut_at(tpg, trigger, steps=False))
        at = state.attachments.get(name)
        if not failure.lost or at is None:
            if task.kind == "pick":
                self.ledger.unpickable.add(self.ledger.lost(name))
            return (), ""
        fate = self._object_outcome(task, held=at.holder is not None)
        words = fate.value
        if fate is ObjectOutcome.BESIDE and task.step not in self.ledger.rejected:
            if found := self._displacement(tpg, trigger, failure, task):
                self.ledger.measured[self.ledger.lost(name)] = found.pose
                return (found,), _displacement_text(at.pose, found.pose)
            words = f"{words}, where nobody can pick it"
        self.ledger.gone.add(self.ledger.lost(name))
        # A station presents the next object, wherever this one is.
        coming = () if at.holder else _appearing_objects(task)
        if fate is not ObjectOutcome.LOST and not coming:
            return (), words  # it is still where it was
        if at.holder is None:
            return (Handling(name, 1, Handling.GONE, at.pose), *coming), words
        pose = object_pose(tpg.cell, state, name)
        return (
            Handling(name, 1, None, pose),
            Handling(name, 1, Handling.GONE, pose),
        ), words


def _appearing_objects(task: Task) -> tuple[Handling, ...]:
    """Return the objects that appear once an object has been picked."""
    return tuple(
        replace(h, waypoint=1) for h in task.handlings if h.object != task.object
    )


def _displacement_text(said: Transform, found: Transform) -> str:
    """Return the displacement of a part from its place, as text."""
    mm = 1e3 * float(np.linalg.norm(found[:3, 3] - said[:3, 3]))
    turn = found[:3, :3] @ said[:3, :3].T
    deg = float(np.degrees(abs(np.arctan2(turn[1, 0], turn[0, 0]))))
    return f"{ObjectOutcome.BESIDE}, {mm:.1f} mm and {deg:.1f} degrees off, and is picked there"


def request_replacement(
    ledger: LedgerDraft,
    person: Person,
    cell: Workcell,
    step: int,
    name: str,
    why: str,
) -> bool:
    """Ask a person for a replacement of a lost object; return whether a person was asked.

    Args:
        ledger: state of the operation; it is updated.
        person: answers the question.
        cell: with all objects that there are.
        step: step that lacks the object; abandoned if there is no replacement.
        name: name of the lost object.
        why: reason to give it up.
    """
    words = f"step {step} lacks an object: will you bring one in place of {name}?"
    taken = [item.name for item in cell.objects]
    question = Question(step, ledger.asked_for(step), "", name, words)
    ask = person.asked(ledger.asks, question, taken)
    if ask is not None and not ledger.answered(ask):
        said = why.partition("\n")[0]
        ledger.give_up(step, f"{said}, and a person could not help")
    return ask is not None


def interrupted_steps(
    ledger: LedgerDraft, out: frozenset[str], world: World
) -> dict[int, frozenset[str]]:
    """Return the steps interrupted by an outage of their robot, whose held object is lost."""
    ledger.gone |= {name for name, at in world.held() if at.holder in out}
    found = {}
    for number, step in world.begun().items():
        left = [
            t
            for t in step.tasks
            if t.index not in world.complete and t.kind not in TaskKind.SUPPLY
        ]
        if any(t.robot in out and t.kind != TaskKind.TRANSIT for t in left):
            ledger.gone |= {t.object for t in left if t.object is not None}
            found[number] = out
    return found


def dependent_steps(
    tasks: Iterable[Task],
    allowed: Iterable[AllowedContact],
    chosen: TaskPlan,
    needs: Iterable[tuple[int, int]],
) -> Mapping[int, frozenset[int]]:
    """Return the later steps that depend on a step, by number.

    In these steps something touches the object at its place, or would fall without it.

    Args:
        tasks: of a plan.
        allowed: allowed contacts in them.
        chosen: choices, with the objects of steps that are not done.
        needs: supports without which parts fall, see ``Assembly.needs``.
    """
    tasks = tuple(tasks)
    placed = {choice.object: choice.step for choice in chosen.choices}
    placed.update((name, step) for step, name in chosen.taken.items())
    for task in tasks:
        if task.kind in ("place-down", "place-up") and task.object is not None:
            placed[task.object] = task.step
    step_of = {task.index: task.step for task in tasks}
    works = {
        t.index for t in tasks if t.kind not in (TaskKind.TRANSIT, "pick", "handover")
    }
    found: dict[int, set[int]] = {}
    for first, later in needs:
        found.setdefault(first, set()).add(later)
    for contact in allowed:
        for name in (contact.first, contact.second):
            step = placed.get(name)
            if step is not None:
                touch = {step_of[t] for t in contact.tasks & works}
                found.setdefault(step, set()).update(k for k in touch if k > step)
    return {step: frozenset(own) for step, own in found.items()}


def find_infeasible_steps(
    work: Assembly, now: ReplanningState, cell: Workcell
) -> tuple[Assembly, dict[int, str]]:
    """Return the work with lost objects replaced by spare ones, and the infeasible steps.

    Args:
        work: all candidates up to now.
        now: state of the operation.
        cell: its objects, where they were at the start.

    Returns:
        The work, and the reason by the number of the step.
    """
    while True:
        left = fix_choices(work.problem, now.kept, now.world.out, {})
        steps = [step for step in left.impossible if step not in now.kept]
        before = work
        for step in steps:
            own = work.problem.primaries_of.get(step, ())
            if all(work.problem.primaries[k].object in now.world.out for k in own):
                work = work.with_spares(step, _untouched(now, cell)) or work
        if work is before:
            return work, {
                step: _lost_or_out(work.problem, step, now) or left.lacking(step) or ""
                for step in steps
            }


def _untouched(now: ReplanningState, cell: Workcell) -> set[str]:
    """Return the objects that are still at their start poses and not chosen by any step."""
    lie = {
        name: at.pose
        for name, at in now.world.state.attachments.items()
        if at.holder is None and name not in now.world.out
    }
    items = (item for item in cell.objects if item.name in lie)
    there = {i.name for i in items if np.allclose(lie[i.name], i.start)}
    return there - {choice.object for choice in now.kept.values()}


def _lost_or_out(problem: AssignmentProblem, step: int, now: ReplanningState) -> str:
    """Return a message on the lost or unavailable object or robot that a step needs, else nothing."""
    own = [problem.primaries[k] for k in problem.primaries_of.get(step, ())]
    for names, words in (
        ({item.object for item in own}, "is lost"),
        ({item.robot for item in own}, "is out"),
    ):
        if len(names) == 1 and names <= now.world.out:
            return f"{names.pop()} {words}"
    return ""

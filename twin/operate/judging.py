"""What is done about skills that have failed for good: again, the step anew, ask somebody, or give up."""

from __future__ import annotations

from dataclasses import dataclass

from planning.tasks.task import (
    GONE,
    HANDLING,
    SUPPLY_KINDS,
    TRANSIT,
    Handling,
    Task,
)
from planning.worlds.world import World, pose_of
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.rolling.cut import cut_after, state_at
from twin.operate.committed import Judged, not_executed, tried_task
from twin.operate.ledger import Ledger
from twin.operate.person import Person
from twin.operate.rolling import Failure, Incident
from twin.scenario.sections.execution import ExecutionSection


@dataclass(frozen=True)
class Judging:
    """Decides about failures, and takes note of it.

    Attributes:
        section: says what may fail, and how often anything is tried.
        ledger: what is known; it is written to.
        person: who is asked before a step is given up.
    """

    section: ExecutionSection
    ledger: Ledger
    person: Person

    def judged(self, tpg: TemporalPlanGraph, incident: Incident) -> Judged:
        """Decide what is done about each failure, and what becomes of the object."""
        words, changes, reopened = [], [], dict[int, frozenset[str]]()
        for failure in incident.failures:
            task = tried_task(tpg, failure)
            change = self._changes(tpg, incident, failure, task)
            changes.append(change)
            self.ledger.tries[task.step, task.kind] += not failure.missing
            often = self.ledger.tries[task.step, task.kind]
            if often > self.section.recovery.again and not self._sees_to(task):
                self.ledger.give_up(task.step, f"{task.label} failed {often} times")
                words.append(f"step {task.step} is given up")
            elif change or task.kind == "pick":
                reopened[task.step] = frozenset({task.robot})
                how = "is lost" if change else "is left where it is"
                how = "has not come yet" if failure.missing else how
                words.append(f"step {task.step} is begun anew: {task.object} {how}")
            else:
                words.append(f"{task.label} is done again")
        return Judged(tuple(words), tuple(changes), reopened)

    def _sees_to(self, task: Task) -> bool:
        """Ask a person to see to what has failed too often; return whether that helps."""
        words = (
            f"{task.label} failed again and again: will you see to step {task.step}?"
        )
        ask = self.person.asked(self.ledger.asks, task.step, words)
        if ask is None or not self.ledger.answered(ask):
            return False
        self.ledger.tries[task.step, task.kind] = 0
        return True

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
            self.ledger.shunned.add(self.ledger.lost(name))
            return ()
        # What it holds does not change any more before its robot goes on.
        counts = cut_after(
            tpg, incident.released, not_executed(tpg, incident), steps=False
        )
        state = state_at(tpg, counts)
        at = state.attachments.get(name)
        if not failure.lost or at is None:
            if task.kind == "pick":
                self.ledger.shunned.add(self.ledger.lost(name))
            return ()
        self.ledger.gone.add(self.ledger.lost(name))
        if at.holder is None:
            return (Handling(name, 1, GONE, at.pose),)
        pose = pose_of(tpg.cell, state, name)
        return Handling(name, 1, None, pose), Handling(name, 1, GONE, pose)


def interrupted(
    ledger: Ledger, out: frozenset[str], world: World
) -> dict[int, frozenset[str]]:
    """Return the steps in the middle of which a robot is out; what it holds is lost."""
    ledger.gone |= {name for name, at in world.held() if at.holder in out}
    found = {}
    for number, step in world.begun().items():
        left = [
            t
            for t in step.tasks
            if t.index not in world.complete and t.kind not in SUPPLY_KINDS
        ]
        if any(t.robot in out and t.kind != TRANSIT for t in left):
            ledger.gone |= {t.object for t in left if t.object is not None}
            found[number] = out
    return found

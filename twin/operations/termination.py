"""Termination of an operation, proved by a measure that every plan revision reduces and that cannot decrease forever.

Each revision of the plan has one of four causes:

1. an external event: a robot or machine goes out of service, an order changes or comes in, or a late part is missed;
2. steps enter the planning window;
3. a person is asked;
4. all attempts at a skill have failed.

The measure bounds how often each cause can still occur:

    mu = (E, N, Q, A),    compared lexicographically
    E  robots and machines in service + order changes and rush orders still to come + late parts not found missing yet
    N  steps not planned yet; 0 once the planner has abandoned all further steps
    Q  times * steps - questions asked                                   (0 without a person)
    A  steps * kinds * (again + 1 + robots) - failures since a person last fixed the skill

Here ``times`` is the largest number of questions per step, ``kinds`` the number of kinds of skills, and ``again`` the
largest number of times that a skill is planned again, ``rework.times`` included.

An outage, an order change and a missing part reduce E. A longer plan reduces N and leaves E unchanged. A question
reduces Q. It may reset the failures of one skill and so increase A, but A comes after Q in the order. A failure
reduces A: a skill of a step fails at most ``again + 1`` times before its step is abandoned, and after that each robot
still working at the step fails at most once more. A robot that has failed at putting a rejected part into the bin
leaves it to a person. E, N, Q and A are natural numbers, so every sequence
mu(1) > mu(2) > ... is finite.

The planner compares the measure of each revision with the measure of the executed plan. If a revision does not reduce
it, the operation ends instead: nothing is appended, all remaining steps are abandoned, and the outcome is ``failed``.
This end adds no node to the graph, so the number of nodes and of their failures is finite. If people take robots out
of service on the page of a run, E counts these events.
"""

from __future__ import annotations

from typing import NamedTuple

from planning.tasks.task import TaskKind
from twin.operations.ledger import OperationLedger
from twin.operations.person import Person
from twin.scenario.sections.kind import assembly_kind
from twin.scenario.sections.scenario import Scenario

NO_PROGRESS = "a new plan would bring the operation no closer to its end"
"""Reason for abandoned steps where a revision does not reduce the measure."""


class RevisionMeasure(NamedTuple):
    """Bound on the remaining causes of plan revisions; see the module.

    Attributes:
        events: events from outside.
        steps: steps that are not planned yet.
        questions: questions to a person.
        attempts: failures of skills.
    """

    events: int
    steps: int
    questions: int
    attempts: int

    def is_below(self, before: RevisionMeasure) -> bool:
        """Return whether a revision with this measure may follow a plan with another one."""
        return self < before and min(self) >= 0


def measure_of(
    scenario: Scenario, person: Person, ledger: OperationLedger, events: int, steps: int
) -> RevisionMeasure:
    """Return the measure of a plan.

    Args:
        scenario: gives the numbers of steps, robots, kinds of skills and retries.
        person: the person of the operation.
        ledger: failures and questions so far.
        events: how many events from outside can still occur.
        steps: how many steps are not planned yet.
    """
    count = assembly_kind(scenario.assembly).written_out().steps()
    kinds = {
        *TaskKind.SKILLS,
        TaskKind.HOLD,
        TaskKind.LEAVE_TOOL,
        TaskKind.TAKE_TOOL,
        *scenario.processes,
    }
    execution = scenario.execution
    again = execution.recovery.again
    most = max([again, *(own.most(again) for own in execution.failures.values())])
    tries = most + 1 + len(scenario.cell.robots)
    times = 0 if person.section is None else person.section.times
    return RevisionMeasure(
        events,
        steps,
        times * count - len(ledger.asks),
        count * len(kinds) * tries - sum(ledger.tries.values()),
    )

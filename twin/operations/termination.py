"""Termination of an operation: a measure that every plan revision reduces.

Each revision of the plan has a cause that cannot occur without end:

1. an external event: a robot or machine goes out of service, an order changes, a late part is missed;
2. steps come into the planning window;
3. a person is asked;
4. all attempts at a skill have failed.

The measure bounds how often each of them can still occur:

    mu = (E, N, Q, A),    compared lexicographically
    E  robots and machines in service + announced changes of the order to come + late parts not missed yet
    N  steps not planned yet; 0 once the planner has abandoned every further step
    Q  times * steps - questions asked                                   (0 without a person)
    A  steps * kinds * (again + 1 + robots) - failures since a person last saw to the skill

An outage, a change and a missed part reduce E. A longer plan reduces N and leaves E. A question reduces Q; it may
reset the failures of one skill and so raise A, which comes later in the order. A failure reduces A: a skill of a
step fails at most ``again + 1`` times before its step is abandoned, and then each robot that is still
at work at
that step fails at most once more. E, N, Q and A are natural numbers, so each chain mu(1) > mu(2) > ... is finite.

The planner compares the measure of each revision with that of the plan that is executed. A revision that does
not reduce it is replaced by the end of the operation: nothing is appended, every remaining step is
abandoned, and the outcome is ``failed``. Such an end adds no node to the graph, so only finitely many
nodes, and
failures of them, can follow. Orders of people on the page of a run take robots out of service, which E counts.
"""

from __future__ import annotations

from typing import NamedTuple

from planning.tasks.task import TaskKind
from twin.operations.person import OperationLedger, Person
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
    tries = scenario.execution.recovery.again + 1 + len(scenario.cell.robots)
    times = 0 if person.section is None else person.section.times
    return RevisionMeasure(
        events,
        steps,
        times * count - len(ledger.asks),
        count * len(kinds) * tries - ledger.tries.total(),
    )

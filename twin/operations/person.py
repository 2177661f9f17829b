"""Ledger of steps and objects of an operation, and a person who answers questions before a step is abandoned.

The answer is drawn when a plan is made: how long the person takes, and whether that helps. Help is a
task of the graph, in which the person brings an object of the lost kind, or fixes the failure.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from planning.cell.workcell import Attachment, Workcell
from planning.tasks.task import Task
from planning.transforms import Array, Transform
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.rolling.supply import deliveries, with_pending_objects, with_supply
from twin.scenario.sections.execution import AskSection
from twin.uncertainty.draws import uniforms

PERSON = "person"
"""Name of the machine of a graph whose tasks a person does."""

AGAIN = 2**32
"""Offset added to the step or task number in draw keys for each retry or further question."""

AnswerCallback = Callable[["Question"], bool]
"""Returns whether a person helps, given a question; raises ``UnansweredError`` until it is answered."""


@dataclass(frozen=True)
class Question:
    """Question to a person.

    Attributes:
        step: for which step.
        count: number of earlier questions about that step.
        skill: kind of the task that failed, empty where an object is lacking.
        object: that is lacking, or that the task is about; None where there is none.
        words: the question, for people; not part of its identity.
    """

    step: int
    count: int
    skill: str
    object: str | None
    words: str = field(compare=False)

    def __str__(self) -> str:
        """Return the question, for people."""
        return self.words


class UnansweredError(Exception):
    """A question is not answered yet; it is no failure.

    Attributes:
        question: the open question.
    """

    def __init__(self, question: Question) -> None:
        self.question = question
        super().__init__(question.words)


@dataclass(frozen=True)
class Ask:
    """A question to a person, and the answer.

    Attributes:
        step: for which step.
        words: the question, for people.
        label: of the person's task.
        seconds: how long the person takes [s].
        helps: whether that helps.
        object: the lost object; None where the person only fixes the step.
        fresh: name of the replacement.
    """

    step: int
    words: str
    label: str
    seconds: float
    helps: bool
    object: str | None = None
    fresh: str | None = None

    @property
    def answer(self) -> str:
        """The answer, for people."""
        will = (
            f"will {self.label}" if self.helps else f"cannot help with step {self.step}"
        )
        return f"{will}, in {self.seconds:.3f} s" if self.helps else will


@dataclass(frozen=True)
class Person:
    """The person of an operation, simulated or real.

    Attributes:
        section: duration and chance of success of help; None without a person.
        seed, replication: name the random draws.
        answer: answers in place of drawn ones; called once per question, however often plans are made.
    """

    section: AskSection | None
    seed: int
    replication: int = 0
    answer: AnswerCallback | None = None
    _said: dict[Question, bool] = field(default_factory=dict)

    def asked(
        self,
        before: Sequence[Ask],
        question: Question,
        taken: Sequence[str] = (),
    ) -> Ask | None:
        """Return the answer to a question; None without a person, or beyond the limit for that step.

        Args:
            before: earlier questions.
            question: the question.
            taken: names already in use.
        """
        step, count = question.step, question.count
        name = None if question.skill else question.object
        if self.section is None or count >= self.section.times:
            return None
        taken_s = self.section.model.ppf(self._draw(step, count, "answer"))
        helps = bool(self._draw(step, count, "helps")[0] < self.section.helps)
        fresh, label = (
            None,
            f"see to step {step}" + (f" ({count + 1})" if count else ""),
        )
        if name is not None:
            names = {*taken, *(ask.fresh for ask in before)}
            numbers = iter(range(1, len(names) + 2))
            fresh = next(f for k in numbers if (f := f"{name}.{k}") not in names)
            label = f"bring {fresh}"
        if self.answer is not None:
            if question not in self._said:
                self._said[question] = self.answer(question)
            helps = self._said[question]
        return Ask(step, question.words, label, float(taken_s[0]), helps, name, fresh)

    def _draw(self, step: int, count: int, purpose: str) -> Array:
        number, mine = step + count * AGAIN, [self.replication]
        u = uniforms(self.seed, mine, [PERSON], number, ["ask"], purpose)
        return np.asarray(u[0])


def with_human_help(
    tpg: TemporalPlanGraph, cell: Workcell, asks: Iterable[Ask]
) -> tuple[TemporalPlanGraph, Workcell]:
    """Return a graph with the tasks of a person, and a cell with the delivered objects.

    Args:
        tpg: the graph.
        cell: with all objects.
        asks: those that help.
    """
    for ask in asks:
        item = None
        if ask.object is not None:
            item = replace(cell.object(ask.object), name=str(ask.fresh))
        cell = with_pending_objects(cell, () if item is None else (item,), PERSON)
        tpg = with_supply(
            tpg, PERSON, item, label=ask.label, step=ask.step, seconds=ask.seconds
        )
    return tpg, cell


@dataclass
class OperationLedger:
    """State of the steps and objects of an operation at one time.

    Attributes:
        resting: the later steps that rest on each step, by number.
        given_up: abandoned steps, by number, with the reason.
        dropped: steps that are not wanted any more, or rest on one, by number, with the reason.
        gone: objects that are lost.
        unpickable: objects that could not be picked, and are only tried again where there are no others.
        closed: why no further steps are planned, as the next one is infeasible; empty if some may be.
        more: products that have been ordered since the beginning.
        tries: how often all attempts at a skill of a step have failed.
        asks: questions to a person.
        measured: measured poses of displaced parts.
    """

    resting: Mapping[int, frozenset[int]]
    given_up: dict[int, str] = field(default_factory=dict)
    dropped: dict[int, str] = field(default_factory=dict)
    gone: set[str] = field(default_factory=set)
    unpickable: set[str] = field(default_factory=set)
    closed: str = ""
    more: int = 0
    tries: Counter[tuple[int, str]] = field(default_factory=Counter)
    asks: tuple[Ask, ...] = ()
    measured: dict[str, Transform] = field(default_factory=dict)

    def copy(self) -> OperationLedger:
        """Return an independent copy."""
        return replace(
            self,
            given_up=dict(self.given_up),
            dropped=dict(self.dropped),
            gone=set(self.gone),
            unpickable=set(self.unpickable),
            tries=Counter(self.tries),
            measured=dict(self.measured),
        )

    @property
    def undone(self) -> frozenset[int]:
        """Steps that will not be done, whatever the reason."""
        return frozenset(self.given_up.keys() | self.dropped.keys())

    @property
    def fresh(self) -> dict[str, str]:
        """Graph names of replacements, by the names of lost objects, which plans keep using."""
        helpful = (ask for ask in self.asks if ask.helps)
        return {ask.object: ask.fresh for ask in helpful if ask.object and ask.fresh}

    def lost(self, name: str) -> str:
        """Return the plan's name of an object in the graph."""
        return next((old for old, own in self.fresh.items() if own == name), name)

    def pending(self, tasks: Iterable[Task]) -> list[Ask]:
        """Return the pending help of a person that is not among given tasks."""
        done = Counter((task.step, task.object) for task in deliveries(tasks))
        fresh, found = {None, *self.fresh.values()}, []
        for ask in self.asks:
            if not ask.helps or ask.fresh not in fresh:
                continue
            done[ask.step, ask.fresh] -= 1
            if done[ask.step, ask.fresh] < 0:
                found.append(ask)
        return found

    def where(
        self,
        attachments: Mapping[str, Attachment],
        pending: Iterable[Ask],
        cell: Workcell,
    ) -> dict[str, Attachment]:
        """Return object placements by their plan names; pending replacements count as delivered."""
        found = {self.lost(name): own for name, own in attachments.items()}
        for ask in pending:
            if ask.object is not None:
                found[ask.object] = Attachment(None, cell.object(ask.object).start)
        return found

    def asked_for(self, step: int) -> int:
        """Return the number of questions about a step."""
        return sum(ask.step == step for ask in self.asks)

    def answered(self, ask: Ask) -> bool:
        """Record an answer; return whether it helps."""
        self.asks = (*self.asks, ask)
        if ask.helps and ask.object is not None:
            self.gone.discard(ask.object)
        return ask.helps

    def give_up(self, step: int, why: str) -> None:
        """Abandon a step with all dependent ones."""
        for one, words in self._with_resting(step, why):
            if one not in self.dropped:
                self.given_up.setdefault(one, words)

    def drop(self, step: int) -> None:
        """Drop a step that is no longer wanted; its dependent steps become infeasible."""
        for one, words in self._with_resting(step, "it is not wanted any more"):
            self.given_up.pop(one, None)
            if one == step or one not in self.dropped:
                self.dropped[one] = words

    def leave_off(self, steps: Collection[int], whole: Sequence[int]) -> None:
        """Abandon the unstarted steps of an object if one of its steps will not be done.

        Args:
            steps: those that are not begun.
            whole: all steps about the same object.
        """
        undone = next((k for k in whole if k in self.undone), None)
        reasons = self.dropped if undone in self.dropped else self.given_up
        for step in sorted(set(steps) - self.undone) if undone else ():
            reasons[step] = f"step {undone} is not done"

    def falls(self) -> bool:
        """Record dependents of steps that will not be done; return whether there are any."""
        before = self.undone
        for step, why in tuple(self.given_up.items()):
            self.give_up(step, why)
        for step, why in tuple(self.dropped.items()):
            for one, words in self._with_resting(step, why):
                self.dropped.setdefault(one, words)
        return self.undone != before

    def _with_resting(self, step: int, why: str) -> Iterator[tuple[int, str]]:
        todo, seen = [step], {step}
        while todo:
            one = todo.pop()
            words = why if one == step else f"it rests on step {step}"
            yield one, words.splitlines()[0]
            more = {k for k in self.resting.get(one, ()) if k > one} - seen
            todo += sorted(more)
            seen |= more

    def retry_unpicked_objects(self) -> bool:
        """Retry objects that could not be picked before; return whether there are any."""
        there = bool(self.unpickable)
        self.unpickable.clear()
        return there

"""A person who answers questions before a step is abandoned, and the tasks in which the person helps.

When a plan is made, the time until the answer and the answer itself (whether the person can help) are drawn at random.
Help is a task of the graph, in which the person brings an object of the same kind as the lost one, or fixes the
failure.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from planning.cell.workcell import Workcell
from planning.transforms import Array
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.rolling.supply import with_pending_objects, with_supply
from twin.scenario.sections.execution import AskSection
from twin.uncertainty.draws import uniforms

PERSON = "person"
"""Name of the machine that represents the person in a graph."""

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

"""A person who is asked before something is given up, and what comes of that in a simulation.

The answer is drawn when a plan is made: how long the person takes, and whether that helps. What helps is a
task of the graph, in which the person brings an object of the kind that is lost, or sees to what failed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from planning.cell.workcell import Workcell
from planning.transforms import Array
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.rolling.supply import coming, with_supply
from twin.scenario.sections.execution import AskSection
from twin.uncertainty.draws import uniforms

PERSON = "person"
"""Name of the machine of a graph whose tasks a person does."""

_AGAIN = 2**32
"""Added to the number of a step for each time that somebody is asked for it once more."""

Says = Callable[[str], bool]
"""Returns whether a person helps, given what is asked."""


@dataclass(frozen=True)
class Ask:
    """What a person was asked, and the answer.

    Attributes:
        step: for which step.
        words: the question, for people.
        label: of the person's task; every ask has another one.
        seconds: how long the person takes [s].
        helps: whether that helps.
        object: what was lost; None where the person only sees to the step.
        fresh: name of what is brought in its place.
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
    """Who is asked.

    Attributes:
        section: says how long answers take, and whether they help; None where nobody is asked.
        seed, replication: name the random draws.
        says: answers in place of what is drawn; it is asked once for each question, however often plans are made.
    """

    section: AskSection | None
    seed: int
    replication: int = 0
    says: Says | None = None
    _said: dict[str, bool] = field(default_factory=dict)

    def asked(
        self,
        before: Sequence[Ask],
        step: int,
        words: str,
        name: str | None = None,
        taken: Sequence[str] = (),
    ) -> Ask | None:
        """Return what comes of asking; None where nobody is asked, or was often enough for that step.

        Args:
            before: what was asked before.
            step: for which step.
            words: the question.
            name: of what was lost; None to ask for help with the step.
            taken: names of the objects that there are.
        """
        count = sum(ask.step == step for ask in before)
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
        if self.says is not None:
            key = f"{step}, {count}: {words}"
            if key not in self._said:
                self._said[key] = self.says(words)
            helps = self._said[key]
        return Ask(step, words, label, float(taken_s[0]), helps, name, fresh)

    def _draw(self, step: int, count: int, purpose: str) -> Array:
        number, mine = step + count * _AGAIN, [self.replication]
        u = uniforms(self.seed, mine, [PERSON], number, ["ask"], purpose)
        return np.asarray(u[0])


def with_help(
    tpg: TemporalPlanGraph, cell: Workcell, asks: Iterable[Ask]
) -> tuple[TemporalPlanGraph, Workcell]:
    """Return a new graph with what a person does, and a cell with what that brings under its own name.

    Args:
        tpg: the graph.
        cell: with all objects.
        asks: those that help.
    """
    for ask in asks:
        item = None
        if ask.object is not None:
            item = replace(cell.object(ask.object), name=str(ask.fresh))
        cell = coming(cell, () if item is None else (item,), PERSON)
        tpg = with_supply(
            tpg, PERSON, item, label=ask.label, step=ask.step, seconds=ask.seconds
        )
    return tpg, cell

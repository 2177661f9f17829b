"""Ledger of an execution with replanning: steps not done, lost objects, failed attempts, and answers of a person."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, field

from planning.cell.workcell import Attachment, Workcell
from planning.tasks.task import Task
from planning.transforms import Transform
from scheduling.rolling.supply import deliveries
from twin.operations.person import Ask


class LedgerEntries:
    """Entries of a ledger, recorded or in the draft of a recovery plan.

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
        rejected: parts that are scrapped, by the number of the step that rejected each.
        reworked: named steps that were done again last before a step, in their order, by its number.
    """

    resting: Mapping[int, frozenset[int]]
    given_up: Mapping[int, str]
    dropped: Mapping[int, str]
    gone: AbstractSet[str]
    unpickable: AbstractSet[str]
    closed: str
    more: int
    tries: Mapping[tuple[int, str], int]
    asks: tuple[Ask, ...]
    measured: Mapping[str, Transform]
    rejected: Mapping[int, str]
    reworked: Mapping[int, tuple[int, ...]]

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


@dataclass(frozen=True)
class OperationLedger(LedgerEntries):
    """Immutable ledger of an operation at one time; see ``LedgerEntries``."""

    resting: Mapping[int, frozenset[int]]
    given_up: Mapping[int, str] = field(default_factory=dict)
    dropped: Mapping[int, str] = field(default_factory=dict)
    gone: frozenset[str] = frozenset()
    unpickable: frozenset[str] = frozenset()
    closed: str = ""
    more: int = 0
    tries: Mapping[tuple[int, str], int] = field(default_factory=dict)
    asks: tuple[Ask, ...] = ()
    measured: Mapping[str, Transform] = field(default_factory=dict)
    rejected: Mapping[int, str] = field(default_factory=dict)
    reworked: Mapping[int, tuple[int, ...]] = field(default_factory=dict)

    def draft(self) -> LedgerDraft:
        """Return a draft of the next ledger."""
        return LedgerDraft(
            self.resting,
            dict(self.given_up),
            dict(self.dropped),
            set(self.gone),
            set(self.unpickable),
            self.closed,
            self.more,
            Counter(self.tries),
            self.asks,
            dict(self.measured),
            dict(self.rejected),
            dict(self.reworked),
        )


@dataclass
class LedgerDraft(LedgerEntries):
    """Draft of the next ledger; see ``LedgerEntries``."""

    resting: Mapping[int, frozenset[int]]
    given_up: dict[int, str]
    dropped: dict[int, str]
    gone: set[str]
    unpickable: set[str]
    closed: str
    more: int
    tries: Counter[tuple[int, str]]
    asks: tuple[Ask, ...]
    measured: dict[str, Transform]
    rejected: dict[int, str]
    reworked: dict[int, tuple[int, ...]]

    def recorded(self) -> OperationLedger:
        """Return the ledger of this draft, which later changes of it leave as it is."""
        return OperationLedger(
            self.resting,
            dict(self.given_up),
            dict(self.dropped),
            frozenset(self.gone),
            frozenset(self.unpickable),
            self.closed,
            self.more,
            Counter(self.tries),
            self.asks,
            dict(self.measured),
            dict(self.rejected),
            dict(self.reworked),
        )

    def answered(self, ask: Ask) -> bool:
        """Record an answer; return whether it helps."""
        self.asks = (*self.asks, ask)
        if ask.helps and ask.object is not None:
            self.gone.discard(ask.object)
            self.measured.pop(ask.object, None)
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
        """Abandon the unstarted steps of an object, with all dependent ones, if one of its steps will not be done.

        Args:
            steps: those that are not begun.
            whole: all steps about the same object.
        """
        undone = next((k for k in whole if k in self.undone), None)
        reasons = self.dropped if undone in self.dropped else self.given_up
        for step in sorted(set(steps) - self.undone) if undone else ():
            for one, words in self._with_resting(step, f"step {undone} is not done"):
                if one not in self.undone:
                    reasons[one] = words

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

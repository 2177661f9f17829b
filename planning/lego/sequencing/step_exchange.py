"""Other orders of the steps of a LEGO assembly, one exchange of neighbours after another.

A place waits for the place before it, so the structures that can be reached are those after each
step. Exchanging two steps changes one of them: it must stand, nothing may be in the way of either
brick, and the structure must bear both presses, by the same rules that a sequence is found or
checked by. What the arms can do with the two steps then is found anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

from planning.caches import KeptAnswers
from planning.lego.bricks.assembly import LegoAssembly, LegoStep, PlacedBrick
from planning.lego.insertion.insertion import Insertions
from planning.lego.insertion.rules import SequencingRules
from planning.lego.sequencing.stable_steps import StepChoices
from planning.lego.skills.candidates import LegoCandidates, exchange_steps
from planning.lego.skills.expansion import lego_work
from planning.lego.stability.partial_structures import Names
from planning.tasks.work import AssemblyWork

_MOST = 100
"""Orders whose candidates are kept."""


def movable_work(
    candidates: LegoCandidates, rules: SequencingRules, names: Sequence[str] = ()
) -> AssemblyWork:
    """Return the work of an assembly whose steps may be exchanged.

    Args:
        candidates: of the assembly.
        rules: of its sequence.
        names: of the bricks of the steps, where the sequence was found; the ways in which they go
            in are sought anew then. Without, steps are done as they are written.
    """
    exchange = StepExchange.of(candidates.world.assembly, rules, names)
    return exchange.work(candidates, tuple(range(1, len(exchange.bricks) + 1)))


@dataclass(frozen=True)
class StepExchange:
    """Exchanges of the steps of one assembly.

    Attributes:
        bricks: of the steps, in their first order.
        insertions: judges how bricks go in.
        found: whether the sequence was found, so that ways to put bricks in may be as well.
        known: works by their orders.
    """

    bricks: tuple[PlacedBrick, ...]
    insertions: Insertions
    found: bool
    known: KeptAnswers[AssemblyWork | str]

    @staticmethod
    def of(
        assembly: LegoAssembly, rules: SequencingRules, names: Sequence[str]
    ) -> StepExchange:
        """Return those of an assembly, see ``movable_work``."""
        bricks = assembly.structure
        if names:
            bricks = tuple(
                replace(item, name=name)
                for item, name in zip(bricks, names, strict=True)
            )
        insertions = Insertions.of(bricks, assembly.scaffold, rules)
        return StepExchange(bricks, insertions, bool(names), KeptAnswers(_MOST))

    def work(self, candidates: LegoCandidates, order: tuple[int, ...]) -> AssemblyWork:
        """Return the work of an order of the steps."""
        return replace(
            lego_work(candidates),
            order=order,
            exchanged=partial(self.exchanged, candidates, order),
        )

    def exchanged(
        self, candidates: LegoCandidates, order: tuple[int, ...], at: int
    ) -> AssemblyWork | None:
        """Return the work with a step and the next one exchanged, None where that cannot be.

        Args:
            candidates: before.
            order: of the steps, by their first numbers, before.
            at: the first of the two steps, counted from 1 in that order.
        """
        if not 1 <= at < len(order):
            return None
        a, b = order[at - 1 : at + 1]
        after = (*order[: at - 1], b, a, *order[at + 1 :])
        found = self.known.get(after, lambda: self._exchange(candidates, after, at))
        return None if isinstance(found, str) else found

    def _exchange(
        self, candidates: LegoCandidates, after: tuple[int, ...], at: int
    ) -> AssemblyWork | str:
        steps = list(candidates.world.assembly.steps)
        steps[at - 1 : at + 1] = steps[at], steps[at - 1]
        for place in (at - 1, at):
            done = self._last_step(after[: place + 1], steps[place])
            if done is None:
                return "the structure does not bear it"
            steps[place] = done
        changed = exchange_steps(candidates, tuple(steps), at)
        if changed.problem.impossible:
            return "no robot can do it"
        return self.work(changed, after)

    def _last_step(self, order: Sequence[int], step: LegoStep) -> LegoStep | None:
        """Return how the last of some steps is done, None where it cannot be the last."""
        names = self.insertions.fixed | {self.bricks[k - 1].name for k in order}
        brick = self.bricks[order[-1] - 1].name
        if not self.insertions.structures.stands(names):
            return None
        if self.found:
            return self._found_step(names, brick, step)
        site = self.insertions.at(names, brick, up=step.up)
        if site.obstacle() is not None:
            return None
        return StepChoices(step, site).stable()

    def _found_step(self, names: Names, brick: str, step: LegoStep) -> LegoStep | None:
        for way in self.insertions.rules.ways_of(brick):
            chosen = self.insertions.last(names, brick, way)
            if chosen is not None:
                site = self.insertions.at(names, brick, up=way.up)
                done = site.step(chosen)
                return replace(done, stock=step.stock, temporary=step.temporary)
        return None

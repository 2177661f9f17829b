"""From a finished LEGO structure to the steps that build it (APEX-MR Sec. III and App. A).

Assembly by disassembly: from the finished structure, bricks are removed one at a time such that
what remains stands, and such that the removed brick could be put back: pressed on from above,
from above with a supporting tool below, or from below after a handover. Reversed, the removals
are the assembly sequence.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, compress, groupby, product

from planning.errors import InfeasibleStepError
from planning.lego.bricks.assembly import LegoAssembly, LegoStep, PlacedBrick
from planning.lego.sequencing.disassembly import Removal, find_assembly_sequence
from planning.lego.sequencing.insertion import (
    INSERTION_FORCE,
    Insertion,
    InsertionRules,
)
from planning.lego.stability.partial_structures import Names, PartialStructures

_MOST_REASONS = 6
"""How many bricks of a dead end are named."""


@dataclass(frozen=True)
class SequencingRules:
    """Rules of an assembly sequence: allowed insertions, and loads the structure must bear.

    Attributes:
        support: a second robot may hold the structure from below.
        place_up: a brick may be handed over and pressed on from below, a second robot pressing
            against it from above.
        force: force with which a brick is pressed into place [N].
        search_limit: how many partial structures to look at, in each order of preference, beyond
            those on the straight way to a sequence.
    """

    support: bool = True
    place_up: bool = True
    force: float = INSERTION_FORCE
    search_limit: int = 150


@dataclass(frozen=True)
class SequencedStep:
    """A step of an assembly sequence, and why it is what it is.

    Attributes:
        name: the brick's name in the structure.
        step: the step. Its presses are all that have room and that the structure bears (with
            the chosen support, where there is one), its supports all that would do with the
            chosen press.
        reason: in words.
        score: bound of the stability score while the brick is pressed.
    """

    name: str
    step: LegoStep
    reason: str
    score: float


@dataclass(frozen=True)
class SequencedStructure:
    """An assembly sequence.

    Attributes:
        sequence: the steps in the order of assembly, with reasons.
        visited: partial structures looked at.
        programs: linear programs solved.
    """

    sequence: tuple[SequencedStep, ...]
    visited: int
    programs: int

    @property
    def steps(self) -> tuple[LegoStep, ...]:
        """The steps as an assembly takes them, with their alternatives."""
        return tuple(item.step for item in self.sequence)


def sequence_structure(
    structure: Sequence[PlacedBrick],
    *,
    scaffold: Iterable[PlacedBrick] = (),
    rules: SequencingRules | None = None,
) -> SequencedStructure:
    """Return an order in which a structure can be assembled, and how each brick goes in.

    Args:
        structure: the bricks of the finished structure, on the plate or on the scaffold.
        scaffold: bricks that stand from the start and stay.
        rules: what is allowed.

    Returns:
        The first sequence found depth first. Bricks of the top layer are removed first; within
        a layer place-downs without support are preferred, then those with support, then
        place-ups. Where that leads nowhere, bricks that hang are removed before all others: they
        take the room of supporting tools.

    Raises:
        InfeasibleStepError: the finished structure does not stand, or no order leads to it;
            names the bricks that cannot be removed and why.
        ScenarioError: bricks overlap or two have the same name.
    """
    rules = rules or SequencingRules()
    fixed = tuple(scaffold)
    structures = PartialStructures([*structure, *fixed])
    sequencer = _Sequencer(structures, frozenset(b.name for b in fixed), rules)
    sequencer.check_finished(frozenset(structures.bricks))
    sequencer.check_hanging(frozenset(structures.bricks))
    limit = len(structure) + 1 + rules.search_limit
    names_of = [item.name for item in structure]
    found = find_assembly_sequence(names_of, sequencer.removals, limit=limit)
    if found.steps is None and not found.complete:
        # Where the search was complete no other order would do either.
        found = find_assembly_sequence(names_of, sequencer.hanging_first, limit=limit)
    if found.steps is None:
        raise InfeasibleStepError(
            sequencer.explain(found.dead_end or frozenset(), complete=found.complete)
        )
    names = sequencer.fixed
    out = []
    for removal in found.steps:
        names |= {removal.part}
        out.append(sequencer.describe(names, removal.part, removal.how))
    return SequencedStructure(tuple(out), found.visited, structures.programs)


def sequenced(
    assembly: LegoAssembly,
    structure: Sequence[PlacedBrick] | None = None,
    rules: SequencingRules | None = None,
) -> tuple[LegoAssembly, SequencedStructure]:
    """Return an assembly with the steps that build a structure on its scaffold.

    Args:
        assembly: plate and stock; of its steps, if any, only what they build counts.
        structure: the finished structure, by default that which the steps build.
        rules: what a sequence may do.

    Raises:
        InfeasibleStepError: see ``sequence_structure``.
    """
    structure = assembly.structure if structure is None else structure
    found = sequence_structure(structure, scaffold=assembly.scaffold, rules=rules)
    return replace(assembly, steps=found.steps), found


class _Sequencer:
    """Removal candidates of a partial structure, and the reasons where there are none."""

    def __init__(
        self, structures: PartialStructures, fixed: Names, rules: SequencingRules
    ) -> None:
        self.fixed = fixed
        self._structures = structures
        self._rules = rules
        self._insertion = InsertionRules(structures, force=rules.force)
        # Up or down, and held by another robot or not; the preferred ones first.
        ways = ((False, False), (False, True), (True, True))
        self._ways = tuple(compress(ways, (True, rules.support, rules.place_up)))

    def check_finished(self, names: Names) -> None:
        """Raise an error when the finished structure does not stand."""
        report = self._structures.standing(names)
        if report.stable:
            return
        what = self._place(report.brick or "")
        why = f"{what} needs {report.score:.2f} times the friction its knobs have"
        if math.isinf(report.score):
            why = f"nothing holds {what}"
        raise InfeasibleStepError(f"the finished structure does not stand: {why}")

    def check_hanging(self, names: Names) -> None:
        """Raise an error when bricks hang although nothing may be placed from below."""
        if self._rules.place_up:
            return
        hanging = [
            self._place(name)
            for name in self._candidates(names - self.fixed)
            if not self._structures.below(names, name)
        ]
        if hanging:
            raise InfeasibleStepError(
                f"no step can place {' or '.join(hanging)}: there is nothing below it to press it "
                f"onto, and placing from below is not allowed"
            )

    def removals(self, parts: Names) -> Iterator[Removal[str, Insertion]]:
        """Yield the bricks that may be removed, and how they would be put back."""
        layers = groupby(
            self._candidates(parts), key=lambda n: self._structures.bricks[n].cell.level
        )
        yield from self._removals(parts, (tuple(bricks) for _, bricks in layers))

    def hanging_first(self, parts: Names) -> Iterator[Removal[str, Insertion]]:
        """Yield the same as ``removals``, those with nothing below them first, from the lowest."""
        names = parts | self.fixed
        hanging = tuple(
            name
            for name in reversed(self._candidates(parts))
            if not self._structures.below(names, name)
        )
        yield from self._removals(parts, (hanging,))
        for removal in self.removals(parts):
            if removal.part not in hanging:
                yield removal

    def _removals(
        self, parts: Names, groups: Iterable[tuple[str, ...]]
    ) -> Iterator[Removal[str, Insertion]]:
        names = parts | self.fixed
        for bricks in groups:
            for (up, held), brick in product(self._ways, bricks):
                site = self._insertion.at(names, brick, up=up)
                if site.obstacle() is not None:
                    continue
                if not self._structures.standing(names - {brick}).stable:
                    continue
                ways = (site.insertions(p, held=held) for p in site.roomy_presses)
                insertion = next(chain.from_iterable(ways), None)
                if insertion is not None:
                    yield Removal(brick, insertion)

    def describe(self, names: Names, brick: str, chosen: Insertion) -> SequencedStep:
        """Return a step of the sequence with all its alternatives."""
        step = self._insertion.at(names, brick, up=chosen.up).step(chosen)
        reason = "the structure bears the press from above"
        if chosen.up:
            above = self._place(self._structures.above(names, brick)[0])
            reason = f"it hangs below {above}, with nothing under it"
        elif chosen.support is not None:
            reason = "pressed from above alone, the structure would give way"
        return SequencedStep(brick, step, reason, chosen.score)

    def explain(self, parts: Names, *, complete: bool) -> str:
        """Return the reasons why no brick of a dead end can be removed."""
        names = parts | self.fixed
        whys = [
            (*self._why_not(names, k), self._place(k)) for k in self._candidates(parts)
        ]
        # What stands in the way of all else comes first.
        whys.sort(key=lambda why: why[0])
        end = "" if complete else " (the search was cut short by its limit)"
        shown = [f"  {place}: {reason}" for _, reason, place in whys[:_MOST_REASONS]]
        if len(whys) > len(shown):
            shown.append(f"  and {len(whys) - len(shown)} more")
        total = len(self._structures.bricks) - len(self.fixed)
        return (
            f"no order of assembly was found{end}: no brick can be placed in step {len(parts)} of "
            f"{total}, as the last of these\n" + "\n".join(shown)
        )

    def _candidates(self, parts: Names) -> list[str]:
        bricks = self._structures.bricks

        def top_first(name: str) -> tuple[int, int, int, str]:
            cell = bricks[name].cell
            return -cell.level, -cell.x, -cell.y, name

        return sorted(parts, key=top_first)

    def _why_not(self, names: Names, brick: str) -> tuple[bool, str]:
        """Return why a brick cannot be the last one in, and whether others depend on it."""
        rest = self._structures.standing(names - {brick})
        if not rest.stable:
            what = self._place(rest.brick or "")
            held = "nothing holds {}" if math.isinf(rest.score) else "{} gives way"
            return True, f"without it {held.format(what)}"
        return False, self._why_not_inserted(names, brick)

    def _why_not_inserted(self, names: Names, brick: str) -> str:
        from_above, from_below = (
            self._insertion.at(names, brick, up=up).obstacle() for up in (False, True)
        )
        if from_above and from_below:
            return f"{from_above} and {from_below}"
        up = from_above is not None
        if up and not self._rules.place_up:
            return f"{from_above}, and placing from below is not allowed"
        site = self._insertion.at(names, brick, up=up)
        if not site.roomy_presses:
            return f"the tool has no room: {site.blocker()!r} is in its way"
        if up:
            return "no supporting tool above has room and keeps the structure standing"
        if not self._rules.support:
            return "the structure gives way under the press, and support is not allowed"
        return (
            "the structure gives way under the press, and no supporting tool below has room "
            "and helps"
        )

    def _place(self, name: str) -> str:
        item = self._structures.bricks[name]
        return f"{name!r} ({item.brick.name} at {item.cell.words})"

"""Assembly sequences of LEGO structures, found by disassembly (APEX-MR Sec. III and App. A).

Bricks are removed from the finished structure one at a time. The remaining structure must be stable, and it must be
possible to insert the removed brick again. The removals in reverse order are the assembly sequence. Sets of bricks
that block each other are determined before the search. If there are any, no assembly order exists, and these sets are
the proof.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from textwrap import indent

from planning.errors import InfeasibleStepError, UndecidedError, format_faults
from planning.lego.bricks.assembly import LegoStep, PlacedBrick
from planning.lego.insertion.insertion import MOST_SPOTS, Insertion
from planning.lego.insertion.rules import InsertionMethod, SequencingRules
from planning.lego.sequencing.blocking import Refusal
from planning.lego.sequencing.disassembly_search import (
    DisassemblySearch,
    Removals,
    find_assembly_sequence,
)
from planning.lego.sequencing.remedies import Design
from planning.lego.sequencing.removal import UnremovableBrick
from planning.lego.stability.partial_structures import Names
from planning.progress import Progress, no_progress

_FIRST_TRY = 30
"""Partial structures that the first try may look at beyond one for each brick."""

_TRIES = 100
"""Partial structures looked at, beyond one for each brick, before more scaffolding is added."""


def _search(
    design: Design, limit: int, progress: Progress
) -> DisassemblySearch[str, Insertion]:
    """Search for an order in which the bricks of a finished structure can be assembled.

    The limit is the largest number of partial structures to look at, beyond one for each brick.
    """
    parts, insertions = design.parts, design.insertions
    removals, failed = Removals(insertions), set[Names]()
    visited, beyond = 0, _FIRST_TRY
    dead_end: Names | None = None
    total = limit + len(parts) + 1
    while True:
        most = min(len(parts) + 1 + beyond, total - visited)
        found = find_assembly_sequence(parts, removals.of, limit=most, failed=failed)
        visited += found.visited
        progress(visited, total)
        end = found.dead_end
        if end is not None and (dead_end is None or len(end) < len(dead_end)):
            dead_end = end
        if found.steps is not None or found.complete or visited >= total:
            return replace(found, dead_end=dead_end, visited=visited)
        if end is not None:
            removals.urgency.update(n for n in end if insertions.perhaps(end, n))
        beyond += beyond // 2


@dataclass(frozen=True)
class SequencedStep:
    """A step of an assembly sequence, and the reasons for its choice.

    Attributes:
        name: the brick's name in the structure.
        step: the step. Its presses are all that have room and that the structure bears (with
            the chosen support, where there is one), its supports all that would do with the
            chosen press.
        reason: in words.
        needed: force that presses the brick on [N].
    """

    name: str
    step: LegoStep
    reason: str
    needed: float


@dataclass(frozen=True)
class SequencedStructure:
    """An assembly sequence.

    Attributes:
        sequence: the steps in the order of assembly, with reasons.
        visited: number of partial structures examined.
        programs: linear programs solved.
        shut_in: temporary bricks that cannot be taken out again.
    """

    sequence: tuple[SequencedStep, ...]
    visited: int
    programs: int
    shut_in: tuple[UnremovableBrick, ...] = ()

    @property
    def steps(self) -> tuple[LegoStep, ...]:
        """The steps as an assembly takes them, with their alternatives."""
        return tuple(item.step for item in self.sequence)


def sequence_structure(
    structure: Sequence[PlacedBrick],
    *,
    scaffold: Iterable[PlacedBrick] = (),
    helpers: Iterable[PlacedBrick] = (),
    rules: SequencingRules | None = None,
    progress: Progress = no_progress,
) -> SequencedStructure:
    """Return an order in which a structure can be assembled, with the insertion of each brick.

    Args:
        structure: the bricks of the finished structure, on the plate or on the scaffold.
        scaffold: bricks that stand from the start and stay.
        helpers: temporary bricks that are chosen already, on a plinth where there is one.
        rules: what is allowed.
        progress: called with the numbers of partial structures examined and allowed.

    Returns:
        The first sequence found. Bricks of the top layer are removed first; within a layer the
        ways are preferred in their order. Temporary bricks are steps like others.

    Raises:
        InfeasibleStepError: the finished structure does not stand, or no order leads to it;
            names the bricks that block each other and why, and what would help.
        UndecidedError: the search ended at its limit without a sequence or a proof.
        ScenarioError: bricks overlap or two have the same name.
    """
    rules = rules or SequencingRules()
    plain = Design(tuple(structure), tuple(scaffold), tuple(helpers), rules)
    _check_finished(plain)
    start = plain if plain.temporary else plain.on_plinth()
    design = start.scaffolded() if rules.scaffold else start
    if design.blocked and rules.scaffold:
        design = start.scaffolded_elsewhere() or design
    core = design.blocking_set()
    if core:
        words = Refusal(design.insertions).blocked(core)
        raise InfeasibleStepError(words + _remedies(start))
    # Where scaffolding may be added, that helps more than many tries without it.
    limit = min(rules.search_limit, _TRIES) if rules.scaffold else rules.search_limit
    found = _search(design, limit, progress)
    while found.steps is None and rules.scaffold:
        column = design.column(_stuck(design, found))
        if not column:
            break
        more = replace(design, temporary=(*design.temporary, *column))
        design = more.scaffolded()
        found = _search(design, limit, progress)
    if found.steps is None and not found.complete and limit < rules.search_limit:
        found = _search(design, rules.search_limit, progress)
    if found.steps is None:
        refusal = Refusal(design.insertions)
        end = found.dead_end or frozenset()
        words = (
            f"no brick can be placed in step {len(end)} of {len(design.parts)}, as the last of "
            f"these\n{refusal.dead_end(end)}"
        )
        if found.complete:
            raise InfeasibleStepError(
                f"no order of assembly exists: all {found.visited} partial structures that can be "
                f"reached lead nowhere, held at any of {MOST_SPOTS} spots near a press. In the "
                f"smallest of them {words}" + _remedies(start)
            )
        raise UndecidedError(
            f"not decided: no order of assembly was found among {found.visited} partial "
            "structures, and no proof that there is none ('search_limit' of the rules allows "
            f"more). At the dead end that came nearest {words}",
            visited=found.visited,
        )
    if rules.removable and design.shut_in:
        raise InfeasibleStepError(
            "temporary bricks cannot be taken out again, which the rules ask for (scaffold:"
            " removable)\n"
            + indent(format_faults([item.words for item in design.shut_in]), "  ")
        )
    return SequencedStructure(
        tuple(_described(design, found)),
        found.visited,
        design.structures.programs,
        design.shut_in,
    )


def _stuck(design: Design, found: DisassemblySearch[str, Insertion]) -> list[str]:
    """Return the bricks that only the press load excludes at a dead end, from the top down."""
    end = found.dead_end or frozenset()
    return [n for n in design.order() if n in end and design.insertions.perhaps(end, n)]


def _described(
    design: Design, found: DisassemblySearch[str, Insertion]
) -> Iterable[SequencedStep]:
    """Yield the steps of a sequence with all their alternatives."""
    names, temporary = design.insertions.fixed, {item.name for item in design.temporary}
    for removal in found.steps or ():
        name, chosen = removal.part, removal.how
        names |= {name}
        site = design.insertions.at(names, name, up=chosen.method.up)
        step = replace(site.step(chosen), temporary=name in temporary)
        reason = _reason(design, names, name, chosen)
        yield SequencedStep(name, step, reason, chosen.bearing.needed)


def _reason(design: Design, names: Names, name: str, chosen: Insertion) -> str:
    force = f"{chosen.bearing.needed:.1f} N"
    if chosen.method is InsertionMethod.UP:
        above = design.structures.above(names, name)[0]
        item = design.structures.bricks[above]
        place = f"{above!r} ({item.brick.name} at {item.cell.words})"
        return f"it hangs below {place}, with nothing under it"
    if chosen.method.held:
        return f"pressed with {force} from above alone, the structure would give way"
    return f"the structure bears the press of {force} from above"


def _check_finished(design: Design) -> None:
    """Raise an error when the finished structure does not stand."""
    structures = design.structures
    names = frozenset(structures.bricks)
    if not structures.stands(names):
        refusal = Refusal(design.insertions)
        report = structures.weakness(names)
        what = refusal.place(report.body or "")
        why = f"{what} needs {report.score:.2f} times the friction its knobs have"
        if math.isinf(report.score):
            why = f"nothing holds {what}"
        raise InfeasibleStepError(f"the finished structure does not stand: {why}")


def _remedies(design: Design) -> str:
    """Return which disabled remedies would help, as a further line of an error."""
    rules = design.rules
    remedies = {
        "support": replace(rules, support=True),
        "place_up": replace(rules, place_up=True),
        "hold_down": replace(rules, hold_down=True),
        "scaffold": replace(rules, scaffold=True),
        "removable": replace(rules, removable=False),
    }
    helps = []
    for name, changed in remedies.items():
        if changed == rules:
            continue
        helped, words = replace(design, rules=changed), f"'{name}'"
        if name in {"scaffold", "removable"} and changed.scaffold:
            helped = helped.scaffolded()
            count = len(helped.temporary) - len(design.temporary)
            words = f"'scaffold' ({count} temporary bricks)"
            if name == "removable":
                words = f"'scaffold' with bricks that stay shut in ({count} of them)"
        if not helped.blocked:
            helps.append(words)
    if not helps:
        return ""
    return f"\n  what would help, switched on in the rules: {' or '.join(helps)}"

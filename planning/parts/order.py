"""The order of steps that nobody gave: by contacts, ways in and precedence, and by what is tried.

What rests on something comes after it, and so does what would bar another part's straight way
down to its place; what lies on something in the stock is picked before it; a process is done once
its part is in place and before a part bars the way of its tool. Among orders that keep all that, the
one nearest to the list is tried; where nobody can do a step because of a part that is there by
then, or still there, that part must come later, or sooner.

Where something would fall (``balance``), what would keep it standing comes before it. Where nothing
does and a later step joins it, its robot keeps hold of it, and that step comes as soon as it can.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from planning.cell.shape import box_shape
from planning.cell.workcell import Fixture, Workcell
from planning.contacts.precedence import (
    MOST_OVERLAP,
    Lying,
    PartGraph,
    StepPrecedence,
    build_part_graph,
    leads_through,
    near_to,
    stacked,
)
from planning.errors import InfeasibleStepError
from planning.parts.assembly import AnyStep, MachineWork, PartAssembly, Place, Work
from planning.parts.balance import PartBalance, standing_of
from planning.parts.candidates import PartCandidates, find_candidates
from planning.parts.part_steps import part_steps
from planning.progress import Progress, no_progress
from planning.steps.tool_changes import in_racks
from planning.transforms import Array, readonly, translation

_BORE = 0.002
"""Width of the straight way of a tool to a place of work that no part may bar [m]."""


def precedence(cell: Workcell, assembly: PartAssembly) -> StepPrecedence:
    """Return what comes before what, as far as places and contacts alone tell.

    Args:
        cell: its objects are the parts.
        assembly: its steps are in any order.

    Raises:
        ConstructionError: two parts would overlap in their places.
    """
    steps = assembly.steps
    graph, at = _graph(cell, assembly), _placing(assembly)
    any_of = tuple(
        frozenset(at[other] for other in graph.neighbours[step.part])
        if isinstance(step, Place) and step.part not in graph.ground
        else frozenset[int]()
        for step in steps
    )
    words, before = (
        tuple(s.words for s in steps),
        tuple[dict[int, str]]({} for _ in steps),
    )
    names = {step.name: k for k, step in enumerate(steps) if step.name is not None}
    closing = {
        k: frozenset({names[step.until]})
        for k, step in enumerate(steps)
        if isinstance(step, Place) and step.until is not None
    }
    out = StepPrecedence(words, before, any_of, closing)
    for first, then, why in (
        *_named(steps),
        *_contacts(cell, assembly, graph),
        *_ways(cell, assembly),
        *_works(cell, assembly),
    ):
        out.require(first, then, why)
    return out


def in_found_order(cell: Workcell, assembly: PartAssembly) -> PartAssembly:
    """Return the assembly with its steps in an order that places and contacts allow.

    Raises:
        InfeasibleStepError: there is none; the message names steps that wait for each other.
        ConstructionError: two parts would overlap in their places.
    """
    return _ordered(assembly, _propped(cell, assembly, precedence(cell, assembly)))


def find_ordered_candidates(
    cell: Workcell,
    assembly: PartAssembly,
    progress: Progress = no_progress,
) -> PartCandidates:
    """Return the candidates of an assembly in an order in which robots can do every step.

    Where nobody can do a step, a part that was in the way of most tries is moved to the other side
    of it, and the next order is tried.

    Args:
        cell: its objects are the parts.
        assembly: its steps are in any order.
        progress: told how many orders were tried, of how many at most.

    Raises:
        InfeasibleStepError: no order was found; says what was in the way in the last one.
        ConstructionError: two parts would overlap in their places.
    """
    around = in_racks(cell)
    known = precedence(around, assembly)
    most = 2 * len(assembly.steps)
    for tried in range(most + 1):
        progress(tried, most)
        known = _propped(around, assembly, known)
        ordered = _ordered(assembly, known)
        found = find_candidates(cell, ordered)
        stuck = found.impossible
        if not stuck or tried == most:
            return found  # what is still impossible is said by the assignment
        changed = _moved(known, assembly, ordered, stuck[0], found.blockers)
        if changed is None:
            return found
        known = changed
    raise AssertionError("the last try returns")


def _ordered(assembly: PartAssembly, known: StepPrecedence) -> PartAssembly:
    order = known.order()
    if order is None:
        raise InfeasibleStepError(
            f"there is no order of the steps\n{known.explained()}"
        )
    return replace(assembly, steps=tuple(assembly.steps[k] for k in order))


def _propped(
    cell: Workcell, assembly: PartAssembly, known: StepPrecedence
) -> StepPrecedence:
    """Return what comes before what once all props that are found come before what they keep up.

    What falls all the same is left for the candidates to refuse.
    """
    if assembly.balance is None:
        return known
    placing = _placing(assembly)
    number = {id(item): k for k, item in enumerate(assembly.steps)}
    standing, keepable = None, set[str]()
    while True:
        ordered = _ordered(assembly, known)
        steps, rules = part_steps(cell, ordered), assembly.balance
        standing = standing or standing_of(cell, steps, rules)
        balance = PartBalance(cell, steps, rules, standing, keepable)
        if balance.fall is None:
            return known
        falls = number[id(ordered.steps[balance.fall.step])]
        words = f"{balance.fall.body} would fall without it"
        tries = (
            known.with_required(placing[name], falls, words)
            for name in balance.props(balance.fall)
        )
        changed = next((t for t in tries if t.order() is not None), None)
        if changed is None:
            name = next((n for n in balance.fall.holds if n not in keepable), None)
            ends = _joining(assembly, name, falls)
            if name is None or not ends:
                return known
            keepable.add(name)
            closing = {**known.closing, placing[name]: ends}
            changed = replace(known, closing=closing)
        known = changed


def _joining(assembly: PartAssembly, part: str | None, but: int) -> frozenset[int]:
    """Return the steps that join a part to others, one of them left out."""
    named = {step.name: k for k, step in enumerate(assembly.steps)}
    placing = _placing(assembly)
    assert assembly.balance is not None
    found = set()
    for item in assembly.balance.joined:
        pair = {item.joint.first, item.joint.second}
        if part in pair:
            (other,) = pair - {part}
            end = placing.get(other) if item.by is None else named[item.by]
            found.add(end)
    return frozenset(k for k in found if k is not None and k != but)


def _moved(
    known: StepPrecedence,
    assembly: PartAssembly,
    ordered: PartAssembly,
    step: int,
    blockers: Mapping[int, Sequence[str]],
) -> StepPrecedence | None:
    """Return what comes before what once a part that blocks a step is moved past it."""
    number = {id(item): k for k, item in enumerate(assembly.steps)}
    placing = {s.part: k for k, s in enumerate(assembly.steps) if isinstance(s, Place)}
    place = {s.part: k for k, s in enumerate(ordered.steps, 1) if isinstance(s, Place)}
    blocked = number[id(ordered.steps[step - 1])]
    for name in blockers.get(step, ()):
        if name not in placing or placing[name] == blocked:
            continue
        if place[name] < step:
            words = f"{name} would be in the way"
            changed = known.with_required(blocked, placing[name], words)
        else:
            words = f"{name} is in the way where it is at the start"
            changed = known.with_required(placing[name], blocked, words)
        if changed.order() is not None:
            return changed
    return None


def _named(steps: Sequence[AnyStep]) -> Iterator[tuple[int, int, str]]:
    """Yield what the scenario says, and that processes and holds are at parts in place."""
    names = {step.name: k for k, step in enumerate(steps) if step.name is not None}
    placing = {s.part: k for k, s in enumerate(steps) if isinstance(s, Place)}
    for k, step in enumerate(steps):
        for name in step.after:
            yield names[name], k, "as its after says"
        if isinstance(step, Place) and step.until is not None:
            yield k, names[step.until], f"{step.part} is kept hold of until then"
        if step.hold in placing:
            yield placing[step.hold], k, f"{step.hold} is held in its place"
        if isinstance(step, Work) and step.owner in placing:
            yield placing[step.owner], k, f"it is done at {step.owner} in its place"
        if isinstance(step, MachineWork) and step.part in placing:
            yield placing[step.part], k, f"it is done at {step.part} in its place"


def _graph(cell: Workcell, assembly: PartAssembly) -> PartGraph:
    """Return what touches what where every part is in its place."""
    fixed: list[Lying] = [(item, item.pose) for item in cell.fixtures]
    placed = set(assembly.placed)
    fixed += [
        (item, item.start)
        for item in cell.objects
        if item.name not in placed and not item.later
    ]
    return build_part_graph(
        _goals(cell, assembly), fixed, touch=assembly.touch, overlaps=assembly.overlaps
    )


def _contacts(
    cell: Workcell, assembly: PartAssembly, graph: PartGraph
) -> Iterator[tuple[int, int, str]]:
    """Yield what rests on what in its place, and what lies on what at the start."""
    at = _placing(assembly)
    for name, carriers in graph.carriers.items():
        for other in sorted(carriers):
            yield at[other], at[name], f"{name} rests on {other}"
    starts = {name: (cell.object(name), cell.object(name).start) for name in at}
    for name, covers in stacked(starts).items():
        for other in sorted(covers):
            yield at[other], at[name], f"{other} lies on {name} at the start"


def _ways(cell: Workcell, assembly: PartAssembly) -> Iterator[tuple[int, int, str]]:
    """Yield what would bar another part's straight way down, or up from where it starts."""
    at, goals = _placing(assembly), _goals(cell, assembly)
    starts = {name: (cell.object(name), cell.object(name).start) for name in at}
    out = {}
    for name in at:
        ways = assembly.ways(name)
        out[name] = -np.array(ways.extraction), ways.leave
    for name, goal in goals.items():
        ways = assembly.ways(name)
        way = np.array(ways.insertion), ways.approach
        for other, there in goals.items():
            if other == name:
                continue
            most = assembly.overlaps.most(name, other)
            if leads_through(goal, there, *way, most):
                words = f"{other} would bar the way of {name} to its place"
                yield at[name], at[other], words
            start = starts[other]
            if _overlap(goal, start) or leads_through(goal, start, *way):
                yield at[other], at[name], f"{other} is where {name} goes"
            elif leads_through(start, goal, *out[other]):
                yield at[other], at[name], f"{name} would lock {other} in at its start"


def _works(cell: Workcell, assembly: PartAssembly) -> Iterator[tuple[int, int, str]]:
    """Yield parts that would bar the straight way of a tool to where it works."""
    at, goals = _placing(assembly), _goals(cell, assembly)
    fixtures = {item.name: item for item in cell.fixtures}
    for k, step in enumerate(assembly.steps):
        if not isinstance(step, Work):
            continue
        base: Array = np.eye(4)
        if step.owner in fixtures:
            fixture = fixtures[step.owner]
            inside = np.eye(4) if step.frame is None else fixture.frames[step.frame]
            base = fixture.pose @ inside
        elif step.owner is not None:
            owner = cell.object(step.owner)
            base = assembly.goals.get(step.owner, owner.start)
        for pose in step.process.path or (np.eye(4),):
            way = _bore(base @ step.pose @ pose, step.process.approach)
            for name, goal in goals.items():
                if name != step.owner and _overlap(way, goal):
                    words = f"{name} would bar the tool's way to {step.at}"
                    yield k, at[name], words


def _bore(place: Array, length: float) -> Lying:
    """Return the straight way of a tool to a place of work, as a rod that stands on it."""
    size = readonly([_BORE, _BORE, length - 2.0 * MOST_OVERLAP])
    pose = readonly(place @ translation(0.0, 0.0, 0.5 * length))
    return Fixture("way", box_shape("way", size), pose), pose


def _overlap(one: Lying, other: Lying) -> bool:
    return any(gap < -0.5 * _BORE for gap in near_to(one, {"": other}, 0.0).values())


def _placing(assembly: PartAssembly) -> dict[str, int]:
    """Return the place in the list of the step that places each part."""
    return {s.part: k for k, s in enumerate(assembly.steps) if isinstance(s, Place)}


def _goals(cell: Workcell, assembly: PartAssembly) -> dict[str, Lying]:
    return {name: (cell.object(name), assembly.goals[name]) for name in assembly.placed}

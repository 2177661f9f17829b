"""Expansion of interchangeable parts to single parts, each with a name, a start pose and an optional goal.

The first parts of a type get its goals, and each goal gets a step. The planner may assign the goals of a type to
other parts of that type.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product, zip_longest
from typing import TypeVar

from scheduling.sequences.copies import product_part_name
from twin.document.validation import Problems
from twin.document.yaml_text import KeyPath
from twin.kinds.parts.between import FitSection
from twin.kinds.parts.section import PartSection, PartsSection, StepSection
from twin.kinds.parts.sources import PlacesSection
from twin.kinds.statics import JoinedSection
from twin.scenario.sections.shapes import PoseSection

Pair = TypeVar("Pair", JoinedSection, FitSection)


@dataclass(frozen=True)
class AlikeParts:
    """Interchangeable parts of one kind.

    Attributes:
        kind: their name in the scenario.
        names: names of all of them: KIND.1, KIND.2, ...
        goals: number of goals; the first names have one each.
        sourced: whether a source supplies them one after another, so that the planner has no choice.
    """

    kind: str
    names: tuple[str, ...]
    goals: int
    sourced: bool

    @property
    def with_goals(self) -> tuple[str, ...]:
        """Names of the parts with a goal."""
        return self.names[: self.goals]


def alike_parts(section: PartsSection) -> tuple[AlikeParts, ...]:
    """Return the interchangeable parts, kind by kind."""
    found = []
    for part in section.parts:
        if part.several:
            goals = len(_poses(part.goals))
            count = part.count or len(_poses(part.starts)) or goals
            names = tuple(product_part_name(part.name, k) for k in range(1, count + 1))
            found.append(AlikeParts(part.name, names, goals, part.source is not None))
    return tuple(found)


def with_named_parts(section: PartsSection) -> PartsSection:
    """Return an assembly with an entry for every part and a step for every goal.

    Args:
        section: checked section.
    """
    kinds = {own.kind: own for own in alike_parts(section)}
    if not kinds:
        return section
    parts = tuple(
        named
        for part in section.parts
        for named in (_named(part, kinds[part.name]) if part.several else (part,))
    )
    # A reference to a step of a kind means all of its goals.
    goals = {
        step.known_as: tuple(
            f"{step.known_as}-goal-{k}" for k in range(1, kinds[step.place].goals + 1)
        )
        for step in section.steps
        if step.place in kinds
    }
    steps = tuple(
        own
        for step in section.steps
        for own in _steps(step, kinds.get(step.place or ""), goals)
    )
    return section.changed(
        parts=parts,
        steps=steps,
        joined=_pairs(section.joined, kinds),
        fits=_pairs(section.fits, kinds),
    )


def listed_steps(section: PartsSection) -> tuple[int, ...]:
    """Return the number of the step in the file, from 0, for each expanded step."""
    goals = {own.kind: own.goals for own in alike_parts(section)}
    return tuple(
        k
        for k, step in enumerate(section.steps)
        for _ in range(goals.get(step.place or "", 1))
    )


def _poses(places: Sequence[PlacesSection] | None) -> list[PoseSection]:
    return [PoseSection.of(at) for place in places or () for at in place.places()]


def _named(part: PartSection, own: AlikeParts) -> Iterator[PartSection]:
    starts, goals = _poses(part.starts), _poses(part.goals)
    one = part.changed(count=None, starts=None, goals=None)
    for name, start, goal in zip_longest(own.names, starts, goals):
        if name is not None:
            yield one.changed(name=name, start=start, goal=goal)


def _steps(
    step: StepSection, kind: AlikeParts | None, goals: dict[str | None, tuple[str, ...]]
) -> Iterator[StepSection]:
    after = tuple(
        name if isinstance(own, str) else own.changed(step=name)
        for own in step.after
        for said in [own if isinstance(own, str) else own.step]
        for name in goals.get(said, (said,))
    )
    step = step.changed(after=after) if after != step.after else step
    if kind is None:
        yield step
        return
    for name, part in zip(goals[step.known_as], kind.with_goals, strict=True):
        yield step.changed(place=part, name=name)


def _pairs(pairs: Sequence[Pair], kinds: dict[str, AlikeParts]) -> tuple[Pair, ...]:
    """Return pairs with kinds expanded to their parts with a goal."""
    return tuple(
        item if both == item.parts else item.changed(parts=both)
        for item in pairs
        for both in product(
            *(kinds[p].with_goals if p in kinds else (p,) for p in item.parts)
        )
    )


def expand_pairs(
    pairs: Mapping[frozenset[str], float], alike: Sequence[AlikeParts]
) -> dict[frozenset[str], float]:
    """Return pairs with kinds expanded to all their parts.

    Args:
        pairs: values by pair of names in the file.
        alike: the kinds of interchangeable parts.
    """
    names = {own.kind: own.names for own in alike}
    return {
        frozenset(both): value
        for pair, value in pairs.items()
        for both in product(*(names.get(name, (name,)) for name in pair))
    }


def find_alike_problems(section: PartsSection) -> Problems:
    """Yield problems of interchangeable parts: too few parts or start poses.

    Args:
        section: section whose single values are checked.
    """
    kinds = {own.kind: own for own in alike_parts(section)}
    for i, part in enumerate(section.parts):
        if part.several:
            yield from _check_kind(part, kinds[part.name], ("assembly", "parts", i))
    named = {step.known_as: step.place for step in section.steps}
    for k, joint in enumerate(section.joined):
        if named.get(joint.by) in kinds:
            words = f"{joint.by} stands for a step a goal: leave by out"
            yield ("assembly", "joined", k, "by"), words
    for k, step in enumerate(section.steps):
        at: KeyPath = ("assembly", "steps", k)
        alike = f"{step.place} stands for parts that are alike"
        for key in ("at", "until"):
            if step.place in kinds and getattr(step, key) is not None:
                yield (*at, key), f"{alike}: leave {key} out"
        for key, name in (("hold", step.hold), ("at", step.at and step.at.part)):
            if name in kinds:
                words = f"{name} stands for parts that are alike, and it is ambiguous which is meant"
                yield (*at, key), f"{words}: name a part of its own"


def _check_kind(part: PartSection, own: AlikeParts, at: KeyPath) -> Problems:
    count, starts, name = len(own.names), len(_poses(part.starts)), part.name
    if part.starts and count > starts:
        words = f"{count} {name} need {count} places to lie at, and starts has {starts}"
        yield (*at, "starts"), f"{words}: give more places, or a lower count"
    if count < own.goals:
        words = (
            f"{own.goals} goals of {name} need {own.goals} parts, and there are {count}"
        )
        yield (*at, "goals"), f"{words}: give a higher count, or fewer goals"
    if own.sourced and count > own.goals:
        words = (
            f"a source gives what is placed, and {count} {name} have {own.goals} goals"
        )
        yield (*at, "count"), f"{words}: leave count out"

"""Changeovers between products of different variants: after which steps they begin, and which steps wait for them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from planning.errors import ScenarioError
from planning.parts.supply import Changeover
from scheduling.sequences.copies import product_part_name
from twin.durations.composed import AnyDuration
from twin.kinds.parts.section import PartsSection


def find_changeovers(
    section: PartsSection,
    variants: Mapping[str, PartsSection],
    sequence: Sequence[str],
    ends: Sequence[int],
) -> Iterator[tuple[Changeover, AnyDuration]]:
    """Yield the changeovers of a line and their durations.

    Args:
        section: with its changeovers.
        variants: sections with the steps of one variant each, by name.
        sequence: variant of each product.
        ends: number of the last step of each product.
    """
    for item in section.changeovers:
        uses = {k: _uses(own, item.machine) for k, own in variants.items()}
        last = 0
        for product, variant in enumerate(sequence, start=1):
            begin, _ = uses[variant]
            if not begin:
                continue
            if last and (time := item.between(sequence[last - 1], variant)):
                _, end = uses[sequence[last - 1]]
                first = ends[product - 1] - len(variants[variant].steps)
                before = ends[last - 1] - len(variants[sequence[last - 1]].steps)
                yield (
                    Changeover(
                        item.chain,
                        product_part_name(variants[variant].placed[0], product),
                        f"change over from {sequence[last - 1]} to {variant}",
                        frozenset(before + k for k in end),
                        frozenset(first + k for k in begin),
                        item.machine is None,
                    ),
                    time,
                )
            last = product


def changeover_seconds(section: PartsSection) -> tuple[tuple[float, ...], ...]:
    """Return the longest mean duration of the changeovers from each variant to each other, by rows [s].

    Raises:
        ValueError: a duration is not known.
    """
    names = section.products.variants if section.products else {}
    own = {name: section.of_variant(name) for name in names}

    def longest(before: str, after: str) -> float:
        means = [0.0]
        for item in section.changeovers:
            time, both = item.between(before, after), (own[before], own[after])
            if time is not None and all(_uses(k, item.machine)[0] for k in both):
                means.append(time.mean)
        return max(means)

    try:
        return tuple(tuple(longest(a, b) for b in names) for a in names)
    except ScenarioError as error:
        words = f"order: best needs durations of changeovers without files: {error}"
        raise ValueError(words) from None


def _uses(own: PartsSection, machine: str | None) -> tuple[list[int], list[int]]:
    """Return the steps of a variant that first and last concern a machine, or all of them without one, from 1.

    They put a part down where it works, and take it on from there; where it works at a part in its place, they are the
    work itself.
    """
    if machine is None:
        steps = list(range(1, len(own.steps) + 1))
        return steps, steps
    begin, end = list[int](), list[int]()
    for k, step in enumerate(own.steps):
        process = own.processes.get(step.process or "")
        if process is None or process.machine != machine or step.at is None:
            continue
        moves = [n for n, s in enumerate(own.steps) if s.place == step.at.part]
        put = max((n for n in moves if n < k), default=k)
        stays = own.steps[put].at is None
        begin.append(k + 1 if stays else put + 1)
        end.append(min((n for n in moves if n > k), default=k) + 1)
    return begin, end

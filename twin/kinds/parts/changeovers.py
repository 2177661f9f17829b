"""Changeovers between products of different variants: after which steps they begin, and which steps wait for them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

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
        uses = {k: own.steps_at(item.machine) for k, own in variants.items()}
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

"""Best sequence of products of several variants, by dynamic programming over a model of cycle and changeover times.

In the model products are made one after another: each takes the cycle time of its variant, after the changeover from the
variant before. What is still to be made depends on nothing but how many of each variant are made, and what comes next on
the last of them too. So of all sequences that lead to the same state only those matter that are not worse in both cost and
time than another: the best of them at the end is exact.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import prod
from typing import Literal, TypeAlias, Union

Objective = Literal["makespan", "changeovers", "lateness"]
"""What is least: the time of all, the number of changeovers, or the sum of the times by which products are late."""

MOST_COMPARED = 1_000_000
"""Most beginnings of sequences that are compared."""

_SAME_S = 1e-9
"""Times that differ by less are the same [s]."""

Made: TypeAlias = Union[tuple[int, "Made"], None]  # noqa: UP007
"""The last variant, and those before it."""

_Label = tuple[float, float, Made]
"""Cost and time [s] of a beginning, and its variants."""


@dataclass(frozen=True)
class SequenceModel:
    """Products to be put into a sequence.

    Attributes:
        counts: number of products of each variant.
        cycles: cycle time of each variant [s].
        changes: changeover times from each variant to each other, by rows [s].
        due: when the products of each variant are due, in their order [s]; empty if they have no times of their own.
        due_in_turn: when the first, second, ... product of all is due, where variants have no times of their own [s].
    """

    counts: tuple[int, ...]
    cycles: tuple[float, ...]
    changes: tuple[tuple[float, ...], ...]
    due: tuple[tuple[float, ...], ...] = ()
    due_in_turn: tuple[float, ...] = ()

    def added(
        self, label: _Label, made: Sequence[int], variant: int, objective: Objective
    ) -> _Label:
        """Return a beginning with one more product.

        Args:
            label: the beginning.
            made: number of its products of each variant.
            variant: of the next one.
            objective: which cost is counted.
        """
        cost, time, before = label
        if before is not None:
            time += self.changes[before[0]][variant]
        time += self.cycles[variant]
        if objective == "makespan":
            cost = time
        elif objective == "changeovers":
            cost += before is not None and before[0] != variant
        elif self.due or self.due_in_turn:
            own = self.due[variant][made[variant]] if self.due else None
            cost += max(
                0.0, time - (self.due_in_turn[sum(made)] if own is None else own)
            )
        return cost, time, (variant, before)


@lru_cache(maxsize=32)
def best_sequence(model: SequenceModel, objective: Objective) -> tuple[int, ...]:
    """Return the variants of the sequence of least cost, and of these the one of least time.

    Raises:
        ValueError: there is too much to be compared.
    """
    # At least one beginning leads to each state.
    compared = prod(count + 1 for count in model.counts)
    states: dict[tuple[tuple[int, ...], int], list[_Label]]
    states = {(tuple([0] * len(model.counts)), -1): [(0.0, 0.0, None)]}
    for _ in range(sum(model.counts)):
        following: dict[tuple[tuple[int, ...], int], list[_Label]] = {}
        if compared > MOST_COMPARED:
            raise ValueError(
                f"order: best compares more than {MOST_COMPARED} beginnings of sequences here: give fewer products or"
                " variants, or list the order"
            )
        for (made, _), labels in states.items():
            for variant, count in enumerate(model.counts):
                if made[variant] < count:
                    now = (*made[:variant], made[variant] + 1, *made[variant + 1 :])
                    following.setdefault((now, variant), []).extend(
                        model.added(own, made, variant, objective) for own in labels
                    )
                    compared += len(labels)
        states = {key: _efficient(own) for key, own in following.items()}
    last = min(
        (own for labels in states.values() for own in labels), key=lambda own: own[:2]
    )
    return tuple(_variants(last[2]))


def counts_by_shares(shares: Mapping[str, float], count: int) -> tuple[int, ...]:
    """Return how many products are of each variant: shares rounded down, and one more for the largest remainders."""
    exact = [share / sum(shares.values()) * count for share in shares.values()]
    found = [int(own + _SAME_S) for own in exact]
    order = sorted(range(len(exact)), key=lambda k: (found[k] - exact[k], k))
    for k in order[: count - sum(found)]:
        found[k] += 1
    return tuple(found)


def _efficient(labels: list[_Label]) -> list[_Label]:
    """Return the beginnings that no other one equals or betters in both cost and time."""
    kept: list[_Label] = []
    for own in sorted(labels, key=lambda own: own[:2]):
        if not kept or own[1] < kept[-1][1] - _SAME_S:
            kept.append(own)
    return kept


def _variants(made: Made) -> list[int]:
    found = []
    while made is not None:
        variant, made = made
        found.append(variant)
    return found[::-1]

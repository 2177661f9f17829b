"""Design of a study: policies, varied inputs, and the number of replications of each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from math import ceil

from planning.errors import RequestError
from twin.audits.worlds.engines import Engine
from twin.runs.policies import named_policies
from twin.scenario.variations import Variant
from twin.studies.replications.statistics import Precision

GROWTH = 1.5
"""Growth factor of the number of replications until the precision is reached."""


@dataclass(frozen=True)
class Block:
    """A fixed block of replications that are computed together.

    Attributes:
        cell: index into ``Experiment.cells``.
        first, count: number of the first replication, and how many there are.
    """

    cell: int
    first: int
    count: int

    @property
    def replications(self) -> range:
        """Numbers of the replications."""
        return range(self.first, self.first + self.count)


@dataclass(frozen=True)
class Experiment:
    """The design of a study.

    Attributes:
        policies: names of twin.runs.policies, the first being the reference of differences.
        variants: values of the varied inputs, at least one (empty when nothing is varied).
        replications: number for every policy and variant; None to continue until ``precision``.
        precision: stopping rule for ``replications`` of None.
        antithetic: whether replications 2k and 2k + 1 have mirrored draws.
        audited: replications of the open-loop policy whose motion is checked for collisions.
        audit_engine: collision engine; by default PyBullet where it is installed, else coal.
    """

    policies: tuple[str, ...]
    variants: tuple[Variant, ...] = ({},)
    replications: int | None = None
    precision: Precision = field(default_factory=Precision)
    antithetic: bool = False
    audited: int = 20
    audit_engine: Engine | None = None

    def __post_init__(self) -> None:
        for policy in self.policies:
            if policy not in named_policies():
                raise RequestError(
                    f"no policy {policy!r}", choices=tuple(named_policies())
                )
        if len(set(self.policies)) < len(self.policies) or not self.policies:
            raise RequestError(
                "a study needs at least one policy, and each of them once"
            )
        if self.replications is not None and self.replications < 1:
            raise RequestError(
                f"replications must be at least 1, not {self.replications}"
            )

    @property
    def cells(self) -> tuple[tuple[str, Variant], ...]:
        """Every policy with every variant, variant by variant."""
        return tuple((p, v) for v in self.variants for p in self.policies)

    def targets(self) -> Iterator[int]:
        """Yield numbers of replications after which to check the precision."""
        if self.replications is not None:
            yield self.replications
            return
        count = self.precision.least
        while count < self.precision.most:
            yield count
            count = 2 * ceil(count * GROWTH / 2)
        yield self.precision.most


def blocks_of(cell: int, begin: int, end: int, size: int) -> Iterator[Block]:
    """Yield blocks of at most ``size`` that cover replications ``begin`` to ``end``."""
    for first in range(begin, end, size):
        yield Block(cell, first, min(size, end - first))

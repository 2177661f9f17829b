"""Scenario sections for sources of parts (places, feeders, trays, stacks, conveyors) and for products."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, PrivateAttr, model_validator

from planning.transforms import Transform, read_only_copy, translation
from twin.document.section import Name, PairOf, Section, Several, with_tuples
from twin.durations.bounded import Fixed
from twin.durations.composed import AnyDuration
from twin.durations.model import PositiveSeconds, Seconds
from twin.kinds.parts.best_sequence import (
    Objective,
    SequenceModel,
    best_sequence,
    counts_by_shares,
)
from twin.kinds.parts.variants import repeated_sequence, sequence_by_shares
from twin.scenario.sections.shapes import PoseSection

# Value ranges of keys.
Count = Annotated[int, Field(ge=1, le=100)]
Amount = Annotated[int, Field(ge=1, le=1000)]
Pitch = Annotated[float, Field(ge=-100, le=100)]


class GridSection(Section):
    """Places in rows and columns.

    Attributes:
        counts: how many places along x, and how many along y.
        pitch_m: from one place to the next along x, and along y.
    """

    counts: PairOf[Count]
    pitch_m: PairOf[Pitch]

    @property
    def size(self) -> int:
        """Number of places."""
        return self.counts[0] * self.counts[1]

    def places(self) -> list[Transform]:
        """Return the places, along x first."""
        (nx, ny), (dx, dy) = self.counts, self.pitch_m
        at = ((i * dx, j * dy) for j in range(ny) for i in range(nx))
        return [translation(x, y, 0.0) for x, y in at]


class PlacesSection(PoseSection):
    """A pose, or places in rows and columns, the first of which is there.

    Attributes:
        grid: the places, in the frame of the pose, along x first; the pose alone when not given.
    """

    grid: GridSection | None = None

    def places(self) -> list[Transform]:
        """Return the places in the world."""
        pose = self.transform()
        inside = (
            [translation(0.0, 0.0, 0.0)] if self.grid is None else self.grid.places()
        )
        return [read_only_copy(pose @ at) for at in inside]


def _listed(places: Any) -> Any:
    """Return places as a list: one entry alone is the only one."""
    return with_tuples([places] if isinstance(places, dict) else places)


Places = Annotated[
    Several[PlacesSection],
    BeforeValidator(
        _listed, json_schema_input_type=PlacesSection | Several[PlacesSection]
    ),
]
"""One entry, or a list of them."""


class _Refilled(Section):
    """What sources have in common that are filled again once they are empty.

    Attributes:
        pose: of the centre of the part that is taken first.
        refill_s: time from when the last part has been taken until the next is there.
        refill: distribution of that time, in place of ``refill_s``.
    """

    pose: PoseSection
    refill_s: Seconds = 0.0
    refill: AnyDuration | None = None

    not_both = (("refill_s", "refill"),)

    @property
    def refill_time(self) -> AnyDuration:
        """Time until the next part, or the next full one, is there."""
        return self.refill or Fixed(value_s=self.refill_s)


class FeederSection(_Refilled):
    """A place where the next part appears when the last was taken.

    Attributes:
        kind: ``feeder``.
    """

    kind: Literal["feeder"]


class TraySection(_Refilled):
    """A tray of parts, exchanged for a full one when the last was taken.

    Attributes:
        kind: ``tray``.
        grid: the places in it, in the frame of ``pose``, along x first.
    """

    kind: Literal["tray"]
    grid: GridSection


class StackSection(_Refilled):
    """Parts on top of each other, the top one taken first.

    Attributes:
        kind: ``stack``.
        count: how many there are when it is full.
        pitch_m: height from one part to the next, along z of ``pose``.
    """

    kind: Literal["stack"]
    count: Count
    pitch_m: Annotated[float, Field(gt=0, le=10)]


class ConveyorSection(Section):
    """A conveyor that brings one part after another to its end; the first one is there at the start.

    Attributes:
        kind: ``conveyor``.
        pose: of the centre of a part at the end, where it is taken.
        every_s: time from one part to the next.
        every: distribution of that time, in place of ``every_s``.
        advance_s: time until the next part is at the end once the one before has been taken.
        buffer: parts that may wait on it behind that at the end, until it stops bringing; any
            number when not given.
    """

    kind: Literal["conveyor"]
    pose: PoseSection
    every_s: PositiveSeconds | None = None
    every: AnyDuration | None = None
    advance_s: Seconds = 0.0
    buffer: Annotated[int, Field(ge=0, le=20)] | None = None

    @model_validator(mode="after")
    def _one_time(self) -> ConveyorSection:
        if (self.every_s is None) == (self.every is None):
            raise ValueError("how often does a part come? Give every_s or every")
        return self

    @property
    def advance(self) -> AnyDuration:
        """Time until the next part is at the end."""
        return Fixed(value_s=self.advance_s)

    @property
    def interval(self) -> AnyDuration:
        """Time from one part to the next."""
        return self.every or Fixed(value_s=self.every_s or 0.0)


SourceSection = Annotated[
    FeederSection | TraySection | StackSection | ConveyorSection,
    Field(discriminator="kind"),
]
"""A source of parts, by ``kind``."""


class DueSection(Section):
    """When products are due: the first one, and one after another from then on.

    Attributes:
        first_s: when the first one is.
        every_s: time from one to the next.
    """

    first_s: Seconds
    every_s: Seconds

    def first(self, count: int) -> tuple[float, ...]:
        """Return when each of a number of first products is due [s]."""
        return tuple(self.first_s + k * self.every_s for k in range(count))


class VariantSection(Section):
    """A variant of the products: it has the steps that name it in ``variants``, and those that name none.

    Attributes:
        share: how many of the products are of it, in proportion to the shares of the other variants; 1 when not
            given.
        cycle_s: time from one of its products to the next, where ``order: best`` looks at lateness.
        due: when its products are due, in place of ``due`` of all.
    """

    share: Annotated[float, Field(ge=0, le=1e6)] | None = None
    cycle_s: PositiveSeconds | None = None
    due: DueSection | None = None


def _share_spelt_out(variant: Any) -> Any:
    """Return a variant in full: a number alone is its share."""
    number = isinstance(variant, int | float) and not isinstance(variant, bool)
    return {"share": float(variant)} if number else with_tuples(variant)


Variant = Annotated[
    VariantSection,
    BeforeValidator(_share_spelt_out, json_schema_input_type=VariantSection | float),
]


class OrderSection(Section):
    """An order of equal products, made before those of a lower priority, and of a later due time.

    Attributes:
        count: number of them.
        variant: of them, where there are variants.
        priority: the highest comes first.
        due_s: when they are due.
    """

    count: Amount
    variant: Name | None = None
    priority: Annotated[int, Field(ge=-100, le=100)] = 0
    due_s: Seconds | None = None


class ProductsSection(Section):
    """How many products are made, what becomes of them, and when they are due.

    Attributes:
        count: number of products.
        variants: kinds of products, by name; with a number its share. All are equal when not given.
        order: in which order variants are made: ``drawn`` draws each product by the shares; names of variants are
            repeated until there are enough products; ``best`` looks for the sequence in which ``objective`` is least.
        objective: ``makespan``, the number of ``changeovers``, or the sum of ``lateness``.
        seed: of these draws.
        orders: what is made, in place of shares and ``order``: by priority, then by due time, then as listed.
        places: a pallet: product by product stands in the next of its places, moved from
            ``goal`` along the axes of the world; the pallet leaves when it is full. Every product
            leaves on its own when not given.
        in_progress: greatest number of products that are begun and not complete at a time; any number when not
            given.
        leave_s: time until a finished product, or a full pallet, is gone.
        leave: distribution of that time, in place of ``leave_s``.
        due: when they are due: the first and the time between two, or one time a product.
        start_up: products at the beginning that do not count for throughput and takt; a tenth
            when not given.
        spare: products for which there are parts besides, and which ``twin operate`` makes in place of those
            that are not made whole, or where more are ordered.
    """

    count: Annotated[int, Field(ge=1, le=100_000)]
    spare: Annotated[int, Field(ge=0, le=100_000)] = 0
    variants: dict[Name, Variant] = Field(default_factory=dict)
    order: Literal["drawn", "best"] | Several[Name] = "drawn"
    objective: Objective = "makespan"
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    orders: Annotated[tuple[OrderSection, ...], Field(max_length=1000)] = ()
    places: GridSection | None = None
    in_progress: Annotated[int, Field(ge=1, le=100)] | None = None
    leave_s: Seconds = 0.0
    leave: AnyDuration | None = None
    due: DueSection | Several[Seconds] | None = None
    start_up: Annotated[int, Field(ge=0, le=100_000)] | None = None

    not_both = (("leave_s", "leave"),)

    _changes: tuple[tuple[float, ...], ...] = PrivateAttr(default=())

    @model_validator(mode="after")
    def _fits_together(self) -> ProductsSection:
        if isinstance(self.due, tuple) and len(self.due) != self.count:
            raise ValueError(
                f"{len(self.due)} due times for {self.count} products: give one for each"
            )
        if self.start_up is not None and self.start_up > self.count - 2:
            raise ValueError(
                "of the products at least two must be left after start_up to tell a takt"
            )
        own = self.variants.values()
        if not own and (self.order != "drawn" or self.seed):
            raise ValueError("order and seed are of variants: give variants")
        if own and not any(self.shares.values()):
            raise ValueError("no variant has a share above 0: give one of them a share")
        if own and self.order == "best":
            self._check_best()
        elif self.objective != "makespan":
            raise ValueError("objective is of order: best")
        if len({self.due is None and one.due is None for one in own}) > 1:
            raise ValueError("give due for each of the variants, for all, or for none")
        if self.orders:
            self._check_orders()
        return self

    def _check_orders(self) -> None:
        total = sum(own.count for own in self.orders)
        if total != self.count:
            raise ValueError(f"orders are of {total} products: write count: {total}")
        if {own.variant for own in self.orders} - (self.variants.keys() or {None}):
            known = f"one of {', '.join(self.variants)}" if self.variants else "none"
            raise ValueError(f"the variant of each of the orders must be {known}")
        every = self.due or any(own.due for own in self.variants.values())
        if (
            every
            or self.order != "drawn"
            or len({own.due_s is None for own in self.orders}) > 1
        ):
            words = "give due_s for each of the orders, or for none"
            raise ValueError(f"{words}, and neither order nor due")

    @property
    def _ordered(self) -> list[OrderSection]:
        """The order of each product, in the sequence in which they are made."""
        own = sorted(self.orders, key=lambda one: (-one.priority, one.due_s or 0.0))
        return [one for one in own for _ in range(one.count)]

    def _check_best(self) -> None:
        counts = counts_by_shares(self.shares, self.count)
        for name, count in zip(self.variants, counts, strict=True):
            if not count:
                words = f"of {self.count} products none is of {name} by its share"
                raise ValueError(f"{words}: give it a larger one, or leave it out")
            if self.objective == "lateness" and self.variants[name].cycle_s is None:
                raise ValueError(f"lateness needs cycle times: give {name} cycle_s")
        if self.objective == "lateness" and not (self.due or self.variants[name].due):
            raise ValueError("nothing can be late: give due")

    def set_changes(self, changes: tuple[tuple[float, ...], ...]) -> None:
        """Set the changeover times from each variant to each other, by rows [s], while the assembly is made."""
        self._changes = changes

    @property
    def shares(self) -> dict[str, float]:
        """Shares of the variants by name."""
        given = ((name, own.share) for name, own in self.variants.items())
        return {name: 1.0 if share is None else share for name, share in given}

    def sequence(self, count: int) -> tuple[str, ...]:
        """Return the variant of each of a number of first products; empty without variants."""
        if not self.variants:
            return ()
        if self.orders:
            names = [one.variant or "" for one in self._ordered]
            return repeated_sequence(names, count)
        if self.order == "drawn":
            return sequence_by_shares(self.shares, count, self.seed)
        order = self._best_order() if self.order == "best" else self.order
        return repeated_sequence(order, count)

    def _best_order(self) -> tuple[str, ...]:
        counts = counts_by_shares(self.shares, self.count)
        own, late = self.variants.values(), self.objective == "lateness"
        model = SequenceModel(
            counts,
            tuple(item.cycle_s or 0.0 for item in own),
            self._changes or ((0.0,) * len(counts),) * len(counts),
            tuple(
                item.due.first(count)
                for item, count in zip(own, counts, strict=True)
                if item.due and late
            ),
            self.due.first(self.count)
            if isinstance(self.due, DueSection)
            else self.due or (),
        )
        names = list(self.variants)
        return tuple(names[k] for k in best_sequence(model, self.objective))

    @property
    def leave_time(self) -> AnyDuration:
        """Time until a finished product, or a full pallet, is gone."""
        return self.leave or Fixed(value_s=self.leave_s)

    def due_s(self) -> tuple[float, ...]:
        """Return when each product is due [s], nothing where they are not."""
        return tuple(self._due_s())

    def _due_s(self) -> Iterator[float]:
        yield from (one.due_s for one in self._ordered if one.due_s is not None)
        made = Counter[str]()
        for k, variant in enumerate(self.sequence(self.count) or [""] * self.count):
            own = self.variants[variant].due if variant in self.variants else None
            number, due = (k, self.due) if own is None else (made[variant], own)
            made[variant] += 1
            if isinstance(due, DueSection):
                yield due.first_s + number * due.every_s
            elif due is not None:
                yield due[k]

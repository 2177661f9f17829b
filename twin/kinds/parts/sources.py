"""Scenario sections for sources of parts (places, feeders, trays, stacks, conveyors) and for products."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    PrivateAttr,
    model_validator,
)

from planning.transforms import Array, Transform, read_only_copy, translation
from twin.document.section import Name, Section, Several, with_tuples
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

_MOST_PLACES = 10_000
"""Most places of a grid."""

_NEAR = 6
"""Decimals to which places are equally far along a direction [m]."""


class GridSection(Section):
    """Places in rows and columns, and in layers above each other.

    A place has a number from 1: along x first, then along y, then from the lowest layer up.

    Attributes:
        counts: how many places along x, how many along y, and how many layers; one layer when not given.
        pitch_m: from one place to the next along x, along y, and from one layer up to the next.
        order: order within a layer: ``rows`` along x first, ``columns`` along y first. Trays are emptied from
            the top layer down, all else is filled from the lowest layer up. ``clear``, of trays and pallets: what
            is last along the way of a part (``take_out``, ``insert``) comes first; where that is equal, trays are
            emptied from the side of the tool (``grips.directions``), and pallets are filled towards it. Or the
            numbers of all places, in their order.
    """

    counts: Annotated[tuple[Count, ...], Field(min_length=2, max_length=3)]
    pitch_m: Annotated[tuple[Pitch, ...], Field(min_length=2, max_length=3)]
    order: Literal["rows", "columns", "clear"] | Several[int] = "rows"

    @model_validator(mode="after")
    def _check_places(self) -> GridSection:
        if len(self.counts) != len(self.pitch_m):
            raise ValueError(
                f"counts has {len(self.counts)} entries, and pitch_m {len(self.pitch_m)}: give one for each"
            )
        if self.size > _MOST_PLACES:
            raise ValueError(f"{self.size} places: there may be {_MOST_PLACES}")
        for axis, count, pitch in zip("xyz", self.counts, self.pitch_m, strict=False):
            if count > 1 and pitch == 0.0:
                raise ValueError(f"{count} places along {axis} need a pitch_m, not 0")
            if axis == "z" and pitch < 0.0:
                words = "layers are counted from the lowest up"
                raise ValueError(f"{words}: pitch_m along z must be positive")
        numbers = self.order if isinstance(self.order, tuple) else ()
        if numbers and sorted(numbers) != [*range(1, self.size + 1)]:
            words = f"order must have every number from 1 to {self.size} once"
            raise ValueError(f"{words}, or be rows, columns or clear")
        return self

    @property
    def size(self) -> int:
        """Number of places."""
        return int(np.prod(self.counts))

    def by_number(self) -> list[Transform]:
        """Return the places by their numbers."""
        (nx, ny, nz), (dx, dy, dz) = (*self.counts, 1)[:3], (*self.pitch_m, 0.0)[:3]
        return [
            translation(i * dx, j * dy, k * dz)
            for k in range(nz)
            for j in range(ny)
            for i in range(nx)
        ]

    def numbers(
        self,
        pose: Transform | None = None,
        directions: Sequence[Array] = (),
        *,
        emptied: bool = False,
    ) -> list[int]:
        """Return the numbers of the places, from 0, in the order in which they are filled or emptied.

        Args:
            pose: of the grid in the world, for ``clear``.
            directions: in the world, shape (3,), for ``clear``: what is farther along the first of them comes
                first, of what is equally far along that what is farther along the next.
            emptied: whether they are emptied, the top layer first.
        """
        if isinstance(self.order, tuple):
            return [number - 1 for number in self.order]
        number = np.arange(self.size)
        row, layer = number // self.counts[0], number // np.prod(self.counts[:2])
        if self.order == "clear" and pose is not None:
            points = np.array([(pose @ at)[:3, 3] for at in self.by_number()])
            far = [np.round(points @ way, _NEAR) for way in directions]
            keys = number, *(-own for own in reversed(far))
        else:
            column = number % self.counts[0] if self.order == "columns" else 0 * number
            keys = row, column, -layer if emptied else layer
        return [int(k) for k in np.lexsort(keys)]

    def places(self) -> list[Transform]:
        """Return the places in the order in which they are filled."""
        poses = self.by_number()
        return [poses[number] for number in self.numbers()]

    def words(self, number: int) -> str:
        """Return what a place is called, by its number from 0."""
        layer = number // (self.counts[0] * self.counts[1]) + 1
        return f"place {number + 1}" + (f" in layer {layer}" if self.counts[2:] else "")


def _without_clear(grid: GridSection) -> GridSection:
    if grid.order == "clear":
        words = "order clear is of trays and pallets"
        raise ValueError(f"{words}: write rows, columns or numbers")
    return grid


FixedGrid = Annotated[GridSection, AfterValidator(_without_clear)]
"""Places whose order does not depend on how a part is led there."""


class PlacesSection(PoseSection):
    """A pose, or places in rows, columns and layers, the first of which is there.

    Attributes:
        grid: the places, in the frame of the pose; the pose alone when not given.
    """

    grid: FixedGrid | None = None

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
        pose: of the centre of the part that is taken first; of a tray, of place 1.
        refill_s: time from when the last part has been taken until the next is there.
        refill: distribution of that time, in place of ``refill_s``.
        refill_by: name of who brings it, such as a vehicle or a person; who is named by several sources, or by
            ``products.leave_by``, does one after another, in the order of the plan.
    """

    pose: PoseSection
    refill_s: Seconds = 0.0
    refill: AnyDuration | None = None
    refill_by: Name | None = None

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
        grid: the places in it, in the frame of ``pose``.
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


class RushSection(Section):
    """A rush order of equal products: it comes in while others are made, and is made next.

    Attributes:
        at_s: when it comes in, which nobody knows beforehand [s].
        count: number of products.
        variant: of them, where there are variants.
        due_s: when they are due.
    """

    at_s: Seconds
    count: Amount = 1
    variant: Name | None = None
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
        leave_by: name of who takes it away, as ``refill_by`` of sources.
        due: when they are due: the first and the time between two, or one time a product.
        start_up: products at the beginning that do not count for throughput and takt; a tenth
            when not given, ``auto`` for as many as MSER-5 leaves out.
        spare: products for which there are parts besides, and which ``twin operate`` makes in place of those
            that are not made whole, or where more are ordered.
        rush: orders that come in while others are made, for ``twin operate``.
        rush_after: how many products were begun before each product of ``rush`` that came in, as ``twin operate``
            writes it.
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
    leave_by: Name | None = None
    due: DueSection | Several[Seconds] | None = None
    start_up: Annotated[int, Field(ge=0, le=100_000)] | Literal["auto"] | None = None
    rush: Annotated[tuple[RushSection, ...], Field(max_length=100)] = ()
    rush_after: tuple[Annotated[int, Field(ge=0)], ...] | None = None

    not_both = (("leave_s", "leave"),)

    _changes: tuple[tuple[float, ...], ...] = PrivateAttr(default=())

    @model_validator(mode="after")
    def _fits_together(self) -> ProductsSection:
        if isinstance(self.due, tuple) and len(self.due) != self.count:
            raise ValueError(
                f"{len(self.due)} due times for {self.count} products: give one for each"
            )
        if isinstance(self.start_up, int) and self.start_up > self.count - 2:
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
        if self.rush:
            self._check_rush()
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

    def _check_rush(self) -> None:
        if {own.variant for own in self.rush} - (self.variants.keys() or {None}):
            known = f"one of {', '.join(self.variants)}" if self.variants else "none"
            raise ValueError(f"the variant of each of rush must be {known}")
        own = [self.due, *(one.due for one in self.variants.values())]
        due = any([*own, *(one.due_s is not None for one in self.orders)])
        if {one.due_s is not None for one in self.rush} - {due}:
            words = "give each of rush due_s where products are due, and else none"
            raise ValueError(words)

    @property
    def rushed(self) -> list[RushSection]:
        """The rush order of each product of one, in the order in which they come in."""
        own = sorted(self.rush, key=lambda one: one.at_s)
        return [one for one in own for _ in range(one.count)]

    @property
    def made(self) -> list[int]:
        """Numbers of the products in the order in which they are made, without rush orders that have not come in."""
        first = self.count + len(self.rushed) + 1
        made = [*range(1, self.count + 1), *range(first, first + self.spare)]
        come = range(self.count + 1, first)
        for number, before in zip(come, self.rush_after or (), strict=False):
            made.insert(before, number)
        return made

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
        if self.rush_after is not None and self.variants:
            base = self.changed(rush_after=None).sequence(count)
            rush = [one.variant or "" for one in self.rushed]
            return (*base[: self.count], *rush, *base[self.count :])[:count]
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
        come = [] if self.rush_after is None else self.rushed
        return (*self._due_s(), *(one.due_s for one in come if one.due_s is not None))

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

"""Units of a line of several variants: products in their surroundings, each planned once for all equal ones.

A unit is one product of a variant, with the slots of sources from which its parts come, its place on a pallet, and
whatever else is at rest meanwhile: parts of other products, which it knows by their poses alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from planning.parts.supply import Leaving, Supply
from planning.tasks.refill import PlacedPart
from planning.tasks.task import Task, TaskKind, is_product_task
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.sequences.copies import product_part_name
from scheduling.sequences.sequence import PlanSequence, SequencedPlan
from twin.kinds.parts.line import Line, write_out_line
from twin.kinds.parts.section import PartsSection
from twin.kinds.parts.sources import ProductsSection

_OTHER = "of-other-products"
"""Name of parts of other products in a unit; a number is added."""


@dataclass(frozen=True)
class LineUnits:
    """The products of a line, each as one of a few units.

    Attributes:
        line: with all products.
        units: lines of one product.
        order: unit of each product.
        names: of each product the names of the objects of its unit, by their names there.
    """

    line: Line
    units: tuple[Line, ...]
    order: tuple[int, ...]
    names: tuple[Mapping[str, str], ...]

    def sequence(self, plans: Sequence[TemporalPlanGraph]) -> PlanSequence:
        """Return the plans of all products from those of the units."""
        planned = [
            SequencedPlan(
                unit,
                names,
                np.array(
                    [self._product(task, names, product) for task in plans[unit].tasks]
                ),
            )
            for product, (unit, names) in enumerate(
                zip(self.order, self.names, strict=True), start=1
            )
        ]
        waits = np.array(list(self._waits(plans)), dtype=np.int64).reshape(-1, 4)
        return PlanSequence(tuple(plans), tuple(planned), waits)

    def _product(self, task: Task, names: Mapping[str, str], product: int) -> int:
        """Return the product that a task is for: that of the part that it brings, or the one that is made."""
        if task.kind in (TaskKind.ARRIVE, TaskKind.PRESENT):
            return self.line.numbers[names[str(task.object)]][1]
        return product

    def _waits(
        self, plans: Sequence[TemporalPlanGraph]
    ) -> Iterator[tuple[int, int, int, int]]:
        """Yield which tasks wait for tasks of earlier products, see ``PlanSequence.waits``.

        As within a product, the pick of a part waits for it to be there, a conveyor for room on it, and what is done
        at the place of a product for those to be gone that left last.
        """
        there: dict[str, tuple[int, int]] = {}
        came: dict[str, list[tuple[int, int]]] = {}
        left: tuple[int, int] | None = None
        for m, (unit, names) in enumerate(zip(self.order, self.names, strict=True)):
            elsewhere = self.units[unit].supply.elsewhere
            for task in plans[unit].tasks:
                here, before = (m, task.index), None
                if task.kind == TaskKind.PRESENT:
                    there |= {names[h.object]: here for h in task.handlings}
                    came.setdefault(task.robot, []).append(here)
                elif (
                    task.kind == TaskKind.ARRIVE
                    and task.robot in self.line.supply.buffers
                ):
                    machine, buffer = self.line.supply.buffers[task.robot]
                    done = came.get(machine, [])
                    before = done[-1 - buffer] if len(done) > buffer else None
                elif task.kind == TaskKind.LEAVE:
                    left = here
                elif task.kind == "pick" and task.object is not None:
                    before = there.pop(names.get(task.object, task.object), None)
                elif is_product_task(task) and task.step not in elsewhere:
                    before = left
                if before is not None and before[0] != m:
                    yield *before, *here


@lru_cache(maxsize=8)
def line_units(section: str) -> LineUnits:
    """Return the units of a line of several variants.

    Args:
        section: of the assembly, as JSON; passed its checks.
    """
    return _Units(PartsSection.model_validate_json(section)).found()


class _Units:
    """Follows the parts of a line from product to product."""

    def __init__(self, section: PartsSection) -> None:
        assert section.products is not None
        self._line = line = write_out_line(section)
        sequence = section.products.sequence(line.products)
        self._alone = {
            variant: write_out_line(_one_product(section.of_variant(variant)))
            for variant in dict.fromkeys(sequence)
        }
        self._sequence = sequence
        self._parts = {part.name: part for part in line.section.parts}
        # Parts at rest, by name.
        self._rests = {k: x for k, x in self._parts.items() if k not in line.later}

    def found(self) -> LineUnits:
        units: dict[object, Line] = {}
        order, every, first = [], [], 0
        for product, variant in enumerate(self._sequence, start=1):
            alone = self._alone[variant]
            steps = range(first + 1, first + 1 + len(alone.section.steps))
            unit, names = self._unit(alone, product, steps)
            parts = tuple(part.model_dump_json() for part in unit.section.parts)
            supply = unit.supply
            refilled = [
                (k, [x for x, _ in own.parts]) for k, own in supply.refills.items()
            ]
            key = variant, parts, str(refilled), unit.later, len(supply.leaves)
            units.setdefault(key, unit)
            order.append(list(units).index(key))
            every.append(names)
            self._make(steps)
            first = steps[-1]
        return LineUnits(self._line, tuple(units.values()), tuple(order), tuple(every))

    def _unit(
        self, alone: Line, product: int, steps: range
    ) -> tuple[Line, Mapping[str, str]]:
        """Return a product in its surroundings, and the names of the objects there by those in the unit."""
        supply, numbers = self._line.supply, self._line.numbers
        coming = [
            name
            for k in steps
            if k in supply.refills
            for name, _ in supply.refills[k].parts
        ]
        there = {**self._rests, **{name: self._parts[name] for name in coming}}
        local: dict[str, str] = {}
        others = [
            name for name in there if numbers.get(name, ("", product))[1] != product
        ]
        others.sort(key=lambda name: (name in coming, f"{there[name].start}"))
        for k, name in enumerate(others, start=1):
            local[name] = product_part_name(_OTHER, k)
        for name in there.keys() - local.keys():
            local[name] = (
                product_part_name(numbers[name][0], 1) if name in numbers else name
            )
        parts = [
            part.changed(name=local[name], **({"goal": None} if name in others else {}))
            for name, part in sorted(there.items(), key=lambda item: local[item[0]])
        ]

        def placed(own: Sequence[PlacedPart]) -> tuple[PlacedPart, ...]:
            return tuple((local[name], pose) for name, pose in own)

        before = steps[0] - 1
        unit = replace(
            alone,
            section=alone.section.changed(parts=tuple(parts)),
            supply=Supply(
                {
                    k - before: replace(own, parts=placed(own.parts))
                    for k, own in supply.refills.items()
                    if k in steps
                },
                {
                    k - before: Leaving(own.machine, placed(own.parts))
                    for k, own in supply.leaves.items()
                    if k in steps
                },
                alone.supply.elsewhere,
                frozenset(local[name] for name in there.keys() & supply.sourced),
            ),
            later=frozenset(local[name] for name in coming),
            numbers={
                **alone.numbers,
                **{local[name]: (_OTHER, 0) for name in others},
            },
        )
        doors = {
            job.door: job.part for job in alone.jobs.values() if job.door and job.part
        }
        names = {own: name for name, own in local.items()}
        names |= {
            door: product_part_name(part, product) for door, part in doors.items()
        }
        return unit, names

    def _make(self, steps: range) -> None:
        """Let the parts of a product come, be put in their places, and leave."""
        supply = self._line.supply
        for k in steps:
            name = self._line.section.steps[k - 1].place
            if name is not None:
                part = self._rests[name]
                self._rests[name] = part.changed(start=part.goal or part.start)
            for name, _ in supply.refills[k].parts if k in supply.refills else ():
                self._rests[name] = self._parts[name]
            for name, _ in supply.leaves[k].parts if k in supply.leaves else ():
                del self._rests[name]


def _one_product(section: PartsSection) -> PartsSection:
    """Return the section of a variant for one product of no variant."""
    steps = tuple(step.changed(variants=None) for step in section.steps)
    return section.changed(steps=steps, products=ProductsSection(count=1))

"""Units of a line of several variants: products in their surroundings, each planned once for all equal ones.

A unit is one product of a variant, with the slots of sources from which its parts come, its place on a pallet, and
whatever else is at rest meanwhile: parts of other products, which it knows by their poses alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from planning.cell.machine import machine_robot
from planning.motion.motion_plan import MotionPlan, TaskMotion
from planning.parts.supply import Changeover, Leaving, Supply
from planning.tasks.refill import PlacedPart
from planning.tasks.task import (
    STILL,
    Task,
    TaskKind,
    changed_tools,
    is_product_task,
)
from scheduling.build_nodes import build_nodes
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.sequences.copies import product_part_name
from scheduling.sequences.sequence import PlanSequence, SequencedPlan
from twin.kinds.parts.line import Line, write_out_line
from twin.kinds.parts.section import PartsSection
from twin.kinds.parts.sources import ProductsSection

_OTHER = "of-other-products"
"""Name of parts of other products in a unit; a number is added."""


_Place = tuple[int, int]
"""A plan of the sequence, and a task of it."""


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
        """Return the plans of all products from those of the units, with the changeovers between them."""
        return _Sequence(self, plans).found()


class _Sequence:
    """The plans of a line in their order: those of products, and each changeover after the product that it follows."""

    def __init__(self, units: LineUnits, plans: Sequence[TemporalPlanGraph]) -> None:
        self._units, self._line, self._plans = units, units.line, list(plans)
        self._planned: list[SequencedPlan] = []
        self._waits: list[tuple[int, int, int, int]] = []
        self._there: dict[str, _Place] = {}
        self._came: dict[str, list[_Place]] = {}
        self._left: _Place | None = None
        # What begins and what ends each step of the line, and the changeovers that a step waits for.
        self._steps: dict[int, tuple[_Place, _Place]] = {}
        self._changed: dict[int, list[_Place]] = {}
        self._changes: dict[tuple[str, str], int] = {}

    def found(self) -> PlanSequence:
        before = 0
        order = zip(self._units.order, self._units.names, strict=True)
        for product, (unit, names) in enumerate(order, start=1):
            self._add_product(unit, names, product, before)
            count = len(self._units.units[unit].section.steps)
            for step in range(before + 1, before + count + 1):
                for own in self._line.supply.changeovers_after.get(step, ()):
                    self._add_changeover(own)
            before += count
        waits = [row for row in self._waits if row[0] != row[2]]
        rows = np.array(waits, dtype=np.int64).reshape(-1, 4)
        return PlanSequence(tuple(self._plans), tuple(self._planned), rows)

    def _wait(self, before: _Place | None, here: _Place) -> None:
        if before is not None:
            self._waits.append((*before, *here))

    def _add_product(
        self, unit: int, names: Mapping[str, str], product: int, before: int
    ) -> None:
        """Add the plan of a product, and what its tasks wait for in earlier ones.

        As within a product, the pick of a part waits for it to be there, a conveyor for room on it, and what is done
        at the place of a product for those to be gone that left last.
        """
        line, m = self._units.units[unit], len(self._planned)
        buffers, products = self._line.supply.buffers, []
        tools = changed_tools(self._plans[unit].tasks)
        for task in self._plans[unit].tasks:
            here, number = (m, task.index), product
            if task.kind in (TaskKind.ARRIVE, TaskKind.PRESENT):
                number = self._line.numbers[names[str(task.object)]][1]
            products.append(number)
            step = line.section.steps[task.step - 1]
            if task.kind == TaskKind.PRESENT:
                self._there |= {names[h.object]: here for h in task.handlings}
                self._came.setdefault(task.robot, []).append(here)
            elif task.kind == TaskKind.ARRIVE and task.robot in buffers:
                machine, buffer = buffers[task.robot]
                done = self._came.get(machine, [])
                self._wait(done[-1 - buffer] if len(done) > buffer else None, here)
            elif task.kind == TaskKind.LEAVE:
                self._left = here
            elif task.kind == "pick":
                own = names.get(str(task.object), "")
                self._wait(self._there.pop(own, None), here)
            elif (
                is_product_task(task, tools) and task.step not in line.supply.elsewhere
            ):
                self._wait(self._left, here)
            if task.kind == ("place-down" if step.place else step.process):
                # A robot approaches before it begins a process.
                robot = step.place is None and task.step not in line.jobs
                self._steps[before + task.step] = (m, task.index - robot), here
        for k in range(1, len(line.section.steps) + 1):
            for change in self._changed.pop(before + k, ()):
                self._wait(change, self._steps[before + k][0])
        self._planned.append(SequencedPlan(unit, names, np.array(products)))

    def _add_changeover(self, own: Changeover) -> None:
        """Add a changeover, which is a plan of one task of a machine."""
        m, key = len(self._planned), (own.machine, own.words)
        if key not in self._changes:
            self._changes[key] = len(self._plans)
            (seconds,) = (
                times.duration.mean
                for times in self._line.changeover_times
                if (times.robot, times.object) == (own.machine, own.part)
            )
            self._plans.append(_changeover_plan(self._plans[0], own, seconds))
        plan = self._changes[key]
        names = {str(self._plans[plan].tasks[0].object): own.part}
        products = np.array([self._line.numbers[own.part][1]])
        self._planned.append(SequencedPlan(plan, names, products))
        for step in own.after:
            self._wait(self._steps[step][1], (m, 0))
        self._wait(self._left if own.left else None, (m, 0))
        for step in own.before:
            self._changed.setdefault(step, []).append((m, 0))


def _changeover_plan(
    unit: TemporalPlanGraph, own: Changeover, seconds: float
) -> TemporalPlanGraph:
    """Return the plan of a changeover in the cell of a unit."""
    machine = machine_robot(own.machine)
    cell = replace(unit.cell, objects=(), machines=(machine,))
    task = Task(
        0, own.machine, TaskKind.CHANGEOVER, 0, own.words, STILL, object=own.part
    )
    still = TaskMotion(np.stack([machine.home] * 2), np.array([0.0, seconds]))
    none = np.empty((0, 2), dtype=np.int64)
    return build_nodes(MotionPlan(cell, (task,), (still,), none, ()))


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
            products=self._line.products,
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

"""Units of a line: products in their surroundings, each planned once for all equal ones.

A unit is one product of a variant, or consecutive ones that batches interleave, with the slots of sources from which
its parts come, its places in grids and on a pallet, and whatever else is at rest meanwhile: parts of other products,
which it knows by their poses alone.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise

import numpy as np

from planning.cell.machine import machine_robot
from planning.motion.motion_plan import MotionPlan, TaskMotion
from planning.parts.supply import Changeover, Leaving
from planning.parts.work_in_progress import waits_in_progress
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
from twin.kinds.parts.batch_starts import with_batches
from twin.kinds.parts.line import Line, write_out_line
from twin.kinds.parts.section import PartsSection
from twin.kinds.parts.sources import ProductsSection, VariantSection

_OTHER = "of-other-products"
"""Name of parts of other products in a unit; a number is added."""


_Place = tuple[int, int]
"""A plan of the sequence, and a task of it."""


@dataclass(frozen=True)
class LineUnits:
    """The products of a line in groups, each of them one of a few units.

    Attributes:
        line: with all products.
        units: lines of the products of one group.
        order: unit of each group.
        names: of each group the names of the objects of its unit, by their names there.
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
        # The tasks of all groups, numbered through with their steps, and where they are.
        self._tasks: list[Task] = []
        self._places: list[_Place] = []
        # What begins and what ends each step of the line, and the changeovers that a step waits for.
        self._steps: dict[int, tuple[_Place, _Place]] = {}
        self._changed: dict[int, list[_Place]] = {}
        self._changes: dict[tuple[str, str], int] = {}

    def found(self) -> PlanSequence:
        before = products = 0
        for unit, names in zip(self._units.order, self._units.names, strict=True):
            self._add_group(unit, names, products, before)
            count = len(self._units.units[unit].section.steps)
            for step in range(before + 1, before + count + 1):
                for own in self._line.supply.changeovers_after.get(step, ()):
                    self._add_changeover(own)
            before, products = before + count, products + self._units.units[unit].period
        for a, b, _ in waits_in_progress(self._line.supply, self._tasks):
            self._wait(self._places[a.index], self._places[b.index])
        waits = [row for row in self._waits if row[0] != row[2]]
        rows = np.array(waits, dtype=np.int64).reshape(-1, 4)
        return PlanSequence(tuple(self._plans), tuple(self._planned), rows)

    def _wait(self, before: _Place | None, here: _Place) -> None:
        if before is not None:
            self._waits.append((*before, *here))

    def _add_group(
        self, unit: int, names: Mapping[str, str], earlier: int, before: int
    ) -> None:
        """Add the plan of a group after a number of earlier products and steps, and what its tasks wait for in those.

        As within a group, the pick of a part waits for it to be there, a conveyor for room on it, and what is done
        at the place of a product for those to be gone that left last.
        """
        line, m = self._units.units[unit], len(self._planned)
        buffers, products = self._line.supply.buffers, []
        tools = changed_tools(self._plans[unit].tasks)
        for task in self._plans[unit].tasks:
            here = m, task.index
            through = before + task.step
            self._tasks.append(replace(task, index=len(self._tasks), step=through))
            self._places.append(here)
            number = earlier + line.origins[task.step - 1][0]
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
    """Return the units of a line that is written out for all products.

    Args:
        section: of the assembly, as JSON; passed its checks.
    """
    return _Units(PartsSection.model_validate_json(section)).found()


class _Units:
    """Follows the parts of a line from group to group."""

    def __init__(self, section: PartsSection) -> None:
        assert section.products is not None
        self._section, self._line = section, write_out_line(section)
        self._sequence = section.products.sequence(self._line.products)
        self._alone: dict[object, Line] = {}
        self._parts = {part.name: part for part in self._line.section.parts}
        # Parts at rest, by name.
        later = self._line.later
        self._rests = {k: x for k, x in self._parts.items() if k not in later}

    def found(self) -> LineUnits:
        units: dict[object, Line] = {}
        order, every = [], []
        for (before, done), (last, step) in pairwise([(0, 0), *self._line.pauses]):
            products, steps = range(before + 1, last + 1), range(done + 1, step + 1)
            variants = self._sequence[before:last]
            alone = variants, tuple(self._batches(steps))
            if alone not in self._alone:
                self._alone[alone] = write_out_line(_of_first(self._section, *alone))
            unit, names = self._unit(self._alone[alone], products, steps)
            supply = unit.supply
            refilled = [
                (k, [x for x, _ in own.parts]) for k, own in supply.refills.items()
            ]
            left = [(k, len(own.parts)) for k, own in supply.leaves.items()]
            key = unit.section.model_dump_json(), str((refilled, left)), unit.later
            units.setdefault(key, unit)
            order.append(list(units).index(key))
            every.append(names)
            self._make(steps)
        return LineUnits(self._line, tuple(units.values()), tuple(order), tuple(every))

    def _batches(self, steps: range) -> Iterator[tuple[str, tuple[int, ...]]]:
        """Yield machines for which there are sizes of batches, each with those of its batches among some steps."""
        for name, machine in self._section.machines.items():
            if machine.batches:
                runs = [k for k, job in self._line.jobs.items() if job.machine == name]
                first, last = bisect_left(runs, steps[0]), bisect_right(runs, steps[-1])
                yield name, machine.batches[first:last]

    def _unit(
        self, alone: Line, products: range, steps: range
    ) -> tuple[Line, Mapping[str, str]]:
        """Return a group in its surroundings, and the names of the objects there by those in the unit."""
        supply, numbers = self._line.supply, self._line.numbers
        earlier, before = products[0] - 1, steps[0] - 1
        coming = [
            name
            for k in steps
            if k in supply.refills
            for name, _ in supply.refills[k].parts
        ]
        there = {**self._rests, **{name: self._parts[name] for name in coming}}
        local: dict[str, str] = {}
        others = [
            name
            for name in there
            if name in numbers and numbers[name][1] not in products
        ]
        others.sort(key=lambda name: (name in coming, f"{there[name].start}"))
        for k, name in enumerate(others, start=1):
            local[name] = product_part_name(_OTHER, k)
        for name in there.keys() - local.keys():
            part, product = numbers.get(name, (name, 0))
            local[name] = (
                product_part_name(part, product - earlier) if product else name
            )
        parts = [
            part.changed(name=local[name], **({"goal": None} if name in others else {}))
            for name, part in sorted(there.items(), key=lambda item: local[item[0]])
        ]

        def placed(own: Sequence[PlacedPart]) -> tuple[PlacedPart, ...]:
            return tuple((local[name], pose) for name, pose in own)

        # Places in grids are those that the line has come to.
        there_too = self._line.section.steps[before : steps[-1]]
        own_steps = tuple(
            own.changed(at=own.at.changed(pose=same.at.pose))
            if own.at and same.at
            else own
            for own, same in zip(alone.section.steps, there_too, strict=True)
        )
        unit = replace(
            alone,
            section=alone.section.changed(parts=tuple(parts), steps=own_steps),
            supply=replace(
                alone.supply,
                refills={
                    k - before: replace(own, parts=placed(own.parts))
                    for k, own in supply.refills.items()
                    if k in steps
                },
                leaves={
                    k - before: Leaving(own.machine, placed(own.parts))
                    for k, own in supply.leaves.items()
                    if k in steps
                },
                sourced=frozenset(
                    local[name] for name in there.keys() & supply.sourced
                ),
            ),
            later=frozenset(local[name] for name in coming),
            products=self._line.products,
            numbers={
                **alone.numbers,
                **{local[name]: (_OTHER, 0) for name in others},
            },
        )
        names = {own: name for name, own in local.items()}
        for job in alone.jobs.values():
            if job.door and job.part:
                names[job.door] = product_part_name(job.part, earlier + job.product)
        return unit, names

    def _make(self, steps: range) -> None:
        """Let the parts of a group come, be put in their places, and leave."""
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


def _of_first(
    section: PartsSection,
    variants: tuple[str, ...],
    batches: Sequence[tuple[str, tuple[int, ...]]] = (),
) -> PartsSection:
    """Return the section of a line of which only a number of products are made, by their variants, in some batches."""
    products = section.products
    assert products is not None
    own = ProductsSection(
        count=len(variants),
        variants=dict.fromkeys(products.variants, VariantSection()),
        order=variants,
        places=products.places,
        in_progress=products.in_progress,
        leave_by=products.leave_by,
    )
    return with_batches(section.changed(products=own), dict(batches))


@lru_cache(maxsize=8)
def distinct_products(section: str) -> Line:
    """Return the first products of a line, among which is every one that differs from the others.

    Products do if they are of different variants, or their parts have other starts, goals or places in grids.

    Args:
        section: see ``line_units``.
    """
    whole = PartsSection.model_validate_json(section)
    line, content = write_out_line(whole), defaultdict[int, str](str)
    for part in line.section.parts:
        name, product = line.numbers.get(part.name, ("", 0))
        content[product] += f"{name} {part.start} {part.goal};"
    for step, (product, index) in zip(line.section.steps, line.origins, strict=True):
        content[product] += f"{index} {step.at and step.at.pose};"
    first = {content[k]: k for k in range(line.products, 0, -1)}
    last = next(done for done, _ in line.pauses if done >= max(first.values()))
    assert whole.products is not None
    return write_out_line(_of_first(whole, whole.products.sequence(last)))

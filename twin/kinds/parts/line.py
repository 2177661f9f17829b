"""Expansion of a scenario with several products: the parts, steps, machine jobs and supplies of each product."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from itertools import accumulate, takewhile
from typing import TypeVar

import numpy as np

from planning.parts.assembly import TimeLag
from planning.parts.supply import Leaving, Supply
from planning.tasks.refill import PlacedPart, Refill
from planning.tasks.task import TaskKind
from planning.transforms import Transform, read_only_copy
from scheduling.sequences.copies import product_part_name
from twin.durations.bounded import Fixed
from twin.durations.composed import AnyDuration, SkillOverride
from twin.kinds.parts.alike import AlikeParts, alike_parts, with_named_parts
from twin.kinds.parts.batch_starts import with_start_windows
from twin.kinds.parts.batches import (
    batch_names,
    batch_sizes,
    batch_unit,
    first_batches,
    merged_batches,
    order_in_batches,
)
from twin.kinds.parts.between import FitSection
from twin.kinds.parts.changeovers import find_changeovers
from twin.kinds.parts.ordered_places import pallet_places, source_places
from twin.kinds.parts.section import PartSection, PartsSection, StepSection
from twin.kinds.parts.sources import ConveyorSection, SourceSection
from twin.kinds.statics import JoinedSection
from twin.scenario.sections.shapes import PoseSection

Pair = TypeVar("Pair", JoinedSection, FitSection)

OUTFEED = "outfeed"
"""Name of the machine that takes products away where the file names none."""


@dataclass(frozen=True)
class MachineJob:
    """A step without a robot.

    Attributes:
        machine: its machine; an unattended step has its own chain.
        door: name of the object that is its door for as long as it works, None for none.
        part: what this door is called in every product, None for none.
        product: for which product it works, from 1; of a batch, the last one.
        parts: all parts of a batch, empty for one part.
    """

    machine: str
    door: str | None = None
    part: str | None = None
    product: int = 1
    parts: tuple[str, ...] = ()


def machine_jobs(
    section: PartsSection,
    products: Sequence[int],
    batches: Mapping[int, tuple[str, ...]],
) -> Mapping[int, MachineJob]:
    """Return the jobs of steps without robots, by step number from 1.

    Args:
        section: with the steps of all products that are written out.
        products: the product of each step, from 1.
        batches: the parts of batches, by step number.
    """
    uses = Counter(step.process for step in section.steps if step.process)
    found: dict[int, MachineJob] = {}
    counted: Counter[tuple[str, int]] = Counter()
    steps = zip(section.steps, products, strict=True)
    for number, (step, product) in enumerate(steps, start=1):
        name = step.process or ""
        process = section.processes.get(name)
        if process is None or not process.without_robot:
            continue
        machine, door, part = process.machine, None, None
        if machine is None:
            counted[name, 0] += 1
            machine = (
                name if uses[name] == 1 else product_part_name(name, counted[name, 0])
            )
        elif machine in section.machines and section.machines[machine].door:
            counted[machine, product] += 1
            turn = counted[machine, product]
            part = f"{machine}.door{turn if turn > 1 else ''}"
            door = (
                part if section.products is None else product_part_name(part, product)
            )
        parts = batches.get(number, ())
        found[number] = MachineJob(machine, door, part, product, parts)
    return found


@dataclass(frozen=True)
class Line:
    """An expanded line: as many products as its period takes.

    Attributes:
        section: parts and steps of these products, every part at the place of its source.
        supply: arriving and leaving objects.
        later: parts that are not there at the start.
        products: how many there are to be.
        period: how many are written out.
        origins: of each step its product, from 1, and its index among the steps of the section that was expanded,
            from 0; of a batch, those of its last part.
        numbers: part and product by name of a numbered part.
        jobs: jobs of steps without robots, by step number from 1.
        changeover_times: durations of the changeovers.
        alike: parts that are alike, kind by kind; of products by their names without numbers.
        places: what the place of each part in a tray or a stack is called.
        pauses: after how many products and steps, from 1, all that are begun are complete.
    """

    section: PartsSection
    supply: Supply = field(default_factory=Supply)
    later: frozenset[str] = frozenset()
    products: int = 1
    period: int = 1
    origins: tuple[tuple[int, int], ...] = ()
    numbers: Mapping[str, tuple[str, int]] = field(default_factory=dict)
    jobs: Mapping[int, MachineJob] = field(default_factory=dict)
    changeover_times: tuple[SkillOverride, ...] = ()
    alike: tuple[AlikeParts, ...] = ()
    places: Mapping[str, str] = field(default_factory=dict)
    pauses: tuple[tuple[int, int], ...] = ()

    @cached_property
    def lags(self) -> Mapping[int, tuple[TimeLag, ...]]:
        """Minimum time lags of steps after others, by step number from 1."""
        found: dict[int, tuple[TimeLag, ...]] = {}
        taken: Counter[str] = Counter()
        for number, step in enumerate(self.section.steps, start=1):
            own: list[TimeLag] = []
            for x in step.follows:
                machine = None
                if x.at_least_s > 0.0:
                    machine = f"{x.step[:40]}.lag"
                    taken[machine] += 1
                    machine += str(taken[machine]) if taken[machine] > 1 else ""
                if machine is not None or x.within_s is not None:
                    own.append(TimeLag(x.step, x.at_least_s, x.within_s, machine))
            if own:
                found[number] = tuple(own)
        return found

    def machines(self) -> tuple[str, ...]:
        """Return the machines with jobs."""
        refills = list(self.supply.refills.values())
        names = [item.arrivals for item in refills] + [item.machine for item in refills]
        names += [item.machine for item in self.supply.leaves.values()]
        names += [item.machine for item in self.jobs.values()]
        names += [item.machine for item in self.supply.changeovers]
        names += [lag.machine for own in self.lags.values() for lag in own]
        return tuple(dict.fromkeys(name for name in names if name is not None))


def write_out_line(section: PartsSection, *, whole: bool = False) -> Line:
    """Return the line of an assembly.

    Args:
        section: passed its checks.
        whole: write out all products, however many they are.
    """
    named = with_named_parts(section)
    if _has_line(named):
        line = _written_out(named.model_dump_json(), whole)
    else:
        origins = tuple((1, k) for k in range(len(named.steps)))
        jobs = machine_jobs(named, [1] * len(origins), {})
        line = Line(named, origins=origins, jobs=jobs)
    return line if named is section else replace(line, alike=alike_parts(section))


@lru_cache(maxsize=8)
def _written_out(text: str, whole: bool) -> Line:
    return _Writer(PartsSection.model_validate_json(text), whole).line()


def _has_line(section: PartsSection) -> bool:
    return bool(section.sources or section.products or batch_sizes(section))


def machine_durations(section: PartsSection) -> tuple[SkillOverride, ...]:
    """Return the durations of machine tasks."""
    found: list[tuple[str, str, str | None, AnyDuration]] = []
    for name, source in section.sources.items():
        machine = feeding_machine(name, source)
        if isinstance(source, ConveyorSection):
            found.append(("arrive", name, None, source.interval))
            found.append(("present", machine, None, source.advance))
            continue
        # Who serves several sources takes a time of its own for each of them.
        kinds = [p.shape_words for p in section.parts if name in p.sources]
        of = kinds if source.refill_by else [None]
        found += [("present", machine, kind, source.refill_time) for kind in of]
    if section.products is not None:
        machine = section.products.leave_by or OUTFEED
        found.append(("leave", machine, None, section.products.leave_time))
    line = write_out_line(section, whole=bool(section.changeovers))
    for own in line.lags.values():
        for lag in own:
            if lag.machine is not None:
                least = Fixed(value_s=lag.least)
                found.append((TaskKind.LAG, lag.machine, None, least))
    overrides = (
        SkillOverride(skill=skill, robot=machine, object=kind, duration=duration)
        for skill, machine, kind, duration in found
    )
    return (*overrides, *line.changeover_times)


def feeding_machine(name: str, source: SourceSection) -> str:
    """Return the machine that delivers the next part."""
    if isinstance(source, ConveyorSection):
        return f"{name}.end"
    return source.refill_by or name


class _Writer:
    """Expands one line."""

    def __init__(self, section: PartsSection, whole: bool) -> None:
        self.section = section
        self.parts = {part.name: part for part in section.parts}
        products = section.products
        self.products = 1 if products is None else products.count
        if whole and products is not None:
            self.products += products.spare
        self.sequence = products.sequence(self.products) if products else ()
        self.serial = bool(whole and products and products.rush_after is not None)
        if self.serial and products:
            self.products += len(products.rushed)
            known = products.sequence(self.products)
            made = dict.fromkeys((*products.made, *range(1, self.products + 1)))
            self.sequence = tuple(known[k - 1] for k in made if known)
        self.own = {
            variant: with_start_windows(section.of_variant(variant))
            for variant in {*self.sequence, ""}
        }
        self.counts = {name: [0] for name in section.taken}
        # Of several sources that the same parts come from, the places are those of the first one.
        first: dict[str, str] = {}
        for name in section.taken:
            for source in self.parts[name].sources[:1]:
                first.setdefault(source, name)
        self.lying = {
            source: source_places(section, self.parts[first[source]])
            for source in section.sources
            if source in first
        }
        self.places = pallet_places(section).poses
        every = whole or bool(self.sequence)
        self.period = self.products if every else self._period()
        own = [self._of(k).steps for k in range(1, self.period + 1)]
        self.order = [
            [(k + 1, n) for k, n in group]
            for group in order_in_batches(
                own, batch_sizes(section), first_batches(section)
            )
        ]
        self.number = {k: n for n, group in enumerate(self.order, 1) for k in group}
        self.ends = [self.number[k, len(n) - 1] for k, n in enumerate(own, 1)]

    def _variant(self, product: int) -> str:
        """Return the variant of a product; what comes beyond the last one is as at the beginning."""
        known = self.sequence
        return known[(product - 1) % len(known)] if known else ""

    def _of(self, product: int) -> PartsSection:
        """Return the section with the steps of a product."""
        return self.own[self._variant(product)]

    def _names(self, source: str, product: int) -> list[str]:
        """Return the parts of a product that come from a source, in the order in which they are taken."""
        taken = self._of(product).taken
        return [name for name in taken if self.parts[name].sources[:1] == (source,)]

    def line(self) -> Line:
        handled = set(self.section.placed)
        parts = [part for part in self.section.parts if part.name not in handled]
        later: set[str] = set()
        refills: dict[int, Refill] = {}
        numbers: dict[str, tuple[str, int]] = {}
        sourced: dict[str, str] = {}
        for source, places in self.lying.items():
            size, taken = len(places.poses), self._taken(source)
            placed: list[PlacedPart] = []
            for q, (part, product) in enumerate(taken):
                name, place = self._name(part, product), places.poses[q % size]
                parts.append(self._part(part, product, place))
                placed.append((name, place))
                if self.section.products is not None or product > 1:
                    numbers[name] = part, product
                sourced[name] = places.words[q % size]
                if q >= size:
                    later.add(name)
            for q in range(size, len(placed)):
                if q % size in places.begins:
                    filled, own = places.begins[q % size]
                    emptied = self._taken_in(*taken[q - size + own - 1])
                    refills[emptied] = self._refill(filled, placed[q : q + own])
        for name in self.section.placed:
            if self.parts[name].source is None:
                parts.append(self._part(name, 1, None))
        steps, batches = self._steps()
        origins = tuple(
            (product, self.section.steps_of(self._variant(product))[k])
            for *_, (product, k) in self.order
        )
        section = self.section.model_copy(
            update={
                "parts": tuple(parts),
                "steps": steps,
                "joined": tuple(self._joined()),
                "fits": tuple(
                    fit for fit, _ in self._of_products(lambda own: own.fits)
                ),
            }
        )
        bound = section.products.in_progress if section.products else None
        made_for = [product for product, _ in origins]
        jobs = machine_jobs(section, made_for, batches)
        if section.products is not None:
            for job in jobs.values():
                if job.door is not None and job.part is not None:
                    numbers[job.door] = job.part, job.product
        about = self.section, self.own, self.sequence, self.ends
        changeovers = list(find_changeovers(*about))
        return Line(
            section,
            Supply(
                refills,
                dict(self._leaves()),
                _elsewhere(steps),
                frozenset(sourced),
                bound,
                tuple(made_for) if bound else (),
                tuple(item for item, _ in changeovers),
            ),
            frozenset(later),
            self.products,
            self.period,
            origins,
            numbers,
            jobs,
            tuple(
                SkillOverride(
                    skill=TaskKind.CHANGEOVER,
                    robot=item.machine,
                    object=item.part,
                    duration=duration,
                )
                for item, duration in changeovers
            ),
            places=sourced,
            pauses=tuple(self._pauses()),
        )

    def _pauses(self) -> Iterator[tuple[int, int]]:
        """Yield how many products and steps are complete when no product is begun and not complete."""
        begun, ends = 0, Counter(self.ends)
        complete = accumulate(ends[k] for k in range(1, len(self.order) + 1))
        for step, done in enumerate(complete, start=1):
            begun = max(begun, *(product for product, _ in self.order[step - 1]))
            if begun == done:
                yield done, step

    def _period(self) -> int:
        """Return the period: number of products after which all sources are full and places and machines empty.

        It is all of them where batches are not of one size.
        """
        shares = [
            (len(own.poses), len(self._names(k, 1))) for k, own in self.lying.items()
        ]
        grids = (step.at.grid for step in self.section.steps if step.at)
        shares += [(grid.size, 1) for grid in grids if grid]
        batches = batch_unit(self.section)
        if self.products % batches or first_batches(self.section):
            return self.products
        periods = (n // math.gcd(n, own) for n, own in shares if own)
        period = math.lcm(len(self.places), batches, *periods)
        return min(period, self.products)

    def _name(self, part: str, product: int) -> str:
        numbered = self.section.products is not None or product > 1
        if not numbered or part not in self.section.placed:
            return part
        # Then no order of products changes the names of the parts of a source.
        number = self._serial(part, product) if self.serial else product
        return product_part_name(part, number)

    def _serial(self, part: str, product: int) -> int:
        """Return the number of first products, up to one, that have a part."""
        counts = self.counts[part]
        for k in range(len(counts), product + 1):
            counts.append(counts[-1] + (part in self._of(k).taken))
        return counts[product]

    def _taken(self, source: str) -> list[tuple[str, int]]:
        """Return the parts that are taken from a source, each with its product, in their order.

        They are those of the products that are written out, and those that fill the source at their end, and
        those below which others lie.
        """
        places, size = self.lying[source], len(self.lying[source].poses)
        picked = (
            (self._of(product).steps[k].place or "", product)
            for group in self.order
            for product, k in group
        )
        own = [
            (name, product)
            for name, product in dict.fromkeys(picked)
            if name in self._names(source, product)
        ]
        found = list(own)
        for shift in range(self.period, self.products, self.period):
            if len(found) >= len(own) + size:
                break
            later = ((name, product + shift) for name, product in own)
            found += [one for one in later if one[1] <= self.products]
        most, more = min(len(own) + size, places.brought(len(found))), self.products
        while found and len(found) < most:
            more += 1
            found += [(name, more) for name in self._names(source, more)]
        return found[:most]

    def _taken_in(self, part: str, product: int) -> int:
        """Return the step that takes a part of a source, from 1."""
        steps = self._of(product).steps
        return self.number[product, [step.place for step in steps].index(part)]

    def _part(self, name: str, product: int, slot: Transform | None) -> PartSection:
        part = self.parts[name]
        update: dict[str, object] = {"name": self._name(name, product)}
        if slot is not None:
            update |= {"source": None, "start": PoseSection.of(slot)}
        if product > self.products:
            update["goal"] = None
        elif part.goal is not None:
            goal = part.goal.transform()
            place = self.places[(product - 1) % len(self.places)]
            update["goal"] = (
                PoseSection.of(place @ goal) if len(self.places) > 1 else part.goal
            )
        return part.model_copy(update=update)

    def _refill(self, source: str, parts: Sequence[PlacedPart]) -> Refill:
        """Return the refill of a source with parts."""
        section = self.section.sources[source]
        machine = feeding_machine(source, section)
        if isinstance(section, ConveyorSection):
            return Refill(machine, tuple(parts), source, section.buffer)
        return Refill(machine, tuple(parts))

    def _leaves(self) -> Iterator[tuple[int, Leaving]]:
        """Yield leaving objects with their steps."""
        together = len(self.places)
        if self.section.products is None or together > self.products:
            return
        machine = self.section.products.leave_by or OUTFEED
        for last in range(together, self.period + 1, together):
            products = range(last - together + 1, last + 1)
            parts = tuple(
                (self._name(name, product), self._goal(name, product))
                for product in products
                for name in self._of(product).placed
            )
            done = max(self.ends[k - 1] for k in products)
            yield done, Leaving(machine, parts)

    def _goal(self, name: str, product: int) -> Transform:
        goal = self._part(name, product, None).goal
        assert goal is not None
        return read_only_copy(goal.transform())

    def _joined(self) -> Iterator[JoinedSection]:
        """Yield the joints of all products, with their names."""
        for joint, product in self._of_products(lambda own: own.joined):
            by = joint.by
            if by is not None and self.section.products is not None:
                by = product_part_name(by, product)
            yield joint.model_copy(update={"by": self.renamed.get(by, by)})

    def _of_products(
        self, pairs: Callable[[PartsSection], Sequence[Pair]]
    ) -> Iterator[tuple[Pair, int]]:
        """Yield pairs with names expanded for each product and its number; others once."""
        for product in range(1, self.period + 1):
            for item in pairs(self._of(product)):
                parts = tuple(self._name(name, product) for name in item.parts)
                if parts != item.parts or product == 1:
                    yield item.model_copy(update={"parts": parts}), product

    def _steps(self) -> tuple[tuple[StepSection, ...], dict[int, tuple[str, ...]]]:
        """Return the steps of all products in their order, and the parts of batches, by step number."""
        groups = [
            [self._step(self._of(product).steps[k], product) for product, k in group]
            for group in self.order
        ]
        batches = {
            number: tuple(step.at.part for step in own if step.at and step.at.part)
            for number, own in enumerate(groups, start=1)
            if len(own) > 1
        }
        self.renamed = batch_names(groups)
        return merged_batches(groups, self.renamed), batches

    def _step(self, step: StepSection, product: int) -> StepSection:
        """Return a step for a product, with that product's names."""
        if self.section.products is None:
            return step
        update: dict[str, object] = {
            "after": tuple(
                x.model_copy(update={"step": product_part_name(x.step, product)})
                for x in step.follows
            )
        }
        for key in ("place", "hold", "name", "until"):
            if (name := getattr(step, key)) is not None:
                own = key in ("name", "until")
                update[key] = (
                    product_part_name(name, product)
                    if own
                    else self._name(name, product)
                )
        if step.at is not None and step.at.part is not None:
            part = self._name(step.at.part, product)
            update["at"] = step.at.model_copy(update={"part": part})
        if step.at is not None and (grid := step.at.grid) is not None:
            pose = np.eye(4) if step.at.pose is None else step.at.pose.transform()
            turn = self._turn(step, product) % grid.size
            place = PoseSection.of(pose @ grid.places()[turn])
            update["at"] = step.at.model_copy(update={"pose": place, "grid": None})
        return step.model_copy(update=update)

    def _turn(self, step: StepSection, product: int) -> int:
        """Return how often something is put down at the grid of a step before, whatever part that is."""
        uses = {
            variant: sum(other.at == step.at for other in own.steps)
            for variant, own in self.own.items()
        }
        earlier = takewhile(lambda own: own is not step, self._of(product).steps)
        before = self.sequence[: product - 1] or [""] * (product - 1)
        return sum(own.at == step.at for own in earlier) + sum(uses[k] for k in before)


def _elsewhere(steps: Sequence[StepSection]) -> frozenset[int]:
    """Return the numbers of the steps at intermediate places."""
    on_the_way: set[str] = set()
    found = set()
    for number, step in enumerate(steps, start=1):
        if step.place is not None and step.at is None:
            on_the_way.discard(step.place)
        elif step.place is not None:
            on_the_way.add(step.place)
        if (step.place or (step.at and step.at.part)) in on_the_way:
            found.add(number)
    return frozenset(found)

"""Assembly kind ``assembly`` (an assembly of parts): builds its planning data from its section."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING

from planning.cell.workcell import CONTACT_DEPTH, CellObject, PlacedRobot, Workcell
from planning.errors import RequestError
from planning.tasks.task import DOOR, Actuation, ActuationKey
from planning.transforms import read_only_copy
from twin.document.validation import Problems
from twin.document.yaml_text import KeyPath
from twin.durations.composed import AnyDuration, SkillOverride
from twin.durations.model import DurationModel
from twin.host.progress import StageWatch
from twin.kinds.parts.alike import (
    alike_parts,
    listed_steps,
    with_named_parts,
)
from twin.kinds.parts.batch_starts import (
    closed_batches,
    waits_in_batches,
    with_batches,
)
from twin.kinds.parts.batches import batch_sizes, first_batches, order_in_batches
from twin.kinds.parts.line import Line, machine_durations, write_out_line
from twin.kinds.parts.problems import (
    disturbed_machines,
    find_part_problems,
    machine_names,
)
from twin.kinds.parts.rejects import find_reject_problems
from twin.kinds.parts.section import PartSection, PartsSection
from twin.planning.shapes import build_shape
from twin.scenario.sections.cell import CellSection, RobotSection, actuation_model
from twin.scenario.sections.execution import ExecutionSection
from twin.scenario.sections.kind import (
    ASSIGNMENT,
    NO_WINDOW,
    AssemblyKind,
    AssemblySection,
    IdleReason,
    StartUp,
)
from twin.scenario.sections.shapes import to_planning_class

if TYPE_CHECKING:
    from planning.parts.work import PartWork
    from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
    from scheduling.planned_motions import PlannedMotions
    from twin.kinds.parts.units import LineUnits


_GREY_BLUE = (196, 214, 226)

_ROUNDING = 0.001
"""Rounding tolerance of the depth of joined parts [m]."""

_TOGETHER = 2
"""Most groups of products that are planned together, see ``PartKind._line_units``."""

ORDERS = "orders tried"
"""Name of the stage for progress displays."""


@dataclass(frozen=True)
class PartKind(AssemblyKind):
    """An assembly of parts of a scenario.

    Attributes:
        section: the scenario section.
        whole: whether all products are written out, and not those of a pattern only.
        unit: the one product that is planned, of several variants; None for all of the line.
    """

    section_class = PartsSection
    chooses_robots = True
    changes_tools = True

    section: PartsSection
    whole: bool = False
    unit: Line | None = None

    @property
    def line(self) -> Line:
        """The products that are planned."""
        return self.unit or write_out_line(self.section, whole=self.whole)

    def written_out(self) -> PartKind:
        """Return the same with every product planned by itself."""
        return replace(self, whole=True)

    def steps(self) -> int:
        """Return the number of steps, of one product or of all."""
        if self.unit is not None:
            return len(self.unit.section.steps)
        ends = self.product_ends(range(1, self.products() + 1))
        return ends[-1] if self.whole or self.variants() else ends[0]

    def wanted_steps(self) -> int:
        """Return the number of steps without those of spare products."""
        products = self.section.products
        if products is None or not self.whole:
            return self.steps()
        wanted = len(self.made) - products.spare if self.made else products.count
        return self.product_ends()[min(wanted, len(self.product_ends())) - 1]

    def product_ends(self, made: Sequence[int] = ()) -> Sequence[int]:
        """Return the number of the last step of each product; of all together where batches interleave them."""
        if self._order:
            return (len(self._order),)
        made = made or self.made or range(1, self.products() + 1)
        variants = self.variants()
        steps = {k: self.section.steps_of(k) for k in variants}
        if steps:
            return list(accumulate(len(steps[variants[k - 1]]) for k in made))
        count = len(listed_steps(self.section))
        return range(count, count * len(made) + 1, count)

    def product_of(self, step: int) -> int:
        """Return the product of a step of all products, both from 1; of a batch, that of its last part."""
        order, number = self._order, super().product_of(step)
        if order:
            return order[step - 1][-1][0] + 1
        return self.made[number - 1] if self.made else number

    @cached_property
    def made(self) -> Sequence[int]:
        """Numbers of the products in the order in which they are made, where rush orders may come in."""
        products = self.section.products
        come = self.whole and products and products.rush_after is not None
        return products.made if products and come else ()

    def rush_s(self) -> tuple[float, ...]:
        """Return when the products of rush orders come in [s]."""
        products = self.section.products
        return tuple(own.at_s for own in products.rushed) if products else ()

    def with_rush(self, after: tuple[int, ...]) -> PartKind:
        """Return the same with first products of rush orders, given how many products come before each of them."""
        products = self.section.products
        own = products and products.changed(rush_after=after)
        return replace(self, section=self.section.changed(products=own))

    @cached_property
    def _order(self) -> Sequence[Sequence[tuple[int, int]]]:
        """Products and their steps, from 0, in the order in which they are done; empty without batches."""
        if not (sizes := batch_sizes(self.section)):
            return ()
        section, variants = self.section, self.variants() or [""] * self.products()
        steps, own = (
            listed_steps(section),
            {k: section.steps_of(k) for k in {*variants}},
        )
        listed = {k: [section.steps[n] for n in steps if n in own[k]] for k in own}
        given = first_batches(section)
        return order_in_batches([listed[k] for k in variants], sizes, given)

    def revised_section(self, plan: TemporalPlanGraph) -> PartsSection | None:
        """Return the section with the first batch closed that takes parts in for too long; None where none does."""
        for name, batches in waits_in_batches(self.section, plan).items():
            longest = self.section.machines[name].start_after_s or 0.0
            if sizes := closed_batches(batches, longest):
                return with_batches(self.section, {name: sizes})
        return None

    def as_planned(self, planned: Callable[[], AssemblySection]) -> PartsSection | None:
        """Return the section with the batches of the one that was planned; None without ``start_after_s``."""
        if not any(own.start_after_s for own in self.section.machines.values()):
            return None
        other = planned()
        found = other.machines if isinstance(other, PartsSection) else {}
        return with_batches(self.section, {k: own.batches for k, own in found.items()})

    def variants(self) -> tuple[str, ...]:
        """Return the variant of each product, spare ones included if expanded; empty without variants."""
        products = self.section.products
        return () if products is None else products.sequence(self.products())

    def products(self) -> int:
        """Return the number of products, spare ones included if expanded."""
        products = self.section.products
        if products is None:
            return 1
        rush = 0 if products.rush_after is None else len(products.rushed)
        return products.count + rush + (products.spare if self.whole else 0)

    def supply(self) -> str:
        """Return a description of the supply."""
        return f"{len(with_named_parts(self.section).parts)} parts"

    def names(self) -> Iterator[tuple[KeyPath, str]]:
        """Yield the names of the parts, each with its key."""
        for i, part in enumerate(self.section.parts):
            yield ("assembly", "parts", i, "name"), part.name
        where = {part.name: i for i, part in enumerate(self.section.parts)}
        for own in alike_parts(self.section):
            for name in own.names:
                yield ("assembly", "parts", where[own.kind], "name"), name
        yield from machine_names(self.section)

    def part_names(self) -> Iterable[str]:
        """Return the names of the parts as the file gives them."""
        return [part.name for part in self.section.parts]

    def working_machines(self) -> Iterable[str]:
        """Return the names of the machines."""
        return self.section.machines

    def disturbed_machines(self) -> Iterable[str]:
        """Return the names of the machines that may be disturbed, without unattended processes."""
        return disturbed_machines(self.section)

    def has_given_starts(self) -> bool:
        """Return whether no part comes from a source or belongs to one of several products."""
        return not (self.section.sources or self.section.products)

    def miss_probabilities(
        self, cell: Workcell, robots: Sequence[RobotSection]
    ) -> Mapping[str, float]:
        """Return the probability of missing a place, by ROBOT/PART, for robots with a repeatability."""
        from planning.handling.tool_changes import with_all_tools_mounted
        from twin.kinds.parts.fits import miss_probabilities
        from twin.kinds.parts.ordered_parts import OrderedParts

        return miss_probabilities(
            OrderedParts(with_all_tools_mounted(cell), self.section, self.line), robots
        )

    def default_durations(self) -> Mapping[str, AnyDuration]:
        """Return nothing: skills last as long as motions and tool actuations."""
        return {}

    def processes(self) -> Mapping[str, AnyDuration | None]:
        """Return the duration of each process."""
        processes = self.section.processes
        return {name: process.duration for name, process in processes.items()}

    def actuations(self, cell: CellSection) -> Mapping[ActuationKey, DurationModel]:
        """Return actuation times of tools: their own, else the section's."""
        found: dict[ActuationKey, DurationModel] = {}
        rules = self.section.grips
        for robot in (outfit for one in cell.robots for outfit in one.outfits):
            tool = cell.tools.get(robot.tool or "")
            specified = tool is not None and (
                tool.suction or tool.opening_m is not None
            )
            suction = tool.suction if tool is not None and specified else rules.suction
            for act, key in ((Actuation.CLOSE, "close_s"), (Actuation.OPEN, "open_s")):
                said = None if tool is None else getattr(tool, key)
                given = getattr(rules, key) if said is None else said
                model = actuation_model(given, suction=suction)
                found[act, robot.name, robot.tool] = model
        return found

    def problems(self, cell: CellSection) -> Problems:
        """Yield the problems of the section, such as unknown or repeated names."""
        return find_part_problems(self.section, cell)

    def reject_problems(
        self, execution: ExecutionSection, cell: CellSection
    ) -> Problems:
        """Yield unknown steps of rework, and unknown fixtures and robots of the bin."""
        return find_reject_problems(self.section, execution, cell)

    def object_kinds(self) -> Iterable[str]:
        """Return the types of the parts, each once."""
        return dict.fromkeys(part.shape_words for part in self.section.parts)

    def objects(self, folder: Path = Path()) -> tuple[CellObject, ...]:
        """Return the parts at their start poses."""
        return _objects(self.line, folder)

    def machines(self) -> tuple[str, ...]:
        """Return the machines of sources, the processing machines, and product removal."""
        return self.line.machines()

    def machine_durations(self) -> tuple[SkillOverride, ...]:
        """Return the durations of machine tasks."""
        return machine_durations(self.section)

    def due(self) -> tuple[tuple[float, ...], StartUp]:
        """Return when each product is due [s], and how many at the beginning do not count."""
        products = self.section.products
        return ((), None) if products is None else (products.due_s(), products.start_up)

    def contact_depth(self) -> float:
        """Return the allowed contact depth: joined bars may meet in a node [m]."""
        from twin.kinds.parts.built import overlaps_of

        said = overlaps_of(self.section).said.values()
        return max([CONTACT_DEPTH, *(deep + _ROUNDING for deep in said)])

    def why_unable(self, robot: PlacedRobot, motions: PlannedMotions) -> IdleReason:
        """Return why: not allowed, without tool, or out of reach for every step."""
        from twin.kinds.parts.unable import why_unable

        return why_unable(robot, motions)

    def ahead(self, cell: Workcell, watch: StageWatch) -> PartWork:
        """Return all products, with candidates of those that are asked for; see ``AssemblyKind``.

        All are looked at beforehand where that is one search, so only for the sake of spare ones.
        """
        from planning.parts.work import lazy_part_work
        from twin.kinds.parts.built import assembly_of

        assembly, spare = assembly_of(self.line), self.steps() - self.wanted_steps()
        searched = self.section.order == "find" or bool(assembly.alike)
        if not spare and (searched or self.line.products == 1):
            raise RequestError(NO_WINDOW)
        if searched:
            work = self.assembly(cell, watch)
        else:
            with watch.stage("assignment", ASSIGNMENT):
                work = lazy_part_work(cell, assembly)
        return replace(work, product_ends=self.product_ends(), spare_steps=spare)

    def assembly(self, cell: Workcell, watch: StageWatch) -> PartWork:
        """Return the assembly with all candidates; the stage is assignment."""
        from planning.parts.alike import find_alike_candidates
        from planning.parts.candidates import find_candidates
        from planning.parts.order import find_ordered_candidates, order_steps_by_search
        from planning.parts.work import part_work
        from twin.kinds.parts.built import assembly_of

        assembly = assembly_of(self.line)
        with watch.stage("assignment", ASSIGNMENT):
            if self.section.order == "find":
                find = partial(find_ordered_candidates, progress=watch.reporter(ORDERS))
                found = find_alike_candidates(
                    cell, assembly, find, order_steps_by_search
                )
            else:
                found = find_alike_candidates(cell, assembly, find_candidates)
            return part_work(found)

    def units(self) -> tuple[PartKind, ...]:
        """Return the distinct products in their surroundings where there are several variants."""
        if (found := self._line_units()) is None:
            return (self,)
        return tuple(replace(self, unit=unit) for unit in found.units)

    def distinct(self) -> PartKind:
        """Return the first products of several variants, among which are all that differ."""
        from twin.kinds.parts.units import distinct_products

        if not self.variants():
            return self
        return replace(self, unit=distinct_products(self.section.model_dump_json()))

    def _line_units(self) -> LineUnits | None:
        """Return the units of products of several variants, None where products are planned together.

        Few groups of products that batches interleave are, as they overlap better.
        """
        from twin.kinds.parts.units import line_units

        if self.whole or not self.variants():
            return None
        found = line_units(self.section.model_dump_json())
        single = all(unit.period == 1 for unit in found.units)
        return found if single or len(found.order) > _TOGETHER else None

    def all_products(self, plans: Sequence[TemporalPlanGraph]) -> TemporalPlanGraph:
        """Return the plan of all products from those of the units, or from that of the first ones."""
        from scheduling.sequences.copies import copies_in_sequence
        from scheduling.sequences.splice import splice_plans
        from twin.kinds.parts.pattern import line_pattern

        if (units := self._line_units()) is not None:
            tpg, line = splice_plans(units.sequence(plans)), units.line
            # As they are in the cell of the scenario, with which a saved plan is compared.
            doors = (job.door for job in line.jobs.values() if job.door)
            names = (*(part.name for part in line.section.parts), *doors)
            place = {name: k for k, name in enumerate(names)}
            objects = sorted(
                tpg.cell.objects, key=lambda x: place.get(x.name, len(place))
            )
            return replace(tpg, cell=replace(tpg.cell, objects=tuple(objects)))
        (plan,) = plans
        pattern = line_pattern(self.line, plan.tasks)
        return splice_plans(copies_in_sequence(plan, pattern))


def _objects(line: Line, folder: Path) -> tuple[CellObject, ...]:
    parts = (_part(part, line, folder) for part in line.section.parts)
    return (*parts, *_doors(line, folder))


def _doors(line: Line, folder: Path) -> Iterator[CellObject]:
    """Yield the doors of machines, one for every time that one is shut."""
    for job in line.jobs.values():
        door = line.section.machines[job.machine].door if job.door else None
        if job.door is None or door is None:
            continue
        shape = build_shape(job.door, door.described, folder)
        pose = read_only_copy(door.pose.transform())
        yield CellObject(
            job.door, DOOR, shape, pose, fixed=True, colour=_GREY_BLUE, later=True
        )


def _part(part: PartSection, line: Line, folder: Path) -> CellObject:
    shape = build_shape(part.name, part.described, folder)
    if part.centre_of_mass_m is not None:
        shape = replace(shape, own_centre=read_only_copy(part.centre_of_mass_m))
    spare = [name for own in line.alike if own.goals for name in own.names]
    return to_planning_class(
        CellObject,
        part,
        kind=part.shape_words,
        shape=shape,
        mass=part.mass_kg or (part.density_kg_m3 or 0.0) * shape.volume,
        fixed=not {*line.section.placed, *line.numbers, *spare} & {part.name},
        later=part.name in line.later,
    )

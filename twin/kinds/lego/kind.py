"""Assembly kind ``lego``: converts its scenario section to planning data, and gives planned motions brick colours."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from planning.cell.workcell import CellObject, Fixture, Workcell
from planning.errors import InfeasibleStepError
from planning.lego.bricks.assembly import (
    BrickType,
    Cell,
    LegoAssembly,
    LegoStep,
    PlacedBrick,
    Plate,
    Press,
    StockBrick,
)
from planning.progress import Progress, no_progress
from twin.document.validation import Problems
from twin.document.yaml_text import KeyPath
from twin.host.progress import StageWatch
from twin.kinds.lego.section import (
    BrickStepSection,
    LegoSection,
    brick_cell,
    brick_types,
    support_place,
)
from twin.kinds.lego.structure import StructureSection, read_structure
from twin.scenario.sections.cell import CellSection
from twin.scenario.sections.execution import StepWindowSection
from twin.scenario.sections.kind import ASSIGNMENT, AssemblyKind
from twin.scenario.sections.shapes import Colour, to_planning_class

if TYPE_CHECKING:
    from planning.lego.insertion.rules import SequencingRules
    from planning.lego.sequencing.arms import ArmSequence
    from planning.lego.sequencing.sequencing import SequencedStructure
    from planning.lego.skills.expansion import LegoWork
    from scheduling.planned_motions import PlannedMotions

_STOCK_MARGIN = 3
"""Margin around the stock in studs without temporary bricks."""

_MOST_AT_ONCE = 100
"""Number of steps up to which ``twin operate`` plans all of them at once."""

_WINDOW = StepWindowSection(steps=8, least=3)
"""Rolling planning window of larger assemblies: small, as each revision plans all of its steps."""

SEQUENCE = "which brick when"
"""Name of a stage for progress displays."""


@dataclass(frozen=True)
class LegoKind(AssemblyKind):
    """A LEGO assembly of a scenario.

    Attributes:
        section: the scenario section.
    """

    section_class = LegoSection
    included: ClassVar = {"structure": StructureSection}
    default_speed_model = "l1"
    chooses_robots = True
    searches_assignment = True

    section: LegoSection

    def steps(self) -> int:
        """Return the number of bricks that are placed."""
        structure = build_structure(self.section)
        return len(self.section.steps if structure is None else structure)

    def step_window(self) -> StepWindowSection | None:
        """Return the rolling planning window of ``twin operate``; see ``AssemblyKind``."""
        return _WINDOW if self.steps() > _MOST_AT_ONCE else None

    def supply(self) -> str:
        """Return a description of the supply."""
        return f"{len(self.section.stock)} bricks in stock"

    def names(self) -> Iterator[tuple[KeyPath, str]]:
        """Yield the names of the stock, each with its key."""
        for i, item in enumerate(self.section.stock):
            yield ("assembly", "stock", i, "name"), item.name

    def object_kinds(self) -> Iterator[str]:
        """Yield the types of the bricks in stock."""
        yield from dict.fromkeys(item.brick for item in self.section.stock)

    def reserved(self, name: str) -> str | None:
        """Return whether a name is reserved for a plate, or for a brick that arrives later."""
        from planning.lego.bricks.brick_world import STORAGE, station_of

        stations = {item.name for item in self.section.stock if item.station}
        if name in {"plate", STORAGE}:
            return "a plate"
        return (
            None
            if station_of(name, stations) == name
            else "a brick of a feeding station"
        )

    def problems(self, _cell: CellSection) -> Problems:
        """Yield the problems of the section."""
        from twin.kinds.lego.problems import find_lego_problems

        return find_lego_problems(self.section)

    def included_problems(self) -> Problems:
        """Yield the problems of a structure, with keys in its file."""
        from twin.kinds.lego.problems import find_structure_problems

        types = brick_types(self.section)
        if all(item.brick in types for item in self.section.stock):
            yield from find_structure_problems(self.section)

    def object_named(
        self, name: str, known: Mapping[str, CellObject]
    ) -> CellObject | None:
        """Return a further brick of a feeding station, ``<station>.2`` and so on."""
        from planning.lego.bricks.brick_world import next_copy, station_of

        stations = {item.name for item in self.section.stock if item.station}
        source = station_of(name, stations)
        if source == name:
            return None
        return next_copy(known[source], source, int(name.rpartition(".")[2]))

    def fixtures(self) -> tuple[Fixture, ...]:
        """Return the plates."""
        from planning.lego.bricks.brick_world import STORAGE, plate_fixture

        assembly = build_lego(self.section)
        plates = [plate_fixture(assembly.plate)]
        if assembly.storage is not None:
            plates.append(plate_fixture(assembly.storage, STORAGE))
        return tuple(plates)

    def objects(self, folder: Path = Path()) -> tuple[CellObject, ...]:
        """Return the stock."""
        from planning.lego.bricks.brick_world import stock_objects

        return stock_objects(build_lego(self.section))

    def assembly(self, cell: Workcell, watch: StageWatch) -> LegoWork:
        """Return given steps, or the sequence of a given structure, with all candidates.

        Given steps are checked: the structure must stand, and bear every press. The stages are
        sequence (where there is a structure) and assignment.
        """
        from planning.lego.skills.candidates import find_candidates
        from planning.lego.skills.expansion import lego_work

        if self.section.structure is not None:
            return lego_work(buildable_sequence(self.section, cell, watch).candidates)
        with watch.stage("assignment", ASSIGNMENT):
            assembly = self._given(cell, self._rules(cell))
            return lego_work(find_candidates(cell, assembly))

    def ahead(self, cell: Workcell, watch: StageWatch) -> LegoWork:
        """Return the assembly in a stable order, with candidates found step by step on demand.

        The order of all steps is stable and has room for the tool. Candidates of a step are found when it is
        planned; the order is not changed if the arms cannot do a step.
        """
        from planning.lego.sequencing.step_reach import check_reach
        from planning.lego.skills.expansion import lazy_lego_work

        rules, robots = self._rules(cell), len(cell.robots)
        with watch.stage("sequence", SEQUENCE):
            if self.section.structure is None:
                assembly = self._given(cell, rules)
            else:
                assembly, _ = find_sequence(self.section, rules, robots=robots)
                check_reach(cell, assembly)
        return lazy_lego_work(cell, assembly)

    def finished(self, motions: PlannedMotions) -> PlannedMotions:
        """Return motions in which each brick has the colour given for its goal."""
        colours, plan = brick_colours(self.section), motions.motion_plan
        wanted = {
            task.object: colours.get(motions.assembly.steps[task.step - 1].cell)
            for task in plan.tasks
            if colours and task.kind in ("place-down", "place-up")
        }
        objects = tuple(
            replace(item, colour=wanted.get(item.name) or item.colour)
            for item in plan.cell.objects
        )
        coloured = replace(plan, cell=replace(plan.cell, objects=objects))
        return replace(motions, motion_plan=coloured) if colours else motions

    def _rules(self, cell: Workcell) -> SequencingRules:
        robots, carrier = len(cell.robots), tool_carrier(cell)
        return sequencing_rules(self.section, robots=robots, carrier=carrier)

    def _given(self, cell: Workcell, rules: SequencingRules) -> LegoAssembly:
        """Return the assembly of the listed steps, checked by the rules."""
        from planning.lego.sequencing.stable_steps import stable_steps
        from planning.lego.sequencing.step_reach import check_reach

        assembly = build_lego(self.section)
        if self.section.rules.check_steps:
            assembly = stable_steps(assembly, rules)
        check_reach(cell, assembly)
        return assembly


def buildable_sequence(
    section: LegoSection, cell: Workcell, watch: StageWatch
) -> ArmSequence:
    """Return a sequence of an assembly that is feasible for the arms of a cell.

    If none is found, the first sequence with room for the tool is returned. The stages are sequence
    and assignment.

    Raises:
        TwinError: there is no sequence even for the tool alone, or no arm reaches a place.
    """
    from planning.lego.sequencing.arms import sequence_for_arms

    robots, carrier = len(cell.robots), tool_carrier(cell)

    def sequenced(rules: SequencingRules) -> tuple[LegoAssembly, SequencedStructure]:
        with watch.stage("sequence", SEQUENCE):
            return find_sequence(
                section,
                rules,
                robots=robots,
                progress=watch.reporter(SEQUENCE),
            )

    return sequence_for_arms(
        cell,
        sequenced,
        sequencing_rules(section, robots=robots, carrier=carrier),
        lambda: watch.stage("assignment", ASSIGNMENT),
    )


def build_lego(lego: LegoSection) -> LegoAssembly:
    """Return the plate, the stock and the steps of a LEGO section.

    A section that gives a structure has no steps yet; see ``build_structure``.
    """
    types = brick_types(lego)
    twist = lego.twist_deg.model_dump(by_alias=True)
    storage = lego.storage_plate
    return LegoAssembly(
        plate=to_planning_class(Plate, lego.plate),
        stock=tuple(
            to_planning_class(
                StockBrick, item, brick=types[item.brick], cell=brick_cell(item)
            )
            for item in lego.stock
        ),
        steps=tuple(_step(s, types) for s in lego.steps),
        twist={skill: float(np.deg2rad(angle)) for skill, angle in twist.items()},
        storage=None if storage is None else to_planning_class(Plate, storage),
    )


def build_structure(lego: LegoSection) -> tuple[PlacedBrick, ...] | None:
    """Return the bricks of the finished structure, None for a section that gives steps."""
    if lego.structure is None:
        return None
    return read_structure(lego.structure, brick_types(lego)).bricks


def structure_and_helpers(
    lego: LegoSection,
) -> tuple[tuple[PlacedBrick, ...], tuple[PlacedBrick, ...]]:
    """Return the bricks of the finished structure, and the temporary ones of steps."""
    structure, assembly = build_structure(lego), build_lego(lego)
    if structure is not None:
        return structure, ()
    built = list(zip(assembly.structure, assembly.steps, strict=True))
    return (
        tuple(item for item, step in built if not step.temporary),
        tuple(item for item, step in built if step.temporary),
    )


def tool_carrier(cell: Workcell) -> str:
    """Return the registered robot whose tool must have room in a sequence: that of all robots, or a GP4."""
    from planning.robots.registry import ROBOTS

    models = {robot.model.name: robot.model for robot in cell.robots}
    names = [n for n, m in models.items() if n in ROBOTS and "alt" in m.frames]
    return names[0] if len(models) == len(names) == 1 else "gp4"


def sequencing_rules(
    lego: LegoSection, *, robots: int, carrier: str = "gp4"
) -> SequencingRules:
    """Return the rules of a sequence, from the section and the number of robots.

    Args:
        lego: the section.
        robots: how many there are; supports and handovers take two.
        carrier: the registered robot that carries the tool.
    """
    from planning.lego.insertion.rules import SequencingRules

    allowed, assembly = lego.rules, build_lego(lego)
    stock, (wide, deep) = assembly.stock, assembly.plate.studs
    kept = {
        (x, y)
        for item in stock
        if assembly.plate_of(item) is assembly.plate
        for span in [item.span.widened(_STOCK_MARGIN)]
        for x, y in product(range(span.x0, span.x1), range(span.y0, span.y1))
    }
    ground = frozenset(product(range(wide), range(deep))) - kept
    return to_planning_class(
        SequencingRules,
        allowed,
        scaffold=bool(allowed.scaffold),
        removable=allowed.scaffold == "removable",
        support=allowed.support and robots > 1,
        place_up=allowed.place_up and robots > 1,
        hold_down=allowed.hold_down and robots > 1,
        force=allowed.press_force_n,
        margin=allowed.press_margin,
        robot=carrier,
        types=tuple(dict.fromkeys(s.brick for s in stock if not s.fixed)),
        ground=ground,
    )


def find_sequence(
    lego: LegoSection,
    rules: SequencingRules,
    *,
    robots: int,
    progress: Progress = no_progress,
) -> tuple[LegoAssembly, SequencedStructure]:
    """Return an assembly with the steps that build its finished structure.

    Given steps are replaced: only the structure that they build counts.

    Args:
        lego: the section.
        rules: of the sequence, see ``sequencing_rules``.
        robots: how many there are.
        progress: receives the number of examined partial structures, and the maximum.

    Raises:
        InfeasibleStepError: the structure does not stand, or no order leads to it.
        UndecidedError: neither a sequence was found, nor a proof that there is none.
    """
    from planning.lego.sequencing.sequencing import sequence_structure

    assembly = build_lego(lego)
    structure, helpers = structure_and_helpers(lego)
    try:
        found = sequence_structure(
            structure,
            scaffold=assembly.scaffold,
            helpers=helpers,
            rules=rules,
            progress=progress,
        )
    except InfeasibleStepError as error:
        if robots > 1:
            raise
        lone = "  (a single robot can neither support nor hand over)"
        raise error.with_message(f"{error.message}\n{lone}") from None
    return replace(assembly, steps=found.steps), found


def _step(section: BrickStepSection, types: Mapping[str, BrickType]) -> LegoStep:
    presses = section.presses or filter(None, [section.press])
    supports = section.supports or filter(None, [section.support])
    up = section.place == "up"
    return to_planning_class(
        LegoStep,
        section,
        brick=types[section.brick],
        cell=brick_cell(section),
        up=up,
        presses=tuple(to_planning_class(Press, item) for item in presses),
        supports=tuple(support_place(item, up=up) for item in supports),
    )


def brick_colours(section: LegoSection) -> dict[Cell, Colour]:
    """Return the given colours of steps or bricks, by cell."""
    structure = () if section.structure is None else section.structure.bricks
    given = {brick_cell(item): item.colour for item in section.steps}
    given |= {brick_cell(item): item.colour for item in structure}
    return {cell: colour for cell, colour in given.items() if colour is not None}

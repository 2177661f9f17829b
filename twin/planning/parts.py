"""Assemblies of parts of a scenario: from their section to data of planning, and to motions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from planning.cell.workcell import CONTACT_DEPTH, CellObject, Workcell
from planning.tasks.task import DOOR
from planning.transforms import readonly
from twin.audit.wanted import Wanted
from twin.durations.lifetimes import SkillOverride
from twin.host.progress import StageWatch
from twin.planning.build_workcell import build_shape
from twin.planning.kind import AssemblyKind, PlannedMotions
from twin.planning.part_assembly.built import assembly_of
from twin.planning.part_assembly.line import Line, machine_durations, written_out
from twin.planning.part_assembly.problems import (
    check_line,
    check_steps,
    check_work,
    machine_names,
)
from twin.planning.part_assembly.wanted import wanted_of
from twin.scenario.document.validation import Found
from twin.scenario.document.yaml_text import KeyPath
from twin.scenario.sections.cell import CellSection
from twin.scenario.sections.parts import PartSection, PartsSection
from twin.scenario.sections.shapes import as_planned, build_transform

if TYPE_CHECKING:
    from planning.motion.sequential import MotionSettings


_GREY_BLUE = (196, 214, 226)

_ROUNDING = 0.001
"""What is joined may be deeper in each other than its file says by this [m]."""

ORDERS = "orders tried"
"""Name of the stage for progress displays."""


@dataclass(frozen=True)
class PartKind(AssemblyKind):
    """An assembly of parts of a scenario.

    Attributes:
        section: what the file says.
    """

    section: PartsSection

    def steps(self) -> int:
        """Return the number of steps."""
        return len(self.section.steps)

    def supply(self) -> str:
        """Return in words what there is to build with."""
        return f"{len(self.section.parts)} parts"

    def names(self) -> Iterator[tuple[KeyPath, str]]:
        """Yield the names of the parts, each with its key."""
        for i, part in enumerate(self.section.parts):
            yield ("assembly", "parts", i, "name"), part.name
        yield from machine_names(self.section)

    def problems(self, cell: CellSection) -> Found:
        """Yield the problems of the section: steps and parts name what there is, no part twice."""
        yield from check_steps(self.section)
        yield from check_line(self.section)
        yield from check_work(self.section, cell)

    def object_kinds(self) -> Iterable[str]:
        """Return the types of the parts, each once."""
        return dict.fromkeys(part.shape_words for part in self.section.parts)

    def objects(self, folder: Path = Path()) -> tuple[CellObject, ...]:
        """Return the parts where they are at the start."""
        line = written_out(self.section)
        parts = (_part(part, line, folder) for part in line.section.parts)
        return (*parts, *_doors(line, folder))

    def machines(self) -> tuple[str, ...]:
        """Return the machines of sources, those that work, and what takes products away."""
        return written_out(self.section).machines()

    def machine_durations(self) -> tuple[SkillOverride, ...]:
        """Return how long these take for their tasks."""
        return machine_durations(self.section)

    def due(self) -> tuple[tuple[float, ...], int | None]:
        """Return when each product is due [s], and how many at the beginning do not count."""
        products = self.section.products
        return ((), None) if products is None else (products.due_s(), products.start_up)

    def products(self) -> int:
        """Return the number of products."""
        return written_out(self.section).products

    def contact_depth(self) -> float:
        """Return how deep they may be: bars that are joined may meet in a node [m]."""
        return max(CONTACT_DEPTH, self.section.joined_overlap_m + _ROUNDING)

    def wanted(self, cell: CellSection) -> Wanted:
        """Return the goals of the parts, the processes, and how far fingers stand open."""
        return wanted_of(self.section, cell)

    def plan(
        self, cell: Workcell, settings: MotionSettings, watch: StageWatch
    ) -> PlannedMotions:
        """Find the candidates, choose, and plan one task after another."""
        from planning.parts.candidates import find_candidates
        from planning.parts.expansion import part_work
        from planning.parts.order import find_ordered_candidates
        from twin.planning.goals import ASSIGNMENT, plan_in_turns

        line = written_out(self.section)
        assembly = assembly_of(line)
        with watch.stage("assignment", ASSIGNMENT):
            found = (
                find_ordered_candidates(cell, assembly, watch.reporter(ORDERS))
                if self.section.order == "find"
                else find_candidates(cell, assembly)
            )
            work = part_work(found)
        return self.finished(plan_in_turns(cell, assembly, work, settings, watch))

    def finished(self, motions: PlannedMotions) -> PlannedMotions:
        """Return motions with the way in which they go on, and which tasks are for which product."""
        from twin.planning.part_assembly.built import line_pattern

        line = written_out(self.section)
        if line.products == 1:
            return motions
        pattern = line_pattern(line, motions.motion_plan.tasks)
        return replace(motions, pattern=pattern)


def _doors(line: Line, folder: Path) -> Iterator[CellObject]:
    """Yield the doors of machines, one for every time that one is shut."""
    for job in line.jobs.values():
        door = line.section.machines[job.machine].door if job.door else None
        if job.door is None or door is None:
            continue
        shape = build_shape(job.door, door.described, folder)
        pose = readonly(build_transform(door.pose))
        yield CellObject(
            job.door, DOOR, shape, pose, fixed=True, colour=_GREY_BLUE, later=True
        )


def _part(part: PartSection, line: Line, folder: Path) -> CellObject:
    shape = build_shape(part.name, part.described, folder)
    if part.centre_of_mass_m is not None:
        shape = replace(shape, own_centre=readonly(part.centre_of_mass_m))
    return as_planned(
        CellObject,
        part,
        kind=part.shape_words,
        shape=shape,
        mass=part.mass_kg or (part.density_kg_m3 or 0.0) * shape.volume,
        fixed=part.name not in line.section.placed and part.name not in line.numbers,
        later=part.name in line.later,
    )

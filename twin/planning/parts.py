"""Assemblies of parts of a scenario: from their section to data of planning, and to motions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from planning.cell.workcell import CellObject, Workcell
from planning.parts.assembly import GripRules, PartAssembly
from planning.transforms import readonly
from twin.audit.wanted import Place, Wanted
from twin.host.progress import StageWatch
from twin.planning.kind import AssemblyKind, PlannedMotions
from twin.scenario.document.problems import Problem, mark_problems, unknown_name
from twin.scenario.document.section import plain_values
from twin.scenario.document.yaml_text import KeyPath, YamlDocument
from twin.scenario.sections.parts import PartSection, PartsSection
from twin.scenario.sections.poses import build_transform

if TYPE_CHECKING:
    from planning.motion.sequential import MotionSettings


@dataclass(frozen=True)
class PartKind(AssemblyKind):
    """An assembly of parts of a scenario.

    Attributes:
        section: what the file says.
    """

    section: PartsSection

    def steps(self) -> int:
        """Return the number of parts."""
        return len(self.section.steps)

    def supply(self) -> str:
        """Return in words what there is to build with."""
        return f"{len(self.section.parts)} parts"

    def names(self) -> Iterator[tuple[KeyPath, str]]:
        """Yield the names of the parts, each with its key."""
        for i, part in enumerate(self.section.parts):
            yield ("assembly", "parts", i, "name"), part.name

    def problems(self, document: YamlDocument) -> list[Problem]:
        """Return the problems of the section: each step moves a part of its own."""
        return mark_problems(document, self._check_steps())

    def objects(self) -> tuple[CellObject, ...]:
        """Return the parts where they are at the start."""
        return tuple(_part(part, self.section.steps) for part in self.section.parts)

    def wanted(self) -> Wanted:
        """Return the goals of the parts that are placed, and how far fingers stand open."""
        objects = {item.name: item for item in self.objects()}
        goals = build_assembly(self.section).goals
        places = tuple(
            Place(f"goal of step {k}", goals[name], objects[name].kind, name)
            for k, name in enumerate(self.section.steps, start=1)
        )
        section = self.section
        return Wanted(places, "weight", section.touch_m, section.grips.opening_m)

    def plan(
        self, cell: Workcell, settings: MotionSettings, watch: StageWatch
    ) -> PlannedMotions:
        """Find the candidates, choose, and plan one task after another."""
        from planning.parts.candidates import find_candidates
        from planning.parts.expansion import part_work
        from twin.planning.in_turns import ASSIGNMENT, plan_in_turns

        assembly = build_assembly(self.section)
        with watch.stage("assignment", ASSIGNMENT):
            work = part_work(find_candidates(cell, assembly))
        return plan_in_turns(cell, assembly, work, settings, watch)

    def _check_steps(self) -> Iterator[tuple[KeyPath, str]]:
        parts = {part.name: part for part in self.section.parts}
        seen: dict[str, int] = {}
        for k, name in enumerate(self.section.steps):
            at: KeyPath = ("assembly", "steps", k)
            if name not in parts:
                yield at, unknown_name("part", name, tuple(parts))
            elif name in seen:
                yield at, f"{name} is already placed in step {seen[name]}"
            elif parts[name].goal is None:
                yield at, f"{name} has no goal"
            seen.setdefault(name, k + 1)


def build_assembly(section: PartsSection) -> PartAssembly:
    """Return goals, steps and grips of a section."""
    grips = plain_values(section.grips)
    directions = [np.asarray(d) / np.linalg.norm(d) for d in grips["directions"]]
    grips["directions"] = tuple(tuple(d.tolist()) for d in directions)
    return PartAssembly(
        goals={
            part.name: readonly(build_transform(part.goal))
            for part in section.parts
            if part.goal is not None
        },
        grips=GripRules(**grips),
        **plain_values(section, without=("kind", "parts", "grips")),
    )


def _part(part: PartSection, steps: tuple[str, ...]) -> CellObject:
    from planning.cell.cover import box_body

    size = readonly(part.size_m)
    red, green, blue = part.colour
    return CellObject(
        name=part.name,
        kind=" x ".join(f"{edge:g}" for edge in part.size_m),
        size=size,
        start=readonly(build_transform(part.start)),
        body=box_body(part.name, size),
        mass=part.mass_kg,
        fixed=part.name not in steps,
        colour=(red, green, blue),
    )

"""Assembly of parts with its steps in order; the order is listed in the scenario file or found by search."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

from planning.cell.workcell import PlacedRobot, Workcell
from planning.errors import ConstructionError, InfeasibleStepError
from planning.parts.assembly import PartAssembly, Work
from planning.parts.part_steps import KnownStep, part_steps
from twin.document.yaml_text import KeyPath
from twin.kinds.parts.alike import listed_steps
from twin.kinds.parts.line import Line
from twin.kinds.parts.section import PartsSection


@dataclass(frozen=True)
class OrderedParts:
    """An assembly of parts, as listed and in order.

    Attributes:
        cell: its objects are the parts.
        section: the scenario section.
        line: the products of which these are the parts.
    """

    cell: Workcell
    section: PartsSection
    line: Line

    @cached_property
    def listed(self) -> PartAssembly:
        """The assembly with its steps as the file lists them."""
        from twin.kinds.parts.built import assembly_of

        return assembly_of(self.line)

    @cached_property
    def cell_without_alike_parts(self) -> Workcell:
        """The cell without interchangeable parts, as each may come from any place."""
        from planning.parts.alike import without_start_places

        return without_start_places(self.cell, self.listed)

    @cached_property
    def found(self) -> PartAssembly | str:
        """The assembly in its order, found by search if requested; or the reason of failure."""
        from planning.parts.order import order_steps_by_search

        if self.section.order != "find":
            return self.listed
        try:
            return order_steps_by_search(self.cell_without_alike_parts, self.listed)
        except (ConstructionError, InfeasibleStepError) as error:
            return error.message

    @cached_property
    def steps(self) -> tuple[KnownStep, ...] | None:
        """Its steps in that order; None if one is infeasible or there is no order."""
        if isinstance(self.found, str):
            return None
        try:
            return part_steps(self.cell_without_alike_parts, self.found)
        except InfeasibleStepError:
            return None

    def step_at(self, number: int, *keys: str) -> KeyPath:
        """Return the path of a step in the file, by its number from 1; products share paths."""
        _, index = self.line.origins[number - 1]
        return ("assembly", "steps", listed_steps(self.section)[index], *keys)

    def works(self) -> Iterator[tuple[int, KnownStep, Work, list[PlacedRobot]]]:
        """Yield robot processes in that order: listed number from 1, and allowed robots.

        There are none where a step cannot be, which is said elsewhere.
        """
        listed = {id(step): k for k, step in enumerate(self.listed.steps, start=1)}
        for known in self.steps or ():
            step = known.step
            if not isinstance(step, Work):
                continue
            process = step.process
            robots = [
                robot
                for robot in self.cell.robots
                if step.done_by(robot.name)
                and process.tool in (None, robot.tool)
                and process.frame in {"flange", *robot.model.frames}
            ]
            yield listed[id(step)], known, step, robots

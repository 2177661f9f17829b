"""An assembly of parts in the order in which the checks go through it, worked out once for all."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from planning.cell.workcell import Workcell
from planning.errors import ConstructionError, InfeasibleStepError
from planning.parts.assembly import PartAssembly
from planning.parts.part_steps import KnownStep, part_steps
from twin.scenario.sections.parts import PartsSection


@dataclass(frozen=True)
class OrderedParts:
    """An assembly of parts, as listed and in order.

    Attributes:
        cell: its objects are the parts.
        section: what the file says.
    """

    cell: Workcell
    section: PartsSection

    @cached_property
    def listed(self) -> PartAssembly:
        """The assembly with its steps as the file lists them."""
        from twin.planning.part_assembly.built import build_assembly

        return build_assembly(self.section)

    @cached_property
    def found(self) -> PartAssembly | str:
        """The assembly in its order, the one that is found if the file asks for that; or why not."""
        from planning.parts.order import in_found_order

        if self.section.order != "find":
            return self.listed
        try:
            return in_found_order(self.cell, self.listed)
        except (ConstructionError, InfeasibleStepError) as error:
            return error.message

    @cached_property
    def steps(self) -> tuple[KnownStep, ...] | None:
        """Its steps in that order; None where one cannot be, or there is no order."""
        if isinstance(self.found, str):
            return None
        try:
            return part_steps(self.cell, self.found)
        except InfeasibleStepError:
            return None

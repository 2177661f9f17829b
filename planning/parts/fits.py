"""How parts fit where they are put: their play across their ways in, step by step."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from planning.cell.workcell import Workcell
from planning.contacts.play import Play, play
from planning.contacts.touching import standing
from planning.parts.assembly import PartAssembly, PlacePart
from planning.parts.part_steps import steps_in_order


@dataclass(frozen=True)
class PartFit:
    """The fit of a part where a step puts it.

    Attributes:
        step: counted from 1.
        part: its name.
        play: across its way in.
        robots: that may do the step; all of the cell where it does not say.
    """

    step: int
    part: str
    play: Play
    robots: tuple[str, ...]

    @property
    def words(self) -> str:
        """What it is, for people: ``peg in block: 0.21 mm on all sides``."""
        return f"{self.part} in {' and '.join(self.play.beside)}: {self.play.words}"


def part_fits(cell: Workcell, assembly: PartAssembly) -> Iterator[PartFit]:
    """Yield the fits of parts that something guides into where they are put.

    Args:
        cell: its objects are the parts.
        assembly: its steps in order.
    """
    for number, step, where, goal in steps_in_order(cell, assembly):
        if not isinstance(step, PlacePart):
            continue
        others = standing(cell) | {
            item.name: (item, where[item.name])
            for item in cell.objects
            if item.name in where and item.name != step.part
        }
        way = np.array(assembly.handling(step.part).insertion)
        found = play((cell.object(step.part), goal), others, way)
        if found is not None:
            robots = tuple(r.name for r in cell.robots if step.done_by(r.name))
            yield PartFit(number, step.part, found, robots)

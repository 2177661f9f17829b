"""Colours that a scenario gives to bricks: the bricks of the stock take them as they are placed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from planning.lego.bricks.assembly import Cell, LegoAssembly
from twin.planning.kind import PlannedMotions
from twin.scenario.sections.lego import LegoSection, cell_of

Colour = tuple[int, int, int]


def brick_colours(section: LegoSection) -> dict[Cell, Colour]:
    """Return the colours that steps or bricks of the structure are given, by their cells."""
    structure = () if section.structure is None else section.structure.bricks
    given = {cell_of(item): item.colour for item in section.steps}
    given |= {cell_of(item): item.colour for item in structure}
    return {
        cell: (colour[0], colour[1], colour[2])
        for cell, colour in given.items()
        if colour is not None
    }


def coloured(
    motions: PlannedMotions, assembly: LegoAssembly, colours: Mapping[Cell, Colour]
) -> PlannedMotions:
    """Return motions whose bricks have the colours of the places that they go to.

    Args:
        motions: of the assembly.
        assembly: whose steps the motions do.
        colours: by cell; bricks that go elsewhere keep their own.
    """
    if not colours:
        return motions
    plan = motions.motion_plan
    wanted = {
        task.object: colours.get(assembly.steps[task.step - 1].cell)
        for task in plan.tasks
        if task.kind in ("place-down", "place-up")
    }
    objects = (
        item
        if (colour := wanted.get(item.name)) is None
        else replace(item, colour=colour)
        for item in plan.cell.objects
    )
    cell = replace(plan.cell, objects=tuple(objects))
    return replace(motions, motion_plan=replace(plan, cell=cell))

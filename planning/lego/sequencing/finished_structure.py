"""The finished structure of an assembly, and the assembly in another order of steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from planning.lego.bricks.assembly import LegoAssembly, brick_type
from planning.lego.bricks.contacts import PlacedBrick
from planning.lego.sequencing.sequencing import (
    SequencedStructure,
    SequencingRules,
    sequence_structure,
)


def finished_structure(assembly: LegoAssembly) -> tuple[PlacedBrick, ...]:
    """Return the bricks that the steps of an assembly place, named ``"step 1"`` and so on.

    Raises:
        ScenarioError: a step names a brick type that there is not.
    """
    return tuple(
        PlacedBrick(f"step {k}", brick_type(step.brick, assembly.bricks), step.cell)
        for k, step in enumerate(assembly.steps, start=1)
    )


def scaffold(assembly: LegoAssembly) -> tuple[PlacedBrick, ...]:
    """Return the stock bricks of an assembly that stay where they are."""
    return tuple(
        PlacedBrick(item.name, brick_type(item.brick, assembly.bricks), item.cell)
        for item in assembly.stock
        if item.fixed
    )


def sequenced(
    assembly: LegoAssembly,
    structure: Sequence[PlacedBrick] | None = None,
    rules: SequencingRules | None = None,
) -> tuple[LegoAssembly, SequencedStructure]:
    """Return an assembly with the steps that build a structure on its scaffold.

    Args:
        assembly: plate and stock; of its steps, if any, only what they build counts.
        structure: the finished structure, by default that which the steps build.
        rules: what a sequence may do.

    Raises:
        InfeasibleStepError: see ``sequence_structure``.
    """
    if structure is None:
        structure = finished_structure(assembly)
    found = sequence_structure(structure, scaffold=scaffold(assembly), rules=rules)
    return replace(assembly, steps=found.steps), found

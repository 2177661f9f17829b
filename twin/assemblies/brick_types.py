"""The bricks that a scenario may name."""

from __future__ import annotations

from planning.lego.bricks.assembly import BrickType
from twin.scenario.sections.lego import LegoSection


def brick_types(assembly: LegoSection) -> dict[str, BrickType]:
    """Return the brick types by name: the library, then those of the scenario."""
    from planning.lego.bricks.catalogue import BRICKS

    own = {
        name: BrickType(name, (brick.studs[0], brick.studs[1]), brick.mass_kg)
        for name, brick in assembly.bricks.items()
    }
    return {**BRICKS, **own}

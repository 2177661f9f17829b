"""Stability by one linear program of the whole structure: what quick judgements must agree with."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import chain

from planning.errors import ScenarioError
from planning.lego.bricks.assembly import PlacedBrick
from planning.lego.bricks.contacts import (
    Joint,
    by_name,
    filled_places,
    joints,
    side_contacts,
)
from planning.lego.stability.stability import (
    Hold,
    JointStrength,
    Load,
    add_contacts,
    add_loads,
    bodies,
    face_contacts,
    joint_contacts,
)
from planning.statics.equilibrium import StabilityReport


def stability(
    structure: Iterable[PlacedBrick],
    *,
    loads: Sequence[Load] = (),
    holds: Sequence[Hold] = (),
    loose: frozenset[str] = frozenset(),
    strength: JointStrength = JointStrength(),  # noqa: B008 - frozen
) -> StabilityReport:
    """Return whether a structure on a plate stands, and how much friction it needs.

    Args:
        structure: its bricks; those of layer 1 stand on the plate, which does not move.
        loads: forces besides gravity.
        holds: tools that stand still against bricks.
        loose: bricks that are just being pressed into place; their joints push but do not
            pull yet.
        strength: what joints bear.

    Raises:
        ScenarioError: bricks overlap or a name is used twice; a load or a hold names a brick
            that the structure does not have.
    """
    bricks = by_name(structure)
    for name in chain((v.brick for v in loads), (v.brick for v in holds), loose):
        if name not in bricks:
            raise ScenarioError(
                f"the structure has no brick {name!r}", choices=tuple(bricks)
            )
    filled = filled_places(bricks)
    knobs = joints(bricks, filled)
    if not bricks:
        return StabilityReport(0.0, None)
    if not holds and (loose_end := _floating(bricks, knobs)) is not None:
        return StabilityReport(math.inf, loose_end)
    program = bodies(bricks.values())
    for joint in knobs:
        for contact in joint_contacts(joint, bricks[joint.upper], strength):
            free = joint.upper in loose or joint.lower in loose
            held = replace(contact, pull=0.0) if free else contact
            add_contacts(program, (held,))
    for side in side_contacts(bricks, filled):
        add_contacts(program, face_contacts(side))
    add_loads(program, loads, holds)
    return program.solve()


def _floating(bricks: Mapping[str, PlacedBrick], knobs: Sequence[Joint]) -> str | None:
    """Return the first brick that no chain of joints connects to the plate."""
    linked: dict[str | None, set[str | None]] = {name: set() for name in bricks}
    linked[None] = set()
    for joint in knobs:
        linked[joint.lower].add(joint.upper)
        linked[joint.upper].add(joint.lower)
    held: set[str | None] = {None}
    front: list[str | None] = [None]
    while front:
        for name in linked[front.pop()] - held:
            held.add(name)
            front.append(name)
    return next((name for name in bricks if name not in held), None)

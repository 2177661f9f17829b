"""Joints of an assembly: what is joined is in its place as near to each other as the joint says."""

from __future__ import annotations

import math
from collections.abc import Iterator

from planning.cell.workcell import Workcell
from planning.contacts.precedence import Lying, near_to, nearest_words, standing
from planning.errors import InfeasibleStepError
from planning.parts.assembly import PartAssembly
from planning.statics.standing import Joint


def in_place(cell: Workcell, assembly: PartAssembly) -> dict[str, Lying]:
    """Return fixtures, parts in their places, and those that no step places where they lie, by name."""
    lying = standing(cell)
    for item in cell.objects:
        if item.name in assembly.goals:
            lying[item.name] = item, assembly.goals[item.name]
        elif not item.later:
            lying[item.name] = item, item.start
    return lying


def room(gap: float) -> float:
    """Return a distance in whole millimetres, rounded up [m]."""
    return math.ceil(round(gap * 1e3, 3)) / 1e3


def wide_joints(cell: Workcell, assembly: PartAssembly) -> Iterator[tuple[Joint, str]]:
    """Yield joints of things that are farther apart in their places than the joint says, with words.

    Args:
        cell: its objects are the parts.
        assembly: goals, joints, and what touches.
    """
    lying = in_place(cell, assembly) if assembly.joints else {}
    for joint in assembly.joints:
        first, second = joint.first, joint.second
        most = assembly.touch + joint.gap
        if near_to(lying[first], {second: lying[second]}, most):
            continue
        (gap,) = near_to(lying[first], {second: lying[second]}, math.inf).values()
        others = {k: v for k, v in lying.items() if k not in (first, second)}
        said = f", gap_m {joint.gap:g}" if joint.gap else ""
        yield (
            joint,
            f"{first} and {second} are joined across {gap * 1e3:.1f} mm of air, and may be"
            f" {most * 1e3:g} mm apart (touch_m {assembly.touch:g}{said}): put them nearer, or say the room"
            f" of what is between them (joined: {{parts: [{first}, {second}], gap_m: {room(gap):g}}}); of all"
            f" else {nearest_words(second, lying[second], others)}",
        )


def require_joints(cell: Workcell, assembly: PartAssembly) -> None:
    """Require that what is joined is as near as its joint says.

    Raises:
        InfeasibleStepError: it is not; says how far it is, and what is nearest.
    """
    for _, words in wide_joints(cell, assembly):
        raise InfeasibleStepError(words)

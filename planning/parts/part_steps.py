"""The steps of a pick-and-place assembly: each with its part, grips, contacts and surroundings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from planning.cell.workcell import Attachment, CellObject, Workcell
from planning.errors import InfeasibleStepError
from planning.parts.assembly import PickPlaceAssembly
from planning.parts.contact_graph import near_to, standing
from planning.parts.grips import Grip, box_grips
from planning.transforms import Transform

MOST_OVERLAP = 0.002
"""Deepest that a goal may be in what it touches: rounding of poses in files [m]."""


@dataclass(frozen=True)
class PartStep:
    """One step, known before anything is assigned, as it has a part of its own.

    Attributes:
        part: what is placed; it is picked at its ``start``.
        goal: pose of its centre in its place, in the world.
        around: all other parts: those of earlier steps in place, the others where they were.
        grips: ways to hold it; the number of a grip is its place here.
        at_start: what it touches before it is picked, with the distances [m].
        at_goal: what it touches once it is in place, with the distances [m].
    """

    part: CellObject
    goal: Transform
    around: Mapping[str, tuple[CellObject, Attachment]]
    grips: list[Grip]
    at_start: Mapping[str, float]
    at_goal: Mapping[str, float]


def part_steps(cell: Workcell, assembly: PickPlaceAssembly) -> tuple[PartStep, ...]:
    """Return the steps of an assembly, every part of which comes to lie on something.

    Args:
        cell: its objects are the parts.
        assembly: goals and steps.

    Raises:
        InfeasibleStepError: a part would hang in the air, or goes where something is.
    """
    out = []
    where = {item.name: item.start for item in cell.objects}
    for number, name in enumerate(assembly.steps, start=1):
        part, goal = cell.object(name), assembly.goals[name]
        around = {
            item.name: (item, Attachment(None, where[item.name]))
            for item in cell.objects
            if item.name != name
        }
        lying = standing(cell) | {
            k: (item, at.pose) for k, (item, at) in around.items()
        }
        at_goal = near_to((part, goal), lying, assembly.touch)
        _require_standing(f"step {number} ({name})", at_goal)
        at_start = near_to((part, part.start), lying, assembly.touch)
        grips = box_grips(part.size, part.start, goal, assembly.grips)
        out.append(PartStep(part, goal, around, grips, at_start, at_goal))
        where[name] = goal
    return tuple(out)


def _require_standing(step: str, touched: Mapping[str, float]) -> None:
    if not touched:
        raise InfeasibleStepError(
            f"{step} would leave it in the air: it touches neither a fixture nor a part that is"
            " there by then"
        )
    other, gap = min(touched.items(), key=lambda entry: entry[1])
    if gap < -MOST_OVERLAP:
        raise InfeasibleStepError(
            f"{step} goes where {other} is: they would overlap by {-gap * 1e3:.1f} mm"
        )

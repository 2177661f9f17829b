"""The parts of a pick-and-place assembly as a collision world, step by step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from planning.cell.workcell import Attachment, CellObject, Workcell
from planning.errors import InfeasibleStepError
from planning.parts.assembly import PickPlaceAssembly
from planning.parts.contact_graph import near_to, standing
from planning.parts.grips import Grip, box_grips
from planning.transforms import Transform


@dataclass(frozen=True)
class PartWorld:
    """Poses, grips and contacts of the parts, step by step.

    Each step has a part of its own, so the scene of a step is known before anything is
    assigned: the parts of earlier steps are in place, all others where they were.

    Attributes:
        cell: the cell; its objects are the parts.
        assembly: goals and steps.
    """

    cell: Workcell
    assembly: PickPlaceAssembly

    def part(self, step: int) -> CellObject:
        """Return the part of a step, counted from 1."""
        return self.cell.object(self.assembly.steps[step - 1])

    def start(self, step: int) -> Transform:
        """Return where the part of a step lies at the start."""
        return self.part(step).start

    def goal(self, step: int) -> Transform:
        """Return where the part of a step goes."""
        return self.assembly.goals[self.assembly.steps[step - 1]]

    def around(self, step: int) -> dict[str, tuple[CellObject, Attachment]]:
        """Return all other parts, each where it is while a step is done."""
        placed = set(self.assembly.steps[: step - 1])
        own = self.assembly.steps[step - 1]
        return {
            item.name: (
                item,
                Attachment(
                    None,
                    self.assembly.goals[item.name]
                    if item.name in placed
                    else item.start,
                ),
            )
            for item in self.cell.objects
            if item.name != own
        }

    def grips(self, step: int) -> list[Grip]:
        """Return the grips of a step; their numbers are their places in the list."""
        return self._grips[step - 1]

    def at_start(self, step: int) -> Mapping[str, float]:
        """Return what the part of a step touches before it is picked, with the distances."""
        return self._touched_at_start[step - 1]

    def at_goal(self, step: int) -> Mapping[str, float]:
        """Return what the part of a step touches once it is in place, with the distances."""
        return self._touched_at_goal[step - 1]

    def require_standing(self, overlap: float) -> None:
        """Check that every part comes to lie on something, and in nothing.

        Args:
            overlap: how deep a part may be in what it touches [m].

        Raises:
            InfeasibleStepError: a part would hang in the air, or goes where something is.
        """
        for step, name in enumerate(self.assembly.steps, start=1):
            touched = self.at_goal(step)
            if not touched:
                raise InfeasibleStepError(
                    f"step {step} ({name}) would leave it in the air: it touches neither a "
                    "fixture nor a part that is there by then"
                )
            other, gap = min(touched.items(), key=lambda entry: entry[1])
            if gap < -overlap:
                raise InfeasibleStepError(
                    f"step {step} ({name}) goes where {other} is: they would overlap by "
                    f"{-gap * 1e3:.1f} mm"
                )

    @cached_property
    def _grips(self) -> list[list[Grip]]:
        rules = self.assembly.grips
        return [
            box_grips(self.part(k).size, self.start(k), self.goal(k), rules)
            for k in self._steps
        ]

    @cached_property
    def _touched_at_start(self) -> list[dict[str, float]]:
        return [self._touched(k, self.start(k)) for k in self._steps]

    @cached_property
    def _touched_at_goal(self) -> list[dict[str, float]]:
        return [self._touched(k, self.goal(k)) for k in self._steps]

    @property
    def _steps(self) -> range:
        return range(1, len(self.assembly.steps) + 1)

    def _touched(self, step: int, pose: Transform) -> dict[str, float]:
        others = standing(self.cell)
        others |= {k: (item, at.pose) for k, (item, at) in self.around(step).items()}
        return near_to((self.part(step), pose), others, self.assembly.touch)

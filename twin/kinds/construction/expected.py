"""Expected results of a construction for the audit: goal poses of parts, and the joints that hold them there."""

from __future__ import annotations

from twin.audits.expectations import Expectations, Place
from twin.kinds.construction.kind import ConstructionKind
from twin.scenario.sections.cell import CellSection


def expectations_of(kind: ConstructionKind, _cell: CellSection) -> Expectations:
    """Return the goal poses of the parts, which are held there by joints."""
    kinds = {item.name: item.kind for item in kind.objects()}
    places = tuple(
        Place("its place in the structure", part.goal, kinds[part.name], part.name)
        for part in kind.parts
    )
    return Expectations(places, "joints", kind.section.touch_m, statics=kind.statics())

"""The one place that knows which kinds of assemblies there are."""

from __future__ import annotations

from twin.assemblies.kind import AssemblyKind
from twin.scenario.sections.construction import ConstructionSection
from twin.scenario.sections.goals import GoalsSection
from twin.scenario.sections.lego import LegoSection
from twin.scenario.sections.pick_place import PickPlaceSection


def assembly_kind(
    section: LegoSection | PickPlaceSection | GoalsSection | ConstructionSection,
) -> AssemblyKind:
    """Return what the twin needs of the assembly that a section describes."""
    match section:
        case LegoSection():
            from twin.assemblies.lego import LegoKind

            return LegoKind(section)
        case PickPlaceSection():
            from twin.assemblies.pick_place import PickPlaceKind

            return PickPlaceKind(section)
        case GoalsSection():
            from twin.assemblies.goals import GoalsKind

            return GoalsKind(section)
        case ConstructionSection():
            from twin.assemblies.construction import ConstructionKind

            return ConstructionKind(section)

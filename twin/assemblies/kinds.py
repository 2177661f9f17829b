"""The kinds of assemblies, found without importing any of them."""

from __future__ import annotations

from importlib import import_module

from twin.assemblies.kind import AssemblyKind
from twin.scenario.sections.scenario import AssemblySection

_KINDS = {
    "lego": ("twin.assemblies.lego", "LegoKind"),
    "pick-and-place": ("twin.assemblies.pick_place", "PickPlaceKind"),
    "goals": ("twin.assemblies.goals", "GoalsKind"),
    "construction": ("twin.assemblies.construction", "ConstructionKind"),
}
"""Module and class by the ``kind`` of a section."""


def assembly_kind(section: AssemblySection) -> AssemblyKind:
    """Return the assembly kind of a section."""
    module, name = _KINDS[section.kind]
    found: AssemblyKind = getattr(import_module(module), name)(section)
    return found

"""The assembly section of a scenario, as the section of one kind."""

from typing import TypeVar

from twin.scenario.sections.kind import AssemblySection
from twin.scenario.sections.scenario import Scenario

Kind = TypeVar("Kind", bound=AssemblySection)


def assembly_section(scenario: Scenario, kind: type[Kind]) -> Kind:
    """Return the assembly section of a scenario, which must be of a kind."""
    assert isinstance(scenario.assembly, kind)
    return scenario.assembly

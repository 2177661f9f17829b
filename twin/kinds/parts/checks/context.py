"""Data shared by the checks of an assembly of parts: its scenario section, and its parts in the order of the steps."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, wraps

from twin.checks.finding import CheckContext, Findings, KindChecks
from twin.kinds.parts.kind import PartKind
from twin.kinds.parts.ordered_parts import OrderedParts
from twin.kinds.parts.section import PartsSection


class PartsContext(KindChecks):
    """Data shared by the checks of an assembly of parts."""

    @cached_property
    def section(self) -> PartsSection:
        """The assembly section."""
        section = self.subject.scenario.assembly
        assert isinstance(section, PartsSection)
        return section

    @cached_property
    def parts(self) -> OrderedParts:
        """The assembly in order."""
        line = PartKind(self.section).distinct().line
        return OrderedParts(self.subject.cell, self.section, line)


def ordered_parts(subject: CheckContext) -> OrderedParts:
    """Return the assembly of parts of a scenario."""
    checks = subject.checks
    assert isinstance(checks, PartsContext)
    return checks.parts


def for_part_assemblies(
    check: Callable[[CheckContext, OrderedParts], Findings],
) -> Callable[[CheckContext], Findings]:
    """Return a check of assemblies of parts as one of scenarios with such an assembly."""

    @wraps(check)
    def checked(subject: CheckContext) -> Findings:
        return check(subject, ordered_parts(subject))

    return checked

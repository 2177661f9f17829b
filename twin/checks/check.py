"""The check of a scenario, which runs all single checks and sorts the findings in the order of the scenario file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from twin.checks.finding import CheckContext, Finding, Findings, FittedPart
from twin.checks.ignored_contacts import check_ignored_contacts, exemption_notes
from twin.checks.meshes import check_meshes
from twin.checks.placements import (
    check_centres,
    check_fixtures,
    check_starts,
)
from twin.checks.reach import check_reach
from twin.checks.robots import (
    check_bases,
    check_efforts,
    check_homes,
    check_skill_times,
    check_speeds,
    check_standing_times,
)
from twin.checks.tools import (
    check_descriptions,
    check_flanges,
    check_openings,
    check_suction,
    check_tool_frames,
)
from twin.checks.units import check_units
from twin.checks.usual import check_physics, check_rates, check_usual
from twin.document.validation import FileProblem, InvalidScenarioError
from twin.document.yaml_text import KeyPath, YamlDocument
from twin.scenario.sections.scenario import Scenario

_GENERAL: tuple[Callable[[CheckContext], Findings], ...] = (
    check_fixtures,
    check_meshes,
    check_bases,
    check_homes,
    check_starts,
    check_centres,
    check_descriptions,
    check_ignored_contacts,
    check_flanges,
    check_tool_frames,
    check_openings,
    check_suction,
    check_efforts,
    check_skill_times,
    check_standing_times,
    check_speeds,
    check_usual,
    check_rates,
    check_physics,
)
"""Quick checks of a kind of assembly that lists none of its own; reach is checked only if they find no error."""


_MOST_PER_KEY = 5
"""Largest number of findings of one check per key."""

_DIGITS = 4
"""Decimals to which figures agree in equivalent findings on parts of several products."""

_ABSENT: KeyPath = ("assembly", "kind")
"""Key at which a finding is shown if the file leaves its section out."""


@dataclass(frozen=True)
class CheckReport:
    """Findings of the checks.

    Attributes:
        subject: the scenario and its cell.
        document: the file, for line numbers.
        findings: findings in the order of the file, without repeats.
        fits: clearances of parts at their places; empty if there is an error.
        notes: pairs of links that are not checked for collisions.
    """

    subject: CheckContext
    document: YamlDocument
    findings: tuple[Finding, ...]
    fits: tuple[FittedPart, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def errors(self) -> tuple[Finding, ...]:
        """Errors, which make a plan impossible or wrong."""
        return tuple(item for item in self.findings if item.error)

    @property
    def warnings(self) -> tuple[Finding, ...]:
        """Warnings."""
        return tuple(item for item in self.findings if not item.error)

    def problem(self, finding: Finding) -> FileProblem:
        """Return a finding with its line and column in the file."""
        label = "" if finding.error else "warning: "
        at = finding.at if self.document.nearest(finding.at) else _ABSENT
        return self.document.problem(at, label + finding.message)

    def excerpts(self, findings: tuple[Finding, ...]) -> InvalidScenarioError:
        """Return findings as an error with positions and source lines."""
        problems = [self.problem(item) for item in findings]
        return InvalidScenarioError(self.document.path, problems, self.document.lines)

    def messages(self, findings: tuple[Finding, ...]) -> tuple[str, ...]:
        """Return findings in one line each, with the line number in the file."""
        return tuple(
            f"line {self.problem(item).mark.line}: {item.message}" for item in findings
        )

    def content(self) -> dict[str, Any]:
        """Return the report for JSON: findings with level, line, column, key and message."""
        entries = []
        for item in self.findings:
            mark = self.problem(item).mark
            entries.append(
                {
                    "level": "error" if item.error else "warning",
                    "line": mark.line,
                    "column": mark.column,
                    "key": ".".join(str(part) for part in item.at),
                    "message": item.message,
                }
            )
        fits = [fit.content() for fit in self.fits]
        return {
            "ok": not self.errors,
            "findings": entries,
            "fits": fits,
            "notes": list(self.notes),
        }


def check_scenario(
    scenario: Scenario, document: YamlDocument, folder: Path
) -> CheckReport:
    """Check everything in a scenario that needs no planning.

    Args:
        scenario: the scenario, which passed validation of its file; command options may have changed it.
        document: the file, for line numbers.
        folder: base of relative paths in it.

    Raises:
        RobotModelError: a robot description cannot be used.
    """
    subject = CheckContext(scenario, folder)
    found = findings_without_reach(subject)
    found += reach_findings(subject, found)
    report = CheckReport(subject, document, ())

    def place(item: Finding) -> tuple[int, int]:
        mark = report.problem(item).mark
        return mark.line, mark.column

    ordered = tuple(sorted(dict.fromkeys(found), key=place))
    fits = () if any(item.error for item in found) else subject.checks.fits()
    return CheckReport(subject, document, ordered, fits, exemption_notes(subject))


def findings_without_reach(subject: CheckContext) -> list[Finding]:
    """Return the findings of all checks but reach."""
    # A wrong unit would trigger all other checks.
    found = _without_repeats(subject, check_units(subject))
    checks = subject.checks.quick or _GENERAL
    for check in checks if not found else ():
        found += _without_repeats(subject, check(subject))
    return found


def reach_findings(subject: CheckContext, quick: list[Finding]) -> list[Finding]:
    """Return the findings on reach; none where errors of the quick checks prevent them."""
    at_fault = any(item.error for item in quick)
    if subject.kind.space_time:
        # The planner names only one object; overlaps at the start are reported already.
        return [
            item for item in check_reach(subject) if not (at_fault and item.at_start)
        ]
    return [] if at_fault else _without_repeats(subject, check_reach(subject))


def _without_repeats(subject: CheckContext, findings: Findings) -> list[Finding]:
    """Return the first findings of each key, and the number of others.

    Of equivalent findings on parts of several products the first one is kept.
    """
    first: dict[Any, Finding] = {}
    for item in findings:
        alike: Any = item
        if item.code:
            names = tuple(map(subject.alike_as, item.parts))
            figures = tuple(round(figure, _DIGITS) for figure in item.figures)
            alike = item.at, item.error, item.code, names, figures
        first.setdefault(alike, item)
    by_key: dict[tuple[KeyPath, bool], list[Finding]] = {}
    for item in first.values():
        by_key.setdefault((item.at, item.error), []).append(item)
    out: list[Finding] = []
    for (at, error), items in by_key.items():
        for item in items[:_MOST_PER_KEY]:
            places = [f"{k}: {v}" for k, v in subject.checks.places(item).items()]
            words = f" ({'; '.join(places)})" if places else ""
            out.append(replace(item, message=item.message + words))
        if len(items) > _MOST_PER_KEY:
            more = f"and {len(items) - _MOST_PER_KEY} more like these"
            out.append(Finding(at, more, error))
    return out


def require_no_errors(report: CheckReport) -> None:
    """Raise InvalidScenarioError with the errors of a report, if there are any."""
    if report.errors:
        raise report.excerpts(report.errors)

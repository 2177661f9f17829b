"""The function ``twin.check``: errors and warnings about a scenario, found before planning."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin.checks.check import CheckReport, check_scenario, require_no_errors
from twin.host.arguments import checks_arguments
from twin.host.progress import Report, report_nothing
from twin.trial.loaded_scenario import AnyScenario, LoadedScenario, load

if TYPE_CHECKING:
    import pyarrow as pa

CHECKING = "check of the cell"
"""Name of the stage for progress displays."""


@dataclass(frozen=True)
class Check:
    """Result of the check of a scenario.

    Attributes:
        scenario: the checked scenario.
        report: the findings with their places in the file.
    """

    scenario: LoadedScenario
    report: CheckReport

    def __repr__(self) -> str:
        """Return a one-line description."""
        errors, warnings = len(self.report.errors), len(self.report.warnings)
        counts = f"{errors} errors, {warnings} warnings"
        return f"<check of {self.scenario.name!r}: {counts}>"

    @property
    def ok(self) -> bool:
        """True if nothing makes every plan impossible or false; there may be warnings."""
        return not self.report.errors

    @property
    def errors(self) -> tuple[str, ...]:
        """Errors, which make every plan impossible or false, each with its line."""
        return self.report.messages(self.report.errors)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings, each with its line."""
        return self.report.messages(self.report.warnings)

    @property
    def warning_excerpts(self) -> str:
        """Warnings with excerpts of the file; empty without any."""
        if not self.report.warnings:
            return ""
        return self.report.excerpts(self.report.warnings).report()

    @property
    def fits(self) -> tuple[Mapping[str, Any], ...]:
        """Fits of parts at their places: clearance, neighbours, and success probability of robots."""
        return tuple(fit.content() for fit in self.report.fits)

    @property
    def findings(self) -> pa.Table:
        """Errors and warnings: level, line, column, key and message."""
        import pyarrow as pa

        names = ("level", "line", "column", "key", "message")
        rows: list[dict[str, Any]] = self.report.content()["findings"]
        types = (pa.string(), pa.int64(), pa.int64(), pa.string(), pa.string())
        return pa.table(
            {
                name: pa.array([row[name] for row in rows], kind)
                for name, kind in zip(names, types, strict=True)
            }
        )

    def require_ok(self) -> None:
        """Raise InvalidScenarioError with the errors, if there are any."""
        require_no_errors(self.report)

    def draw(self, folder: Path) -> Path:
        """Draw the cell into a folder, and return the picture ``cell.png``."""
        from twin.checks.picture import draw_cell

        return draw_cell(self.report.subject, folder)

    def _repr_html_(self) -> str:
        from twin.host.cards import card

        verdict = "nothing found" if not self.report.findings else ""
        rows = [("error", words) for words in self.errors]
        rows += [("warning", words) for words in self.warnings]
        rows += [("fit", fit.words) for fit in self.report.fits]
        return card(f"Check of {self.scenario.name}: {verdict}", rows)


@checks_arguments
def check(scenario: AnyScenario, *, progress: Report = report_nothing) -> Check:
    """Check a cell before planning: overlaps, reach, HOME, grippers, tool frames and speeds.

    Errors make every plan impossible or false, and end the command with code 2; warnings do not.

    Args:
        scenario: a scenario, or the path of its file.
        progress: receives the progress of each stage.

    Raises:
        InvalidScenarioError: the file is not valid.
        RobotModelError: a robot description cannot be used.
    """
    loaded = load(scenario)
    progress(CHECKING, 0, 1)
    report = check_scenario(loaded.sections, loaded.document, loaded.folder)
    progress(CHECKING, 1, 1)
    return Check(loaded, report)

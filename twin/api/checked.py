"""Result of the check of a scenario before planning. It is empty if ``twin.checks`` is not installed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from twin.host.progress import Report
from twin.registry import HOOKS
from twin.trial.loaded_scenario import LoadedScenario


class Checked(Protocol):
    """Result of the check of a scenario: ``twin.Check``, or ``Unchecked`` where ``twin.checks`` is not installed."""

    @property
    def scenario(self) -> LoadedScenario:
        """The checked scenario."""
        ...

    @property
    def warnings(self) -> tuple[str, ...]:
        """Messages on implausible values, each with its line in the file."""
        ...

    @property
    def fits(self) -> tuple[Mapping[str, Any], ...]:
        """Clearance of parts at their places and success probability of robots, by step."""
        ...

    @property
    def warning_excerpts(self) -> str:
        """Warnings with excerpts of the file; empty without warnings."""
        ...

    def require_ok(self) -> None:
        """Raise InvalidScenarioError with the errors, if there are any."""
        ...


@dataclass(frozen=True)
class Unchecked:
    """Empty result of a check that is not installed.

    Attributes:
        scenario: the scenario.
    """

    scenario: LoadedScenario
    warnings: tuple[str, ...] = ()
    fits: tuple[Mapping[str, Any], ...] = ()
    warning_excerpts: str = ""

    def require_ok(self) -> None:
        """Do nothing: there are no errors."""


def check_if_installed(scenario: LoadedScenario, progress: Report) -> Checked:
    """Check a scenario; return an empty result where the check is not installed."""
    if "check" not in HOOKS:
        return Unchecked(scenario)
    found: Checked = HOOKS.load("check")(scenario, progress=progress)
    return found

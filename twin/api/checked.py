"""Result of the check of a scenario before it is planned, whether or not that check is installed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from twin.host.progress import Report
from twin.registry import HOOKS
from twin.trial.loaded_scenario import LoadedScenario


class Checked(Protocol):
    """Findings of the check of a scenario; ``twin.Check`` where it is installed."""

    @property
    def scenario(self) -> LoadedScenario:
        """The scenario."""
        ...

    @property
    def warnings(self) -> tuple[str, ...]:
        """Doubtful values, each with its line in the file."""
        ...

    @property
    def fits(self) -> tuple[Mapping[str, Any], ...]:
        """Clearance of parts at their places and success probability of robots, by step."""
        ...

    @property
    def warning_excerpts(self) -> str:
        """Warnings with excerpts of the file; empty without any."""
        ...

    def require_ok(self) -> None:
        """Raise InvalidScenarioError with the errors, if there are any."""
        ...


@dataclass(frozen=True)
class Unchecked:
    """Empty result, where no check is installed.

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
    """Return the result of the check of a scenario; an empty one where the check is not installed."""
    if "check" not in HOOKS:
        return Unchecked(scenario)
    found: Checked = HOOKS.load("check")(scenario, progress=progress)
    return found

"""Motions of scenarios, planned once for all tests of a process that ask for that."""

import json
from importlib import import_module
from pathlib import Path

import pytest

from scheduling.planned_motions import PlannedMotions
from twin.host.progress import StageWatch
from twin.planning.pipeline import plan_motions
from twin.scenario.sections.scenario import Scenario, resolve_scenario


class PlannedOnce:
    """Plans the motions of a scenario at the first call, however it is then executed."""

    def __init__(self) -> None:
        self._planned: dict[str, tuple[PlannedMotions, dict[str, float]]] = {}

    def __call__(
        self,
        scenario: Scenario,
        folder: Path,
        watch: StageWatch,
        *,
        whole: bool = False,
        first: int | None = None,
    ) -> PlannedMotions:
        """Return the motions, with the time that each stage took in the watch."""
        if whole or first is not None:
            return plan_motions(scenario, folder, watch, whole=whole, first=first)
        content = resolve_scenario(scenario)
        execution = content.pop("execution")
        skills = [execution[key] for key in ("skills", "skill_overrides")]
        key = json.dumps([content, skills, str(folder.resolve())])
        if key not in self._planned:
            found = plan_motions(scenario, folder, watch)
            self._planned[key] = found, dict(watch.seconds)
        motions, seconds = self._planned[key]
        watch.seconds.update(seconds)
        return motions

    def take_over(self, patch: pytest.MonkeyPatch) -> None:
        """Let runs and studies ask here."""
        patch.setattr(import_module("twin.trial.planning"), "plan_motions", self)

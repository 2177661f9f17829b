"""An exploration whose designs are evaluated in this process, one after the other."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from tests.twin.explorations.sliders import EXPLORE, slider_file
from twin.explorations.crew import Crew, DesignTask
from twin.explorations.dimensions import dimensions_of
from twin.explorations.exploration import Exploration
from twin.explorations.journal import JOURNAL
from twin.explorations.rungs import Evaluation, ExplorationSetting, RungClimb
from twin.explorations.section import explore_section
from twin.host.progress import report_nothing
from twin.trial.loaded_scenario import LoadedScenario, load


class Bench(Crew):
    """A crew that is this process; ``width`` designs are under way at once, the last is done first."""

    def __init__(
        self,
        setting: ExplorationSetting,
        width: int = 1,
        evaluate: Callable[[DesignTask], Evaluation] | None = None,
    ) -> None:
        self._setting, self._width = setting, width
        self._waiting: list[DesignTask] = []
        self.evaluated: list[int] = []
        self._evaluate = evaluate or self._climb

    def _climb(self, task: DesignTask) -> Evaluation:
        limits = task.longest_turns_s, task.planner_seed
        return RungClimb(self._setting, task.variant, *limits).evaluate()

    @property
    def idle(self) -> int:
        return self._width - len(self._waiting)

    @property
    def busy(self) -> int:
        return len(self._waiting)

    def submit(self, task: DesignTask) -> None:
        assert self.idle
        self._waiting.append(task)

    def finished(self) -> Iterator[tuple[DesignTask, Evaluation]]:
        if self._waiting:
            task = self._waiting.pop()
            self.evaluated.append(task.number)
            yield task, self._evaluate(task)


def setting_of(file: Path, **changes: object) -> ExplorationSetting:
    """Return what designs of a scenario have in common, with something else in its section."""
    case = load(file)
    own = explore_section(case.sections)
    assert own is not None
    section = own.changed(**changes)
    return ExplorationSetting(case.sections.changed(explore=None), case.folder, section)


def exploration_of(setting: ExplorationSetting, folder: Path) -> Exploration:
    """Return an exploration in a folder, gone on with where there is one."""
    folder.mkdir(exist_ok=True)
    document = LoadedScenario(setting.scenario, setting.folder).document
    dimensions = dimensions_of(setting.scenario, setting.section, document)
    seed = setting.scenario.seed
    return Exploration(folder, setting.section, dimensions, seed, report_nothing)


def sliders_explored(
    folder: Path, more: str = EXPLORE, right: float = 0.3, **changes: Any
) -> tuple[ExplorationSetting, Exploration]:
    """Return what designs of the sliders have in common, and an exploration of them in ``out``."""
    setting = setting_of(slider_file(folder, more, right=right), **changes)
    return setting, exploration_of(setting, folder / "out")


def told(folder: Path) -> list[dict[str, Any]]:
    """Return the journal without what the clock of the machine says."""
    lines = (folder / JOURNAL).read_text().splitlines()
    return [{**json.loads(line), "cpu_s": None} for line in lines]

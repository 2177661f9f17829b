"""An exploration whose designs are evaluated in this process, one after the other."""

from collections.abc import Callable, Iterator
from pathlib import Path

from twin.explore.crew import Crew, DesignTask
from twin.explore.dimensions import dimensions_of
from twin.explore.exploration import Exploration
from twin.explore.rungs import Climb, Evaluation, Setting
from twin.host.progress import report_nothing
from twin.scenario.sections.exploration import ExploreSection
from twin.trial.loaded_scenario import load


class Bench(Crew):
    """A crew that is this process; ``width`` designs are under way at once, the last is done first."""

    def __init__(
        self,
        setting: Setting,
        width: int = 1,
        evaluate: Callable[[DesignTask], Evaluation] | None = None,
    ) -> None:
        self._setting, self._width = setting, width
        self._waiting: list[DesignTask] = []
        self.evaluated: list[int] = []
        self._evaluate = evaluate or self._climb

    def _climb(self, task: DesignTask) -> Evaluation:
        limits = task.longest_turns_s, task.planner_seed
        return Climb(self._setting, task.variant, *limits).evaluate()

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


def setting_of(file: Path, section: ExploreSection | None = None) -> Setting:
    """Return what designs of a scenario have in common."""
    case = load(file)
    own = section or case.sections.explore
    assert own is not None
    return Setting(case.sections.changed(explore=None), case.folder, own)


def exploration_of(setting: Setting, folder: Path) -> Exploration:
    """Return an exploration in a folder, gone on with where there is one."""
    folder.mkdir(exist_ok=True)
    case = load_document(setting)
    dimensions = dimensions_of(setting.scenario, setting.section, case)
    seed = setting.scenario.seed
    return Exploration(folder, setting.section, dimensions, seed, report_nothing)


def load_document(setting: Setting):  # type: ignore[no-untyped-def]
    from twin.trial.loaded_scenario import LoadedScenario

    return LoadedScenario(setting.scenario, setting.folder).document

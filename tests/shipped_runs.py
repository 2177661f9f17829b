"""Plans and runs of the shipped scenarios, made once for all tests that look at them."""

import copyreg
import fcntl
import pickle
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from twin.reading.scenario_file import load_scenario
from twin.runs.folder import prepare_run_folder
from twin.scenario.sections.cell import choose_robots
from twin.scenario.sections.scenario import Scenario, resolve_scenario, restore_scenario
from twin.trial.loaded_scenario import LoadedScenario
from twin.trial.plan_result import PlanResult, given_plan
from twin.trial.planning import plan_scenario
from twin.trial.run_plan import run_plan_to_folder
from twin.trial.run_result import RunResult

SCENARIOS = Path(__file__).parents[1] / "scenarios"


def _read_only(content: dict[Any, Any]) -> MappingProxyType[Any, Any]:
    return MappingProxyType(content)


copyreg.pickle(MappingProxyType, lambda view: (_read_only, (dict(view),)))


@dataclass(frozen=True)
class ShippedRun:
    """A shipped scenario with its plan and its run, neither recorded nor audited."""

    file: Path
    scenario: Scenario
    planned: PlanResult
    trial: RunResult


class ShippedRuns:
    """Shipped scenarios by file, such as ``lego/cliff``, planned and run at the first call.

    Several test processes may share the folder: who comes first works, the others wait and read.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._runs: dict[str, ShippedRun] = {}

    def __call__(self, name: str, robots: int | None = None) -> ShippedRun:
        """Return the run of a scenario, by so many of its robots where that is given."""
        key = name if robots is None else f"{name}-{robots}"
        if key not in self._runs:
            folder = self._folder / key
            folder.mkdir(parents=True, exist_ok=True)
            self._runs[key] = _shared(folder, SCENARIOS / f"{name}.yaml", robots)
        return self._runs[key]


def _shared(folder: Path, file: Path, robots: int | None) -> ShippedRun:
    kept = folder / "run.pickle"
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not kept.exists():
            kept.write_bytes(pickle.dumps(_plan_and_run(folder, file, robots)))
        # Who made it goes on with what was read, too: all tests see the same.
        run = pickle.loads(kept.read_bytes())
    assert isinstance(run, ShippedRun)
    return run


def _plan_and_run(folder: Path, file: Path, robots: int | None) -> ShippedRun:
    scenario = load_scenario(file)
    if robots is not None:
        content = resolve_scenario(scenario)
        choose_robots(content["cell"], robots)
        scenario = restore_scenario(content)
    planned = plan_scenario(scenario, file.parent, bound=True)
    trial = run_plan_to_folder(
        given_plan(LoadedScenario(scenario, file.parent), planned.tpg),
        prepare_run_folder(folder / "run", scenario.name),
        recording=False,
        audit=False,
    )
    return ShippedRun(file, scenario, planned, trial)

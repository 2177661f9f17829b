"""``twin.plan``: who does what, how everyone moves, and what waits for what."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from planning.errors import OutputError, RequestError
from scheduling.graph.plan_files import save_plan
from scheduling.graph.rollout import earliest_times
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.api.checks import Check, check
from twin.api.scenarios import AnyScenario, LoadedScenario, PathOrName, load
from twin.host.progress import Report, report_nothing
from twin.planning.pipeline import Planned, plan_scenario
from twin.scenario.document.validation import parsed
from twin.scenario.manifest import manifest_base, read_manifest
from twin.scenario.sections.scenario import resolved
from twin.trial.saved_plan import SavedPlan, read_saved_plan

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True)
class Plan:
    """A plan: the temporal plan graph of a scenario.

    Attributes:
        scenario: what is planned.
        made: how it was planned, or the plan that a run left.
        warnings: what the check of the cell found doubtful.
        folder: of the run that it was read from; None where it was planned.
    """

    scenario: LoadedScenario
    made: Planned | SavedPlan
    warnings: tuple[str, ...] = ()
    folder: Path | None = None

    @property
    def tpg(self) -> TemporalPlanGraph:
        """The temporal plan graph: nodes of all robots, and what waits for what."""
        return self.made.tpg

    @property
    def name(self) -> str:
        """Which plan it is, such as ``in turns`` or ``shortened``."""
        return self.made.variant

    @property
    def makespan_s(self) -> float:
        """Makespan at nominal durations [s]; that of a run is drawn by ``twin.simulate``."""
        return float(earliest_times(self.tpg).makespan)

    @property
    def planning_s(self) -> Mapping[str, float]:
        """Wall-clock seconds of each stage of planning; empty for a plan that was read."""
        return self.made.planning_s

    @property
    def tasks(self) -> pa.Table:
        """A row a task: its number, robot, kind, step, object and label."""
        import pyarrow as pa

        tasks = self.tpg.tasks
        return pa.table(
            {
                "task": pa.array(range(len(tasks)), pa.int64()),
                "robot": pa.array([task.robot for task in tasks], pa.string()),
                "kind": pa.array([task.kind for task in tasks], pa.string()),
                "step": pa.array([task.step for task in tasks], pa.int64()),
                "label": pa.array([task.label for task in tasks], pa.string()),
            }
        )

    def save(self, folder: PathOrName) -> Path:
        """Write ``plan.npz`` and ``plan.json`` into a folder, made where it is missing."""
        place = Path(folder)
        try:
            place.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{place}: cannot be made: {error.strerror}") from error
        save_plan(self.tpg, place)
        return place

    def _repr_html_(self) -> str:
        from twin.api.html import card

        rows = [
            ("robots", ", ".join(chain.robot for chain in self.tpg.chains)),
            ("tasks", str(len(self.tpg.tasks))),
            ("nodes", str(sum(map(len, self.tpg.chains)))),
            ("edges between robots", str(len(self.tpg.edges))),
            ("makespan, nominal", f"{self.makespan_s:.2f} s"),
        ]
        if self.planning_s:
            rows.append(("planned in", f"{sum(self.planning_s.values()):.1f} s"))
        rows += [("warning", words) for words in self.warnings]
        return card(f"Plan of {self.scenario.name}, {self.name}", rows)


AnyPlan = AnyScenario | Plan
"""A plan, or the scenario that is to be planned, or the path of its file."""


def plan(scenario: AnyScenario, *, progress: Report = report_nothing) -> Plan:
    """Check and plan a scenario.

    Args:
        scenario: a scenario, or the path of its file.
        progress: told how far each stage has come.

    Raises:
        InvalidScenarioError: the file is not valid, or the check of the cell finds an error.
        TwinError: the assembly cannot be built as it is, or no plan was found.
    """
    checked = check(scenario, progress=progress)
    checked.require_ok()
    return plan_checked(checked, progress)


def plan_checked(checked: Check, progress: Report = report_nothing) -> Plan:
    """Plan a scenario whose check found no errors."""
    loaded = checked.scenario
    made = plan_scenario(loaded.sections, loaded.folder, progress)
    return Plan(loaded, made, checked.warnings)


def scenario_of(source: AnyPlan) -> LoadedScenario:
    """Return the scenario of a plan, of a file, or one that was loaded before."""
    return source.scenario if isinstance(source, Plan) else load(source)


def planned(source: AnyPlan, progress: Report = report_nothing) -> Plan:
    """Return a plan as it is, and make one of anything else."""
    return source if isinstance(source, Plan) else plan(source, progress=progress)


def read_plan(folder: PathOrName, scenario: AnyScenario | None = None) -> Plan:
    """Read the plan that a run left in its folder.

    Args:
        folder: of the run.
        scenario: for which it is to be executed; by default that of the run.

    Raises:
        OutputError: there is no plan, or a file is damaged.
        ScenarioError: the plan is for another cell.
    """
    place = Path(folder)
    loaded = scenario_of_run(place) if scenario is None else load(scenario)
    saved = read_saved_plan(place, loaded.sections, loaded.folder)
    return Plan(loaded, saved, folder=place)


def scenario_of_run(folder: Path) -> LoadedScenario:
    """Return the scenario that a run was made of, as its manifest has it."""
    sections, manifest = read_manifest(folder, "run with a plan")
    base = manifest_base(folder, manifest)
    # JSON is YAML, too: what is found in it has the place of its key.
    text = json.dumps(resolved(sections), indent=2)
    return LoadedScenario(sections, parsed(base / f"{sections.name}.yaml", text), base)


def require_plan_of(plan: Plan, scenario: LoadedScenario) -> None:
    """Refuse what would need another plan than the one there is.

    Raises:
        RequestError: cell, assembly or planning of the scenario are not those of the plan.
    """
    before, now = plan.scenario.sections, scenario.sections
    for section in ("cell", "assembly", "planning"):
        if getattr(before, section) != getattr(now, section):
            raise RequestError(
                f"{section} is not that of the plan: vary what is executed, or plan anew"
            )

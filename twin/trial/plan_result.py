"""Plan of a scenario, newly computed or read from a folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planning.cell.differences import cell_differences
from planning.errors import OutputError, RequestError, ScenarioError, format_names
from planning.files import read_object
from scheduling.graph.plan_files import load_plan, plan_sha256, save_plan
from scheduling.graph.rollout import earliest_times
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.planned_motions import PlannedMotions
from twin.host.arguments import checks_arguments
from twin.planning.assignment_gain import AssignmentGain
from twin.planning.build_workcell import build_workcell
from twin.planning.idle_robots import IdleRobot, idle_robots_of_manifest
from twin.runs.folder import PLAN_FILES, TURNS, require_recorded_hashes
from twin.runs.policies import IN_SLOTS, IN_TURNS
from twin.scenario.manifest import MANIFEST, manifest_base, read_manifest
from twin.trial.loaded_scenario import AnyScenario, LoadedScenario, PathOrName, load

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True)
class PlanResult:
    """A plan: the temporal plan graph of a scenario.

    Attributes:
        scenario: the planned scenario.
        tpg: the temporal plan graph: nodes of all robots and edges between them.
        name: which plan it is, such as ``in turns`` or ``shortened``.
        turns: the sequential plan of the same motions, where the plan is made in slots or
            shortened; None where ``tpg`` has the same nodes.
        plans: plans of the same motions by their names in twin.runs.policies, where these were asked for.
        planning_s: wall-clock seconds of each stage of planning; empty for a plan that was read.
        makespan_bound_s: lower bound of the makespan at nominal durations over all assignments
            [s], None where that was not worked out.
        search: what the search for an assignment gained, None where there was none.
        warnings: warnings of the check of the cell.
        fits: clearances of parts at their places by step, from the check.
        idle: robots that get no task, and why; empty for a plan that was read from a folder without a manifest.
        made_of: the sequential motions; None for a plan that was read.
        folder: of the run that it was read from; None where it was planned.
    """

    scenario: LoadedScenario
    tpg: TemporalPlanGraph
    name: str
    turns: TemporalPlanGraph | None = None
    plans: Mapping[str, TemporalPlanGraph] = field(default_factory=dict, kw_only=True)
    planning_s: Mapping[str, float] = field(default_factory=dict)
    makespan_bound_s: float | None = None
    search: AssignmentGain | None = None
    warnings: tuple[str, ...] = ()
    fits: tuple[Mapping[str, Any], ...] = ()
    idle: tuple[IdleRobot, ...] = ()
    made_of: PlannedMotions | None = None
    folder: Path | None = None

    @property
    def motions(self) -> PlannedMotions:
        """Assignment and motions before coordination, one task after another."""
        if self.made_of is None:
            raise RequestError("a plan that was read does not say how it was planned")
        return self.made_of

    @property
    def makespan_s(self) -> float:
        """Makespan at nominal durations [s]; that of a run is drawn by ``twin.simulate``."""
        return float(earliest_times(self.tpg).makespan)

    @property
    def tasks(self) -> pa.Table:
        """Table with one row per task: number, robot, kind, step, object and label."""
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

    @checks_arguments
    def save(self, folder: PathOrName) -> Path:
        """Write ``plan.npz`` and ``plan.json`` into a folder, made where it is missing."""
        place = Path(folder)
        try:
            place.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{place}: cannot be made: {error.strerror}") from error
        save_plan(self.tpg, place)
        return place

    def __repr__(self) -> str:
        """Return a one-line description."""
        nodes = sum(map(len, self.tpg.chains))
        size = f"{len(self.tpg.tasks)} tasks, {nodes} nodes, {self.makespan_s:.2f} s"
        return f"<plan of {self.scenario.name!r}, {self.name}: {size}>"

    def _repr_html_(self) -> str:
        from twin.host.cards import card

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


def given_plan(scenario: LoadedScenario, tpg: TemporalPlanGraph) -> PlanResult:
    """Return a graph as a plan of a scenario, without further data."""
    return PlanResult(scenario, tpg, IN_SLOTS if len(tpg.slots) else IN_TURNS)


@checks_arguments
def read_plan(folder: PathOrName, scenario: AnyScenario | None = None) -> PlanResult:
    """Read the plan that a run left in its folder.

    Args:
        folder: of the run; a plan alone counts as in turns, or in slots where it has some.
        scenario: for which it is to be executed; by default that of the run.

    Raises:
        OutputError: there is no plan, or a file is damaged.
        ScenarioError: the plan is for another cell.
    """
    place = Path(folder)
    loaded = scenario_of_run(place) if scenario is None else load(scenario)
    tpg = load_plan(place)
    if scenario is not None and (place / MANIFEST).exists():
        added = loaded.sections.kind.as_planned(
            lambda: scenario_of_run(place).sections.assembly
        )
        loaded = loaded.with_assembly(added)
    found = cell_differences(tpg.cell, build_workcell(loaded.sections, loaded.folder))
    if found:
        raise ScenarioError(
            f"the plan in {place} is not for the cell of scenario {loaded.name!r}: "
            + format_names(found, most=4)
        )
    alone, about = given_plan(loaded, tpg), _about(place)
    turns, name = None, alone.name
    idle: tuple[IdleRobot, ...] = ()
    # A plan alone, or one that was put there later: nothing says what it was made of.
    if about is not None and about.get("plan_sha256") == plan_sha256(tpg):
        name, idle = (
            str(about.get("plan", name)),
            idle_robots_of_manifest(about.get("idle")),
        )
        if (digest := about.get("turns_sha256")) is not None:
            turns = load_plan(place / TURNS)
            if plan_sha256(turns) != digest:
                raise OutputError(
                    f"{place / TURNS}: is not the plan in turns of the manifest beside it"
                )
    return PlanResult(loaded, tpg, name, turns, idle=idle, folder=place)


def plan_of_run(folder: Path) -> TemporalPlanGraph:
    """Return the plan in the folder of a run, which is that of its manifest and summary.

    Args:
        folder: folder of the run; one without a manifest may hold a plan alone.

    Raises:
        OutputError: there is no plan, it is damaged, or not the one that was executed.
        RobotModelError: a robot's description has changed, or is not there any more.
    """
    require_recorded_hashes(folder, PLAN_FILES)
    tpg, about = load_plan(folder), _about(folder)
    if about is not None and about.get("plan_sha256") != plan_sha256(tpg):
        raise OutputError(
            f"the plan in {folder} is not the one of {MANIFEST} beside it"
        )
    return tpg


def scenario_of_run(folder: Path) -> LoadedScenario:
    """Return the scenario in the manifest of a run."""
    sections, manifest = read_manifest(folder, "run with a plan")
    return LoadedScenario(sections, manifest_base(folder, manifest))


def require_plan_of(plan: PlanResult, scenario: LoadedScenario) -> None:
    """Refuse to continue if the plan belongs to another scenario.

    Raises:
        RequestError: cell, assembly or planning of the scenario are not those of the plan.
    """
    before, now = plan.scenario.sections, scenario.sections
    for section in ("cell", "assembly", "planning"):
        if getattr(before, section) != getattr(now, section):
            raise RequestError(
                f"{section} is not that of the plan: vary what is executed, or plan again"
            )


def _about(folder: Path) -> dict[str, Any] | None:
    """Return the manifest of a run; None without one."""
    path, what = folder / MANIFEST, "manifest of a run"
    if not path.exists():
        return None
    found = read_object(path, what).get("run")
    if not isinstance(found, dict):
        raise OutputError(f"{path}: no {what}")
    return found

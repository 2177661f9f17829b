"""What a followed run is expected to do: policy, messages, durations, disturbances."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from planning.errors import ScenarioError
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations import packaged_timings
from twin.engine.messages import Messages
from twin.follow.forecast import Forecaster
from twin.run.run_record import Policy
from twin.scenario.disturbance_models import scenario_disturbances
from twin.scenario.duration_models import skill_durations
from twin.scenario.file import load_scenario
from twin.scenario.manifest import MANIFEST, read_manifest
from twin.trial.simulation import scenario_messages
from twin.uncertainty.disturbances import Disturbances
from twin.uncertainty.skill_durations import SkillDurations


@dataclass(frozen=True)
class FollowedSettings:
    """How a run in progress was meant to go.

    Attributes:
        name: of the scenario.
        tpg: what is executed.
        policy: how nodes are released.
        messages: between robots and dispatcher.
        durations: of skills.
        disturbances: what may go wrong.
    """

    name: str
    tpg: TemporalPlanGraph
    policy: Policy
    messages: Messages
    durations: SkillDurations
    disturbances: Disturbances

    def forecaster(self, samples: int) -> Forecaster:
        """Return what forecasts such a run, with a number of futures."""
        return Forecaster(
            self.tpg,
            self.durations,
            policy=self.policy,
            messages=self.messages,
            disturbances=self.disturbances,
            samples=samples,
        )


def followed_settings(
    folder: Path, tpg: TemporalPlanGraph, scenario: Path | None = None
) -> FollowedSettings:
    """Return how a run of a plan was meant to go.

    Args:
        folder: of the plan; its manifest says, where there is one.
        tpg: the plan.
        scenario: scenario file that says it instead.

    Raises:
        InvalidScenarioError: the scenario file is not valid.
        ScenarioError: it is for other robots.
        OutputError: the manifest is damaged.
    """
    if scenario is not None:
        found, base = load_scenario(scenario), scenario.parent
    elif (folder / MANIFEST).exists():
        found, content = read_manifest(folder, "run to follow")
        base = Path(content.get("run", {}).get("base", "."))
    else:
        durations = SkillDurations(packaged_timings())
        return FollowedSettings(
            folder.name, tpg, "asynchronous", Messages(), durations, Disturbances()
        )
    names = tuple(robot.name for robot in found.cell.robots)
    planned = tuple(robot.name for robot in tpg.cell.robots)
    if names != planned:
        raise ScenarioError(
            f"the plan in {folder} is for robots {', '.join(planned)}, scenario"
            f" {found.name!r} for {', '.join(names)}"
        )
    return FollowedSettings(
        found.name,
        tpg,
        found.execution.policy,
        scenario_messages(found.execution),
        skill_durations(found, base),
        scenario_disturbances(found.execution, names, base),
    )

"""Reference plans for the evaluation of replanning, made with advance knowledge of all objects that will be lost."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from planning.errors import InfeasibleStepError, TransitError
from planning.tasks.task import Handling, TaskKind
from planning.worlds.onward import ReplanningState
from planning.worlds.world import World
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.planned_motions import PlannedMotions
from twin.engine.engine import Simulator
from twin.engine.execution_model import ExecutionModel
from twin.engine.model_holds import with_model_holds
from twin.host.progress import StageWatch
from twin.operations.failure_triage import find_infeasible_steps
from twin.operations.operation import Operation
from twin.operations.planner import TaskSeeds
from twin.operations.replanning import plan_from
from twin.planning.pipeline import planned_shortcuts
from twin.scenario.sections.scenario import Scenario

_ALWAYS_AGAIN = 1000
"""Number of retries with which a skill never fails for good; the largest that a scenario may set."""


@dataclass
class Hindsight:
    """Executes plans with hindsight; attempts fail, but never for good.

    Each plan is made once for the same objects that are lost. Its tasks have the luck that they have in
    the first plan.

    Attributes:
        scenario: of the plan.
        motions: its base motions.
        tpg: the plan, which lost nothing.
        model: how it is executed.
    """

    scenario: Scenario
    motions: PlannedMotions
    tpg: TemporalPlanGraph
    model: ExecutionModel
    _known: dict[frozenset[str], Simulator | None] = field(default_factory=dict)

    def makespan_ns(self, done: Operation) -> int | None:
        """Return the makespan of a plan with hindsight of an operation's losses [ns].

        None where steps were abandoned, or robots, parts or orders changed at clock times, so that the
        two differ in work; and where there is no such plan.
        """
        unforeseen = self.scenario.execution.describe_unforeseen_events()
        if done.given_up or self.scenario.kind.rush_s() or unforeseen:
            return None
        tried = [task for task in done.tpg.tasks if task.kind == TaskKind.FAILED]
        handled = [h for task in tried for h in task.handlings]
        there = {item.name for item in self.motions.cell.objects}
        lost = frozenset(h.object for h in handled if h.holder == Handling.GONE) & there
        if lost not in self._known:
            self._known[lost] = self._simulator(lost)
        simulator, drawn = self._known[lost], done.record
        if simulator is None:
            return None
        run = simulator.run(seed=drawn.seed, replication=drawn.replication)
        return run.makespan_ns if run.outcome == "completed" else None

    def _simulator(self, lost: frozenset[str]) -> Simulator | None:
        tpg = self.tpg
        if lost:
            cell = self.motions.cell
            world = World(cell.start_state(), out=lost)
            now, motions = ReplanningState(world, self.motions.task_plan), self.motions
            if motions.work is not None:
                motions = replace(
                    motions, work=find_infeasible_steps(motions.work, now, cell)[0]
                )
            try:
                _, tpg = plan_from(
                    motions,
                    self.scenario,
                    cell,
                    now,
                    (),
                    StageWatch(),
                    candidates=planned_shortcuts(self.scenario),
                )
            except (InfeasibleStepError, TransitError):
                return None
        own = self.model.disturbances
        failures = {
            skill: item.changed(retries=_ALWAYS_AGAIN, loses=0.0)
            for skill, item in own.failures.items()
        }
        model = replace(self.model, disturbances=own.changed(failures=failures))
        return Simulator(
            with_model_holds(tpg, model),
            model,
            TaskSeeds.of(self.tpg).onward(tpg, 0).names,
        )

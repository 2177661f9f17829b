"""Sequential planning, one task after another, for most kinds of assemblies (APEX-MR IV)."""

from __future__ import annotations

from typing import Any

from planning.cell.workcell import Workcell
from planning.motion.sequential import MotionSettings, plan_motions_sequentially
from planning.tasks.highs_solver import assign_steps
from planning.tasks.work import AssemblyWork, StepExpansions
from scheduling.planned_motions import PlannedMotions
from twin.host.progress import StageWatch

ASSIGNMENT, MOTION = "who does what", "motions"
"""Names of the stages for progress displays."""


def plan_sequentially(
    cell: Workcell,
    assembly: Any,
    work: AssemblyWork,
    settings: MotionSettings,
    watch: StageWatch,
) -> PlannedMotions:
    """Assign tasks to robots and plan the motions; the stages are assignment and motion.

    Args:
        cell: where it is built.
        assembly: the assembly to plan.
        work: its candidates, and the tasks that follow from a choice.
        settings: how tasks are turned into motions.
        watch: measures and reports the stages.

    Raises:
        InfeasibleStepError: a step that no robot, object and grasp can do.
        TransitError: no collision-free path was found.
    """
    with watch.stage("assignment"):
        task_plan = assign_steps(work.problem)
    with watch.stage("motion"):
        steps = StepExpansions(work, task_plan)
        watch.report(MOTION, 0, len(task_plan.choices))
        motion_plan = plan_motions_sequentially(
            cell,
            steps.callables(),
            work.link,
            settings,
            watch.reporter(MOTION),
            windows=work.windows,
        )
    return PlannedMotions(cell, assembly, steps.plan, motion_plan, settings, work=work)

"""Goals of a scenario: from their section to data of planning, and to motions.

Sequential planning, one task after another, for most kinds of assemblies (APEX-MR IV).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from planning.cell.workcell import Workcell
from planning.errors import ScenarioError
from planning.motion.sequential import MotionSettings, plan_sequential
from planning.steps.robot_goals import RobotGoal
from planning.tasks.highs_solver import assign_steps
from planning.tasks.work import AssemblyWork, StepExpansions
from planning.transforms import readonly
from twin.document.validation import Found, unless_known
from twin.host.progress import StageWatch
from twin.planning.kind import AssemblyKind, PlannedMotions
from twin.scenario.sections.cell import CellSection
from twin.scenario.sections.scenario import GoalsSection, MoveSection
from twin.scenario.sections.shapes import build_transform

if TYPE_CHECKING:
    from planning.motion.sequential import MotionSettings


@dataclass(frozen=True)
class GoalsKind(AssemblyKind):
    """Goals of a scenario.

    Attributes:
        section: what the file says.
    """

    section: GoalsSection

    def steps(self) -> int:
        """Return the number of goals."""
        return len(self.section.moves)

    def supply(self) -> str:
        """Return that nothing is built."""
        return "no parts"

    def problems(self, cell: CellSection) -> Found:
        """Yield the moves of robots that the file does not have."""
        names = tuple(robot.name for robot in cell.robots)
        for k, move in enumerate(self.section.moves):
            at = ("assembly", "moves", k, "robot")
            yield from unless_known(at, "robot", move.robot, names)

    def plan(
        self, cell: Workcell, settings: MotionSettings, watch: StageWatch
    ) -> PlannedMotions:
        """Find the configurations of all goals, then the ways to them."""
        from planning.steps.robot_goals import prepare_goals

        goals = tuple(
            _goal(cell, move, k) for k, move in enumerate(self.section.moves, start=1)
        )
        with watch.stage("assignment", ASSIGNMENT):
            work = prepare_goals(cell, goals)
        return plan_in_turns(cell, goals, work, settings, watch)


def _goal(cell: Workcell, move: MoveSection, number: int) -> RobotGoal:
    robot = cell.robot(move.robot)
    if move.to is not None:
        frames = robot.model.frames
        if move.frame not in {*frames, "flange"}:
            raise ScenarioError(
                f"move {number}: robot {move.robot!r} has no frame {move.frame!r}",
                choices=(*frames, "flange"),
            )
        return RobotGoal(
            move.robot, pose=readonly(build_transform(move.to)), frame=move.frame
        )
    joints = move.to_rad_or_m
    if move.to_deg is not None:
        joints = tuple(np.deg2rad(move.to_deg).tolist())
    assert joints is not None
    dof = robot.model.dof
    if len(joints) != dof:
        raise ScenarioError(
            f"move {number}: robot {move.robot!r} has {dof} joints, not {len(joints)}"
        )
    return RobotGoal(move.robot, joints=readonly(joints))


ASSIGNMENT, MOTION = "who does what", "motions"
"""Names of the stages for progress displays."""


def plan_in_turns(
    cell: Workcell,
    assembly: Any,
    work: AssemblyWork,
    settings: MotionSettings,
    watch: StageWatch,
) -> PlannedMotions:
    """Choose who does what, and plan how everyone moves; the stages are assignment and motion.

    Args:
        cell: where it is built.
        assembly: what is built.
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
        motion_plan = plan_sequential(
            cell,
            steps.callables(),
            work.link,
            settings,
            watch.reporter(MOTION),
            windows=work.windows,
        )
    return PlannedMotions(cell, assembly, steps.plan, motion_plan, settings, work=work)

"""Assembly kind ``goals``: converts its scenario section to goal configurations and poses for planning."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from planning.cell.workcell import PlacedRobot, Workcell
from planning.errors import ScenarioError
from planning.transforms import read_only_copy
from twin.document.validation import Problems, check_known_name
from twin.host.progress import StageWatch
from twin.kinds.goals.section import GoalsSection, MoveSection
from twin.scenario.sections.cell import CellSection
from twin.scenario.sections.kind import ASSIGNMENT, AssemblyKind, IdleReason

if TYPE_CHECKING:
    from planning.goals.goal_work import GoalWork
    from planning.goals.robot_goal import RobotGoal
    from scheduling.planned_motions import PlannedMotions


@dataclass(frozen=True)
class GoalsKind(AssemblyKind):
    """Goals of a scenario.

    Attributes:
        section: the scenario section.
    """

    section_class = GoalsSection
    tries_sidesteps = True

    section: GoalsSection

    def steps(self) -> int:
        """Return the number of goals."""
        return len(self.section.moves)

    def supply(self) -> str:
        """Return that nothing is built."""
        return "no parts"

    def problems(self, cell: CellSection) -> Problems:
        """Yield moves of unknown robots."""
        names = tuple(robot.name for robot in cell.robots)
        for k, move in enumerate(self.section.moves):
            at = ("assembly", "moves", k, "robot")
            yield from check_known_name(at, "robot", move.robot, names)

    def why_unable(self, robot: PlacedRobot, motions: PlannedMotions) -> IdleReason:
        """Return that every move is that of a named robot."""
        return "not allowed"

    def assembly(self, cell: Workcell, watch: StageWatch) -> GoalWork:
        """Return the goals with their configurations; the stage is assignment."""
        from planning.goals.goal_work import prepare_goals

        goals = self.robot_goals(cell)
        with watch.stage("assignment", ASSIGNMENT):
            return prepare_goals(cell, goals)

    def robot_goals(self, cell: Workcell) -> tuple[RobotGoal, ...]:
        """Return the goals in the order of the file.

        Raises:
            ScenarioError: a robot has no such frame, or another number of joints.
        """
        return tuple(
            _goal(cell, move, k) for k, move in enumerate(self.section.moves, start=1)
        )


def _goal(cell: Workcell, move: MoveSection, number: int) -> RobotGoal:
    from planning.goals.robot_goal import RobotGoal

    robot = cell.robot(move.robot)
    if move.to is not None:
        frames = robot.model.frames
        if move.frame not in {*frames, "flange"}:
            raise ScenarioError(
                f"move {number}: robot {move.robot!r} has no frame {move.frame!r}",
                choices=(*frames, "flange"),
            )
        return RobotGoal(
            move.robot,
            pose=read_only_copy(move.to.transform()),
            frame=move.frame,
            number=number,
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
    return RobotGoal(move.robot, joints=read_only_copy(joints), number=number)

"""Goals of a scenario: from their section to data of planning, and to motions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from planning.cell.workcell import Workcell
from planning.errors import ScenarioError
from planning.steps.robot_goals import RobotGoal
from planning.transforms import readonly
from twin.host.progress import StageWatch
from twin.planning.kind import AssemblyKind, PlannedMotions
from twin.scenario.document.validation import FileProblem, mark_problems, unknown_name
from twin.scenario.document.yaml_text import YamlDocument
from twin.scenario.sections.cell import CellSection
from twin.scenario.sections.goals import GoalsSection, MoveSection
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

    def problems(self, cell: CellSection, document: YamlDocument) -> list[FileProblem]:
        """Return the moves of robots that the file does not have."""
        names = tuple(robot.name for robot in cell.robots)
        found = (
            (
                ("assembly", "moves", k, "robot"),
                unknown_name("robot", move.robot, names),
            )
            for k, move in enumerate(self.section.moves)
            if move.robot not in names
        )
        return mark_problems(document, found)

    def plan(
        self, cell: Workcell, settings: MotionSettings, watch: StageWatch
    ) -> PlannedMotions:
        """Find the configurations of all goals, then the ways to them."""
        from planning.steps.robot_goals import prepare_goals
        from twin.planning.in_turns import ASSIGNMENT, plan_in_turns

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

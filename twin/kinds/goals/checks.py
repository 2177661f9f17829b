"""Checks of assembly kind ``goals``: unreachable goal poses, and goals at which other robots stay."""

from __future__ import annotations

from collections.abc import Iterator

from planning.goals.goal_order import order_goals
from planning.kinematics.kinematics import inverse_kinematics
from twin.checks.finding import (
    CheckContext,
    Finding,
    Findings,
    KindChecks,
    format_position,
)
from twin.checks.reach import is_beyond_reach
from twin.kinds.goals.kind import GoalsKind
from twin.kinds.goals.section import GoalsSection


def _check_moves(subject: CheckContext, section: GoalsSection) -> Findings:
    for number, move in enumerate(section.moves):
        robot = subject.cell.robot(move.robot)
        if move.to is None or move.frame not in {"flange", *robot.model.frames}:
            continue
        pose = move.to.transform()
        at = ("assembly", "moves", number, "to")
        where = format_position(list(move.to.xyz_m))
        if is_beyond_reach(robot, move.frame, pose):
            yield Finding(
                at,
                f"{robot.name} does not reach {where}: it is farther away than its arm is long",
                error=True,
            )
        elif not inverse_kinematics(robot, move.frame, pose, robot.home):
            yield Finding(
                at,
                f"{robot.name} does not seem to reach {where} as turned: none of 41 tries of inverse"
                " kinematics found a configuration",
            )


def _check_order(subject: CheckContext) -> Findings:
    """Yield a goal at which another robot stands that cannot make room."""
    kind = subject.kind
    assert isinstance(kind, GoalsKind)
    for there in order_goals(subject.built, kind.robot_goals(subject.built)):
        if there.blocked_by is not None:
            why = next(reversed(there.rejected.values()))
            at = ("assembly", "moves", there.goal.number - 1)
            yield Finding(at, f"{there.goal.robot}: {why.words}", error=True)


class GoalsChecks(KindChecks):
    """Checks of a scenario whose robots go to goals."""

    @property
    def section(self) -> GoalsSection:
        """The assembly section."""
        section = self.subject.scenario.assembly
        assert isinstance(section, GoalsSection)
        return section

    def reach(self) -> Findings:
        """Yield poses that their robot does not reach, and goals that another robot blocks."""
        unreachable = list(_check_moves(self.subject, self.section))
        yield from unreachable
        if not unreachable:
            yield from _check_order(self.subject)

    def tool_frames(self) -> Iterator[tuple[str, str, bool]]:
        """Yield the tool frames that are moved to poses."""
        for move in self.section.moves:
            if move.to is not None:
                yield move.robot, move.frame, True

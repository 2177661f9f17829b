"""Checks of assembly kind ``construction``: infeasibility by lower bounds, and robots that can handle no part."""

from __future__ import annotations

from collections.abc import Iterator

from planning.errors import (
    ConstructionError,
    ScenarioError,
)
from planning.transforms import Array
from twin.checks.finding import (
    CheckContext,
    Finding,
    Findings,
    KindChecks,
)
from twin.checks.reach import idle_robot
from twin.kinds.construction.kind import ConstructionKind


def construction_kind(subject: CheckContext) -> ConstructionKind:
    """Return the construction of a scenario."""
    kind = subject.kind
    assert isinstance(kind, ConstructionKind)
    return kind


def _check_construction(subject: CheckContext) -> Findings:
    """Return the first infeasibility found by the lower bounds of the planner."""
    from planning.construction.problem.reach_bounds import reach_bounds
    from twin.planning.pipeline import motion_settings

    kind, cell = construction_kind(subject), subject.cell
    try:
        settings = motion_settings(subject.scenario, cell, subject.folder)
        bounds = reach_bounds(kind.problem(cell, settings))
        for robot in cell.robots:
            if not any(bounds.serves(robot.name)):
                yield idle_robot(subject, robot, kind.steps())
    except ConstructionError as error:
        at = subject.thing_at(next(iter(error.parts), ""), "goal")
        yield Finding(at, error.message, error=True, at_start=error.at_start)
    except ScenarioError as error:
        yield Finding(subject.thing_at("", "goal"), error.message, error=True)


class ConstructionChecks(KindChecks):
    """Checks of a scenario with a construction."""

    skills = ("pick", "place-down")

    def reach(self) -> Findings:
        """Yield the first infeasibility by lower bounds, and robots that serve no part."""
        return _check_construction(self.subject)

    def goal_pieces(self) -> Iterator[tuple[str, Array]]:
        """Yield the parts in their places."""
        from twin.checks.views import box_corners

        for part in construction_kind(self.subject).parts:
            yield part.name, box_corners(part.size, part.goal)

    def tool_frames(self) -> Iterator[tuple[str, str, bool]]:
        """Yield the frame that touches parts."""
        frame = construction_kind(self.subject).section.grips.frame
        for robot in self.subject.cell.robots:
            yield robot.name, frame, True

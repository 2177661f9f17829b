"""Tool changes at racks: paths, costs, and tasks.

A robot takes a tool from its rack, or leaves it there, with the flange at its mounting pose on the resting tool. It
approaches in a straight line along the axis of its flange, and retreats along the same line.

In plans such a tool is an object that a bare arm holds. In the search for a single skill the robot has one tool
throughout: arm and tool are then one body, as for any other robot.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise, permutations

import numpy as np

from planning.cell.robot_model import RobotModel
from planning.cell.workcell import Attachment, PlacedRobot, RackTool, Workcell
from planning.contacts.touching import nearby_entities, standing_fixtures
from planning.errors import InfeasibleStepError
from planning.geometry.robot_bodies import entity_name
from planning.handling.skill_contacts import NOTHING, SkillContacts
from planning.handling.skill_scene import Placed, SkillScene
from planning.handling.skill_targets import (
    SkillTargets,
    Subgoal,
    skill_postures,
    straight_subgoals,
)
from planning.handling.skill_trial import find_obstruction
from planning.steps.skill import (
    Obstruction,
    Pairs,
    SkillPath,
    contacts_with,
    joint_distance,
)
from planning.steps.step_writer import StepWriter
from planning.tasks.assignment import NO_TOOLS, Tools
from planning.tasks.task import DOOR, Handling, TaskKind
from planning.transforms import Transform, inverse, translation

_RACK_TOUCH = 0.002
"""Distance below which a tool in its rack may touch a body [m]."""

_RACK_DEPTH = 0.002
"""Deepest in it: hulls approximate the meshes of a tool, and fill the grooves that a rack reaches into [m]."""


def with_each_tool(robots: Iterable[PlacedRobot]) -> Iterator[PlacedRobot]:
    """Yield each robot with each of its tools mounted, and robots without tool changes unchanged."""
    for robot in robots:
        if not robot.tools:
            yield robot
        for tool in robot.tools:
            yield replace(robot, model=tool.model, tool=tool.name)


def mounted_tool(robot: PlacedRobot) -> Tools:
    """Return the mounted tool of a robot, nothing for one with a fixed tool."""
    if not robot.tools:
        return NO_TOOLS
    return frozenset({(robot.name, str(robot.tool))})


def with_tools(cell: Workcell, tools: Tools) -> Workcell:
    """Return the cell with given tools mounted and all racks full.

    A robot that is not named has all of its tools mounted together, as it is unknown yet which one it will have.
    """
    if not any(robot.tools for robot in cell.robots):
        return cell
    chosen = dict(tools)
    robots = tuple(_with_tool(robot, chosen.get(robot.name)) for robot in cell.robots)
    return replace(with_tools_in_racks(cell), robots=robots)


def with_tools_in_racks(cell: Workcell) -> Workcell:
    """Return the cell with all exchangeable tools in their racks."""
    racks = {tool.name: tool.rack for tool in rack_tools(cell)}
    objects = tuple(
        replace(item, start=racks.get(item.name, item.start)) for item in cell.objects
    )
    return replace(cell, objects=objects)


def with_all_tools_mounted(cell: Workcell) -> Workcell:
    """Return the cell in which a robot appears once with each of its tools mounted."""
    return replace(with_tools_in_racks(cell), robots=tuple(with_each_tool(cell.robots)))


def rack_tools(cell: Workcell) -> Iterator[RackTool]:
    """Yield the exchangeable tools of a cell."""
    for robot in cell.robots:
        yield from robot.tools


def _with_tool(robot: PlacedRobot, tool: str | None) -> PlacedRobot:
    if not robot.tools:
        return robot
    if tool is None:
        models = tuple(own.model for own in robot.tools)
        return replace(robot, model=_with_all_tools(robot.model, models))
    return next(own for own in with_each_tool([robot]) if own.tool == tool)


@lru_cache(maxsize=64)
def _with_all_tools(arm: RobotModel, models: tuple[RobotModel, ...]) -> RobotModel:
    """Return a robot with the bodies of several tools, as an obstacle for others."""
    tools = [p for model in models for p in model.parts if p.group == "tool"]
    return replace(arm, parts=(*arm.parts, *tools))


@dataclass(frozen=True)
class RackPath:
    """The path of a robot into a rack.

    Attributes:
        tool: that has its place there.
        path: straight to where the tool is left and taken.
        contacts: allowed contacts there.
    """

    tool: RackTool
    path: SkillPath
    contacts: Pairs


@dataclass(frozen=True)
class ToolChanges:
    """Tool changes of the robots of a cell.

    Attributes:
        cell: with robots as plans know them.
        paths: by robot and tool.
    """

    cell: Workcell
    paths: Mapping[tuple[str, str], RackPath]

    @property
    def mounted(self) -> dict[str, str]:
        """The tools mounted at the start on robots that change tools."""
        return {r.name: str(r.tool) for r in self.cell.robots if r.tools}

    @cached_property
    def costs(self) -> dict[tuple[str, str, str], float]:
        """Costs of changes by robot, tool before, and tool after: joint distance [rad].

        The time that it takes to let go and to lock counts as motion at 1 rad/s.
        """
        found = {}
        for robot in self.cell.robots:
            for old, new in permutations(robot.tools, 2):
                ends = [
                    self.paths[robot.name, tool.name].path.contact
                    for tool in (old, new)
                ]
                stops = pairwise([robot.home, *ends, robot.home])
                path = sum(joint_distance(a, b) for a, b in stops)
                found[robot.name, old.name, new.name] = path + old.seconds + new.seconds
        return found

    def begin(self, build: StepWriter) -> None:
        """Record the tools mounted at the start."""
        for robot in self.cell.robots:
            for tool in robot.tools:
                if tool.name == robot.tool:
                    mounted = Handling(tool.name, 0, robot.name, tool.mount)
                    build.stand(robot, f"with {tool.name}", mounted)

    def change(self, build: StepWriter, robot: str, old: str | None, new: str) -> None:
        """Write the tasks by which a robot leaves one tool, if any, and takes another."""
        for name, kind, verb in (
            (old, TaskKind.LEAVE_TOOL, "leave"),
            (new, TaskKind.TAKE_TOOL, "take"),
        ):
            if name is None:
                continue
            rack = self.paths[robot, name]
            path, stop = rack.path, rack.path.path[-1:]
            holder, pose = (
                (None, rack.tool.rack) if name == old else (robot, rack.tool.mount)
            )
            build.lead_in(path, f"to the rack of {name}")
            into = build.skill(path, f"into the rack of {name}", name)
            change = SkillPath(kind, robot, stop, stop, 1)
            done = build.skill(change, f"{verb} {name}", name, holder, pose)
            back = SkillPath(TaskKind.STRAIGHT, robot, stop, path.waypoints[-2::-1])
            out = build.skill(back, f"out of the rack of {name}", name)
            build.allow(rack.contacts, into, done, out)
        build.transit(robot, self.cell.robot(robot).home, f"HOME with {new}")

    def allow_mounted(
        self, build: StepWriter, mounted: Mapping[str, str | None]
    ) -> None:
        """Allow contact of robots with their mounted tools, in all tasks written so far.

        Args:
            build: has the tasks.
            mounted: tools on the robots before the first of them.
        """
        tools = {tool.name for tool in rack_tools(self.cell)}
        now: dict[str, str | None] = {**mounted}
        for task in build.tasks:
            on_it = {now.get(task.robot)}
            for handling in task.handlings:
                if handling.object in tools:
                    now[task.robot] = handling.object if handling.holder else None
            for name in {*on_it, now.get(task.robot)} - {None}:
                flange = entity_name(task.robot, "tool")
                build.allow(contacts_with(flange, [str(name)]), task.index)


def find_tool_changes(cell: Workcell, goals: Mapping[str, Transform]) -> ToolChanges:
    """Return the tool changes of the robots, valid at any stage of the assembly.

    Everything that may ever be present is an obstacle on the path to a rack: parts at their starts and in
    their places, other tools in their racks.

    Args:
        cell: with robots as plans know them.
        goals: of the parts.

    Raises:
        InfeasibleStepError: a part lies where a tool has its rack, or a robot cannot come to a
            rack, or cannot stand there; says why.
    """
    touched, paths = _touched_in_racks(cell, goals), {}
    around = with_tools(cell, NO_TOOLS)
    for robot in cell.robots:
        robots = [robot if r.name == robot.name else r for r in around.robots]
        here = replace(around, robots=tuple(robots))
        for tool in robot.tools:
            flange = contacts_with(entity_name(robot.name, "tool"), [tool.name])
            contacts = flange | contacts_with(tool.name, touched[tool.name])
            path = _rack_path(here, robot, tool, goals, contacts)
            paths[robot.name, tool.name] = RackPath(tool, path, contacts)
    return ToolChanges(cell, paths)


def _touched_in_racks(
    cell: Workcell, goals: Mapping[str, Transform]
) -> dict[str, frozenset[str]]:
    """Return the fixtures that exchangeable tools touch in their racks.

    Raises:
        InfeasibleStepError: a part lies where a tool has its rack, at the start or in its place.
    """
    fixtures = standing_fixtures(cell)
    # A door is shut around tools in their racks as around parts: who changes them waits.
    lying = {
        item.name: (item, item.start)
        for item in with_tools_in_racks(cell).objects
        if item.kind != DOOR
    }
    placed = {
        f"{name} in its place": (cell.object(name), goal)
        for name, goal in goals.items()
    }
    found: dict[str, frozenset[str]] = {}
    for tool in rack_tools(cell):
        rest = tool.item, tool.rack
        others = {k: at for k, at in (lying | placed).items() if k != tool.name}
        for other, gap in nearby_entities(rest, others | fixtures, _RACK_TOUCH).items():
            if gap < -_RACK_DEPTH:
                raise InfeasibleStepError(
                    f"the rack of {tool.name} is where {other} is: they overlap by"
                    f" {-gap * 1e3:.1f} mm",
                    thing=tool.name,
                    blocked_by=[other],
                )
        found[tool.name] = frozenset(nearby_entities(rest, fixtures, _RACK_TOUCH))
    return found


def _rack_path(
    cell: Workcell,
    robot: PlacedRobot,
    tool: RackTool,
    goals: Mapping[str, Transform],
    contacts: Pairs,
) -> SkillPath:
    placed: dict[str, Placed] = {
        item.name: (item, Attachment(None, item.start))
        for item in cell.objects
        if not item.later
    }
    for name, goal in goals.items():
        placed[f"{name} in its place"] = cell.object(name), Attachment(None, goal)
    near = tool.rack @ inverse(tool.mount)
    far = near @ translation(0.0, 0.0, -tool.approach)
    subgoals = straight_subgoals("flange", "rack", far, near)
    targets = SkillTargets(
        TaskKind.STRAIGHT, (*subgoals, Subgoal("rack", "flange", near)), len(subgoals)
    )
    on_it = contacts_with(entity_name(robot.name, "tool"), [tool.name])
    scene = SkillScene(
        cell,
        placed,
        {r.name: r.home for r in cell.robots},
        SkillContacts(NOTHING, contacts, on_it),
        (tool.name, Attachment(robot.name, tool.mount)),
    )
    found: Obstruction | None = None
    for path in skill_postures(robot, targets):
        if isinstance(path, Obstruction):
            found = path
            continue
        # In with nothing on the flange, out with the tool: in with it is the same the other way.
        both = np.vstack([path.path, path.waypoints[-2::-1]])
        found = find_obstruction(replace(path, path=both), scene)
        if found is None:
            return replace(path, change_at=None)
    assert found is not None
    raise InfeasibleStepError(
        f"{robot.name} cannot change {tool.name} at its rack: {found.words}",
        thing=tool.name,
        blocked_by=[found.by] if found.by else [],
    )

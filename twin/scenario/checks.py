"""Consistency checks across the parts of a scenario."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from planning.errors import FittingError, RobotModelError, ScenarioError, ShapeError
from planning.files import file_named
from planning.tasks.task import (
    HOLD,
    LEAVE_TOOL,
    SKILLS,
    STRAIGHT,
    SUPPLY_KINDS,
    TAKE_TOOL,
    TRANSIT,
)
from twin.durations.measured import Empirical
from twin.durations.model import DurationModel
from twin.planning.kind import assembly_kind
from twin.planning.part_assembly.problems import disturbed_machines
from twin.scenario.document.section import parts_of
from twin.scenario.document.validation import Found, unknown_name
from twin.scenario.document.yaml_text import KeyPath
from twin.scenario.sections.cell import CellSection, LimitsSection
from twin.scenario.sections.parts import PartsSection
from twin.scenario.sections.scenario import Scenario
from twin.scenario.sections.shapes import ShapeSection


def changed_tools(cell: CellSection) -> Mapping[str, str]:
    """Return the tools that are changed, each with the robot that may have it on it."""
    return {name: robot.name for robot in cell.robots for name in robot.tools}


def _check_tools(scenario: Scenario) -> Found:
    """Yield what is wrong with tools that are changed."""
    tools, owners = scenario.cell.tools, dict[str, str]()
    for i, robot in enumerate(scenario.cell.listed):
        at: KeyPath = ("cell", "robots", i)
        if robot.tools and not isinstance(scenario.assembly, PartsSection):
            kind = scenario.assembly.kind
            words = "tools are changed in assemblies of kind 'assembly' only"
            yield (*at, "tools"), f"{words}, and this is a {kind}: give tool"
        if robot.tools and robot.frames:
            yield (
                (*at, "frames"),
                "frames of tools that are changed belong to the tools",
            )
        for k, name in enumerate(robot.tools):
            here: KeyPath = (*at, "tools", k)
            if name not in tools:
                yield here, unknown_name("tool", name, tuple(tools))
            elif tools[name].rack is None:
                yield here, f"{name} has no rack: give cell.tools.{name}.rack"
            elif name in owners:
                words = (
                    f"{name} is a tool of {owners[name]} already: one robot has a tool"
                )
                yield here, f"{words}, describe another one for {robot.name}"
            owners.setdefault(name, robot.name)
    for i, robot in enumerate(scenario.cell.robots):
        if robot.tool in owners:
            key: KeyPath = (
                ("cell", "robots", i) if i < len(scenario.cell.listed) else ()
            )
            at = (*key, "tool") if key else ("cell", "team", "tool")
            words = f"{robot.tool} is changed by {owners[robot.tool]}"
            yield at, f"{words}: describe another one for {robot.name}"
    products = getattr(scenario.assembly, "products", None)
    if owners and products is not None:
        where: KeyPath = ("assembly", "products")
        yield where, "tools are not changed yet where products are made again and again"


def _check_tool_speeds(scenario: Scenario) -> Found:
    """Yield limits of the tool's speed where no plan within limits is made."""
    if scenario.speed_model == "limits":
        return
    cell = scenario.cell
    sections: list[tuple[KeyPath, LimitsSection]] = [
        (("cell", "robots", i), robot.limits) for i, robot in enumerate(cell.listed)
    ]
    if cell.team is not None:
        sections.append((("cell", "team"), cell.team.limits))
    for at, limits in sections:
        for key in ("tool_speed_m_s", "loaded_tool_speed_m_s"):
            if getattr(limits, key) is not None:
                yield (
                    (*at, "limits", key),
                    f"{key} is kept to with planning.speed_model: limits, and this plan has the speed"
                    f" model {scenario.speed_model!r}",
                )


_STATES = ("waiting", "stalled", "stopped", "retrying", "failed", "idle")
"""States of a robot in charts, beside the skills."""


def find_problems(scenario: Scenario, folder: Path) -> Found:
    """Yield everything in the scenario that cannot be as it is written.

    Args:
        scenario: passed the checks of its single values.
        folder: where relative paths in it start.
    """
    assembly = assembly_kind(scenario.assembly)
    try:
        assembly.steps()
    except ScenarioError as error:  # then it has no names and places to be checked
        yield ("assembly", "model"), str(error)
        return
    yield from _check_robots(scenario.cell, folder)
    yield from _check_names(scenario)
    yield from _check_meshes(scenario.cell.fixtures, ("cell", "fixtures"), folder)
    yield from _check_meshes(scenario.assembly, ("assembly",), folder)
    yield from _check_durations(scenario.execution, ("execution",), folder)
    yield from _check_processes(scenario)
    yield from _check_tools(scenario)
    yield from _check_tool_speeds(scenario)
    yield from _check_overrides(scenario)
    yield from _check_robot_names(scenario)
    yield from _check_skills(scenario)
    yield from assembly.problems(scenario.cell)


def _check_names(scenario: Scenario) -> Found:
    """Robots have names of their own; so have fixtures and objects together."""
    robots = [
        (_place(scenario.cell, i, "name"), r.name)
        for i, r in enumerate(scenario.cell.robots)
    ]
    things: list[tuple[KeyPath, str]] = [
        (("cell", "fixtures", i, "name"), f.name)
        for i, f in enumerate(scenario.cell.fixtures)
    ]
    assembly = assembly_kind(scenario.assembly)
    things += [(("cell", "tools", name), name) for name in changed_tools(scenario.cell)]
    things += assembly.names()
    for group in (robots, things):
        seen: set[str] = set()
        for path, name in group:
            if name in seen:
                yield path, f"the name {name!r} is already taken"
            seen.add(name)
    names = {name for _, name in robots}
    for path, name in things:
        owner = "a robot" if name in names else assembly.reserved(name)
        if owner is not None:
            yield path, f"the name {name!r} is that of {owner}"


def _place(cell: CellSection, robot: int, key: str) -> KeyPath:
    """Return where a key of a robot stands in the file; a team stands for all of its robots."""
    if robot < len(cell.listed):
        return ("cell", "robots", robot, key)
    return ("cell", "team", key)


def _check_robots(cell: CellSection, folder: Path) -> Found:
    from twin.planning.build_workcell import fitted_model

    # The robots of a team are alike: what is wrong with one is said once.
    for i, robot in enumerate(cell.robots[: len(cell.listed) + 1]):
        try:
            model = fitted_model(robot, cell.tools, folder)
            for worn in robot.outfits if robot.tools else ():
                if worn.tool in cell.tools:
                    fitted_model(worn, cell.tools, folder)
        except FittingError as error:
            at = _place(cell, i, error.key)
            tool = worn.tool if robot.tools else robot.tool
            if error.key == "tool" and tool in cell.tools:
                yield ("cell", "tools", str(tool)), str(error)
            elif error.key == "tool" and error.choices:
                yield at, unknown_name("tool", str(robot.tool), error.choices)
            else:
                yield at, str(error)
            continue
        except (RobotModelError, ScenarioError) as error:
            at = _place(cell, i, "model")
            if error.choices and not _is_path(robot.model):
                yield at, unknown_name("robot model", robot.model, error.choices)
            else:
                yield at, str(error)
            continue
        if robot.parked is not None and not model.is_mobile:
            in_team = i >= len(cell.listed)
            place = _place(cell, i, "ring" if in_team else "parked")
            yield place, f"{robot.model} cannot park: its first joints do not drive it"
        home = robot.home_deg or robot.home_rad_or_m
        key = "home_deg" if robot.home_deg else "home_rad_or_m"
        if home is not None and len(home) != model.dof:
            joints = ", ".join(model.joint_names)
            yield (
                _place(cell, i, key),
                f"{len(home)} values for the {model.dof} joints of {robot.model} ({joints})",
            )
        if robot.home_deg and model.chain.prismatic.any():
            yield (
                _place(cell, i, key),
                f"{robot.model} has sliding joints: use home_rad_or_m",
            )


def _is_path(model: str) -> bool:
    return Path(model).suffix.lower() in (".urdf", ".xml", ".mjcf")


def _check_robot_names(scenario: Scenario) -> Found:
    """Disturbances happen to robots of the cell, and to machines of the assembly."""
    machines: tuple[str, ...] = ()
    if isinstance(scenario.assembly, PartsSection):
        machines = tuple(disturbed_machines(scenario.assembly))
    for name in scenario.execution.machines:
        if name not in machines:
            words = unknown_name("machine", name, machines)
            if not machines:
                words = f"there is no machine {name!r}"
            yield ("execution", "machines", name), words
    names = [robot.name for robot in scenario.cell.robots]
    for path, name in scenario.execution.named_robots():
        if name not in names:
            yield ("execution", *path), unknown_name("robot", name, names)


def _check_durations(value: object, at: KeyPath, folder: Path) -> Found:
    """Yield durations that there cannot be, in whatever may hold some, innermost first."""
    wrong: KeyPath = ()
    for place, part in parts_of(value, at):
        if isinstance(part, DurationModel) and wrong[: len(place)] != place:
            try:
                part.located(folder)
            except ScenarioError as error:
                wrong = place
                own = (*place, "csv") if isinstance(part, Empirical) else place
                yield own, str(error)


def _check_meshes(value: object, at: KeyPath, folder: Path) -> Found:
    """Yield meshes that cannot be used, in whatever may name some."""
    for place, part in parts_of(value, at):
        if isinstance(part, ShapeSection) and part.mesh is not None:
            from planning.meshes.mesh_form import mesh_form

            try:
                file = file_named(part.mesh, folder, ShapeError)
                mesh_form(file, part.scale, part.within_m)
            except ShapeError as error:
                yield (*place, "mesh"), str(error)


def _check_skills(scenario: Scenario) -> Found:
    """Durations and failures are of skills that there are."""
    execution = scenario.execution
    changes = (LEAVE_TOOL, TAKE_TOOL) if changed_tools(scenario.cell) else ()
    valid = (*SKILLS, HOLD, *changes, *scenario.processes)
    named: list[tuple[KeyPath, str]] = [
        *((("skills", name, "[key]"), name) for name in execution.skills),
        *((("failures", name, "[key]"), name) for name in execution.failures),
        *(
            (("skill_overrides", i, "skill"), item.skill)
            for i, item in enumerate(execution.skill_overrides)
        ),
    ]
    for path, name in named:
        if name not in valid:
            yield ("execution", *path), unknown_name("skill", name, valid)


def _check_processes(scenario: Scenario) -> Found:
    """Every process has a name that nothing else has, and takes some time."""
    for name in scenario.processes:
        at: KeyPath = ("assembly", "processes", name)
        if name in (
            *SKILLS,
            HOLD,
            STRAIGHT,
            TRANSIT,
            LEAVE_TOOL,
            TAKE_TOOL,
            *SUPPLY_KINDS,
            *_STATES,
        ):
            yield at, f"a process cannot be called {name!r}: that means something else"
        elif name not in scenario.execution.skills:
            yield at, f"how long does {name} take? Give it a duration"


def _check_overrides(scenario: Scenario) -> Found:
    robots = tuple(robot.name for robot in scenario.cell.robots)
    kinds = (
        *assembly_kind(scenario.assembly).object_kinds(),
        *changed_tools(scenario.cell),
    )
    seen: dict[tuple[str, str | None, str | None], int] = {}
    for i, item in enumerate(scenario.execution.skill_overrides):
        at: KeyPath = ("execution", "skill_overrides", i)
        if item.robot is not None and item.robot not in robots:
            yield (*at, "robot"), unknown_name("robot", item.robot, robots)
        if item.object is not None and item.object not in kinds:
            text = unknown_name("type of object", item.object, kinds)
            yield (*at, "object"), text if kinds else "there are no objects"
        key = (item.skill, item.robot, item.object)
        if key in seen:
            yield at, f"the same exception as entry {seen[key] + 1}"
        seen.setdefault(key, i)

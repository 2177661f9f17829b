"""Checks that the sections of a scenario are consistent with each other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from planning.bounds import HOME_SLACK
from planning.cell.robot_model import RobotModel
from planning.errors import FittingError, RobotModelError, ScenarioError, ShapeError
from planning.files import resolve_file_name
from planning.tasks.task import TaskKind
from twin.document.section import iterate_nested
from twin.document.validation import Problems, check_known_name, unknown_name
from twin.document.yaml_text import Elsewhere, KeyPath
from twin.durations.measured import Empirical
from twin.durations.model import DurationModel
from twin.registry import KINDS
from twin.scenario.sections.cell import CellSection, RobotSection
from twin.scenario.sections.kind import assembly_kind
from twin.scenario.sections.scenario import Scenario
from twin.scenario.sections.shapes import ShapeSection

_STATES = ("waiting", "stalled", "stopped", "retrying", "failed", "idle")
"""States of a robot in charts, in addition to skills."""

_MOTIONS = (
    TaskKind.HOLD,
    TaskKind.STRAIGHT,
    TaskKind.TRANSIT,
    TaskKind.LEAVE_TOOL,
    TaskKind.TAKE_TOOL,
)
_TAKEN = frozenset((*TaskKind.SKILLS, *_MOTIONS, *TaskKind.SUPPLY, *_STATES))
"""Names that no process may have: those of tasks, and of these states."""

_KINDS = {
    "stock": "a brick in stock",
    "processes": "an unattended process",
    "products": "the outfeed of products",
    "steps": "a wait between steps",
}
"""What an entry of some sections is; of the others, their name in the singular says it."""


def _changed_tools(cell: CellSection) -> tuple[str, ...]:
    """Return the names of exchangeable tools."""
    return tuple(dict.fromkeys(name for r in cell.robots for name in r.tools))


def _check_tools(scenario: Scenario) -> Problems:
    """Yield problems of exchangeable tools."""
    tools, owners = scenario.cell.tools, dict[str, str]()
    for i, robot in enumerate(scenario.cell.listed):
        at: KeyPath = ("cell", "robots", i)
        if robot.tools and not scenario.kind.changes_tools:
            kind = scenario.assembly.kind
            able = [k for k, own in KINDS.load_all().items() if own.changes_tools]
            named = " or ".join(map(repr, able))
            words = f"tools are changed in assemblies of kind {named} only"
            yield (*at, "tools"), f"{words}, and this is a {kind}: give tool"
        if robot.tools and robot.frames:
            words = "frames of tools that are changed belong to the tools"
            yield (*at, "frames"), words
        for k, name in enumerate(robot.tools):
            here: KeyPath = (*at, "tools", k)
            if name not in tools:
                yield here, unknown_name("tool", name, tuple(tools))
            elif tools[name].rack is None:
                yield here, f"{name} has no rack: give cell.tools.{name}.rack"
            elif name in owners:
                words = f"{name} is a tool of {owners[name]} already: one robot"
                yield here, f"{words} has a tool, describe another one for {robot.name}"
            owners.setdefault(name, robot.name)
    for i, robot in enumerate(scenario.cell.robots):
        if robot.tool in owners:
            words = f"{robot.tool} is changed by {owners[robot.tool]}"
            at = _place(scenario.cell, i, "tool")
            yield at, f"{words}: describe another one for {robot.name}"


def _check_tool_speeds(scenario: Scenario) -> Problems:
    """Yield tool speed limits in scenarios that plan without limits."""
    if scenario.speed_model == "limits":
        return
    for i, robot in _distinct_robots(scenario.cell):
        for key in ("tool_speed_m_s", "loaded_tool_speed_m_s"):
            if getattr(robot.limits, key) is not None:
                yield (
                    (*_place(scenario.cell, i, "limits"), key),
                    f"{key} is kept to with planning.speed_model: limits, and this plan has the speed"
                    f" model {scenario.speed_model!r}",
                )


def find_problems(scenario: Scenario, folder: Path) -> Problems:
    """Yield all inconsistencies of a scenario.

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
    yield from _check_durations(scenario.cell.tools, ("cell", "tools"), folder)
    rules = getattr(scenario.assembly, "grips", None)
    yield from _check_durations(rules, ("assembly", "grips"), folder)
    yield from _check_tools(scenario)
    yield from _check_tool_speeds(scenario)
    yield from execution_problems(scenario, folder)
    yield from assembly.problems(scenario.cell)


def execution_problems(scenario: Scenario, folder: Path) -> Problems:
    """Yield the inconsistencies that depend on the execution section; cheap, as studies vary it often.

    Args:
        scenario: its cell and its assembly have no problems.
        folder: where relative paths in it start.
    """
    yield from _check_durations(scenario.execution, ("execution",), folder)
    yield from _check_processes(scenario)
    yield from _check_overrides(scenario)
    yield from _check_robot_names(scenario)
    yield from _check_skills(scenario)
    yield from scenario.kind.reject_problems(scenario.execution, scenario.cell)


def _check_names(scenario: Scenario) -> Problems:
    """Yield names used twice among robots, or among fixtures and objects."""
    cell, assembly = scenario.cell, assembly_kind(scenario.assembly)
    robots = [(_place(cell, i, "name"), r.name) for i, r in enumerate(cell.robots)]
    things: list[tuple[KeyPath, str]] = [
        *(
            (("cell", "fixtures", i, "name"), f.name)
            for i, f in enumerate(cell.fixtures)
        ),
        *((("cell", "tools", name), name) for name in _changed_tools(cell)),
        *assembly.names(),
    ]
    for group in (robots, things):
        seen: dict[str, KeyPath] = {}
        for path, name in group:
            if (other := seen.get(name)) is not None:
                what = f"the name {name!r} of {_kind_at(path)} is already taken by {_kind_at(other)}"
                yield path, Elsewhere(what, other)
            seen.setdefault(name, path)
    names = {name: path for path, name in robots}
    for path, name in things:
        if name in names:
            what = f"the name {name!r} is that of a robot"
            yield path, Elsewhere(what, names[name])
        elif (owner := assembly.reserved(name)) is not None:
            yield path, f"the name {name!r} is that of {owner}"


def _kind_at(path: KeyPath) -> str:
    """Return the kind of thing that is named at a key."""
    section = str(path[1])
    return _KINDS.get(section, f"a {section.removesuffix('s')}")


def _place(cell: CellSection, robot: int, key: str) -> KeyPath:
    """Return the path of a robot's key in the file; robots of a team share one."""
    if robot < len(cell.listed):
        return ("cell", "robots", robot, key)
    return ("cell", "team", key)


def _distinct_robots(cell: CellSection) -> Iterator[tuple[int, RobotSection]]:
    """Yield robots with their numbers, but only one of a team, whose robots are alike."""
    yield from enumerate(cell.robots[: len(cell.listed) + 1])


def _check_robots(cell: CellSection, folder: Path) -> Problems:
    from twin.planning.fitted_robots import fitted_model

    for i, robot in _distinct_robots(cell):
        own = robot
        try:
            model = fitted_model(robot, cell, folder)
            for own in robot.outfits if robot.tools else ():
                if own.tool in cell.tools:
                    fitted_model(own, cell, folder)
        except FittingError as error:
            at = _place(cell, i, error.key)
            if error.key == "tool" and own.tool in cell.tools:
                yield ("cell", "tools", str(own.tool)), str(error)
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
        elif robot.parked is not None:
            at = _place(cell, i, "ring" if i >= len(cell.listed) else "parked")
            for own in cell.robots[i:] if i >= len(cell.listed) else (robot,):
                yield from _check_home(at, own, model)
        home = robot.home_deg or robot.home_rad_or_m
        at = _place(cell, i, "home_deg" if robot.home_deg else "home_rad_or_m")
        if home is not None and len(home) != model.dof:
            joints = ", ".join(model.joint_names)
            words = f"the {model.dof} joints of {robot.model} ({joints})"
            yield at, f"{len(home)} values for {words}"
        elif home is not None:
            yield from _check_home(at, robot, model)
        if robot.home_deg and model.chain.prismatic.any():
            yield at, f"{robot.model} has sliding joints: use home_rad_or_m"


def _check_home(at: KeyPath, robot: RobotSection, model: RobotModel) -> Problems:
    """Yield joint values of HOME beyond the joint limits.

    Args:
        at: the key that gives HOME.
        robot: whose HOME it is.
        model: of the robot.
    """
    given: Sequence[float] = (
        robot.home_rad_or_m or np.deg2rad(robot.home_deg or ()).tolist()
    )
    if robot.parked is not None:
        given = (*robot.parked.at_m, float(np.deg2rad(robot.parked.facing_deg)))
    for k, value in enumerate(given):
        lower, upper = model.lower[k], model.upper[k]
        if lower - HOME_SLACK <= value <= upper + HOME_SLACK:
            continue
        factor, unit = 1.0, "m" if model.chain.prismatic[k] else "rad"
        if unit == "rad" and robot.home_rad_or_m is None:
            factor, unit = 180.0 / np.pi, "deg"
        words = f"is beyond the limits of {model.joint_names[k]}: must be"
        span = f"{lower * factor:.6g} to {upper * factor:.6g} {unit}"
        here = at if robot.parked is not None else (*at, k)
        yield here, f"{value * factor:.6g} {unit} {words} {span}"


def _is_path(model: str) -> bool:
    return Path(model).suffix.lower() in (".urdf", ".xml", ".mjcf")


def _check_robot_names(scenario: Scenario) -> Problems:
    """Yield disturbances of unknown robots and machines."""
    machines = tuple(scenario.kind.disturbed_machines())
    for name in scenario.execution.machines:
        at, none = ("execution", "machines", name), f"there is no machine {name!r}"
        yield from check_known_name(at, "machine", name, machines, none)
    names = [robot.name for robot in scenario.cell.robots]
    for path, name in scenario.execution.named_robots():
        yield from check_known_name(("execution", *path), "robot", name, names)
    for path, name in scenario.execution.named_workers():
        what = "robot or machine" if machines else "robot"
        yield from check_known_name(
            ("execution", *path), what, name, (*names, *machines)
        )
    outages, late = scenario.execution.outages, scenario.execution.late
    works = tuple(scenario.kind.working_machines())
    for i, item in enumerate(outages):
        who: KeyPath = ("execution", "outages", i, "robot")
        what = "robot or machine" if works else "robot"
        yield from check_known_name(who, what, item.robot, (*names, *works))
    for i, name in _repeated_names([item.robot for item in outages]):
        words = f"{name} is out for good by another entry already: leave one out"
        yield ("execution", "outages", i, "robot"), words
    parts = [name for _, name in assembly_kind(scenario.assembly).names()]
    for i, part in enumerate(late):
        place: KeyPath = ("execution", "late", i, "part")
        yield from check_known_name(
            place, "part", part.part, parts, "there are no parts"
        )
    for i, name in _repeated_names([item.part for item in late]):
        words = f"{name} comes at another time by another entry: leave one out"
        yield ("execution", "late", i, "part"), words
    count = assembly_kind(scenario.assembly).written_out().steps()
    seen, spare = set[int](), _spare_products(scenario)
    for i, change in enumerate(scenario.execution.changes):
        spare -= change.more
        if spare < 0 and change.more:
            needed = sum(item.more for item in scenario.execution.changes)
            words = f"{-spare} more than there are parts for: assembly.products.spare must be at least {needed}"
            yield ("execution", "changes", i, "more"), words
        if change.drop and scenario.kind.rush_s():
            words = "a rush order gives steps other numbers: leave drop or assembly.products.rush out"
            yield ("execution", "changes", i, "drop"), words
        for k, step in enumerate(change.drop):
            words = f"there is no step {step} (valid: 1 to {count})"
            if step in seen:
                words = f"step {step} is dropped already: leave it out"
            if step > count or step in seen:
                yield ("execution", "changes", i, "drop", k), words
            seen.add(step)


def _spare_products(scenario: Scenario) -> int:
    """Return the number of spare products that there are parts for."""
    whole = assembly_kind(scenario.assembly).written_out()
    return whole.products() - assembly_kind(scenario.assembly).products()


def _repeated_names(names: Sequence[str]) -> Iterator[tuple[int, str]]:
    """Yield repeated names, each with its place."""
    for i, name in enumerate(names):
        if name in names[:i]:
            yield i, name


def _check_durations(value: object, at: KeyPath, folder: Path) -> Problems:
    """Yield invalid durations in nested sections, innermost first."""
    wrong: KeyPath = ()
    for place, part in iterate_nested(value, at):
        if isinstance(part, DurationModel) and wrong[: len(place)] != place:
            try:
                part.located(folder)
            except ScenarioError as error:
                wrong = place
                own = (*place, "csv") if isinstance(part, Empirical) else place
                yield own, str(error)


def _check_meshes(value: object, at: KeyPath, folder: Path) -> Problems:
    """Yield unusable meshes in nested sections."""
    for place, part in iterate_nested(value, at):
        if isinstance(part, ShapeSection) and part.mesh is not None:
            from planning.meshes.mesh_loading import load_mesh

            try:
                file = resolve_file_name(part.mesh, folder, ShapeError)
                load_mesh(file, part.scale, part.within_m)
            except ShapeError as error:
                yield (*place, "mesh"), str(error)


def _check_skills(scenario: Scenario) -> Problems:
    """Yield durations and failures of unknown skills."""
    execution = scenario.execution
    changes = (
        (TaskKind.LEAVE_TOOL, TaskKind.TAKE_TOOL)
        if _changed_tools(scenario.cell)
        else ()
    )
    valid = (*TaskKind.SKILLS, TaskKind.HOLD, *changes, *scenario.processes)
    named: list[tuple[KeyPath, str]] = [
        *((("skills", name, "[key]"), name) for name in execution.skills),
        *((("failures", name, "[key]"), name) for name in execution.failures),
        *(
            (("skill_overrides", i, "skill"), item.skill)
            for i, item in enumerate(execution.skill_overrides)
        ),
    ]
    for path, name in named:
        yield from check_known_name(("execution", *path), "skill", name, valid)
    place: KeyPath
    said = {"planning": scenario.planning.deviation, "execution": execution.deviation}
    for key, deviations in said.items():
        for name in deviations or ():
            place = (key, "deviation", name, "[key]")
            if not scenario.kind.allows_deviation:
                text = f"a {scenario.assembly.kind} is planned without deviation: leave it out"
                yield (key, "deviation"), text
            yield from check_known_name(place, "skill", name, valid)
    things = tuple(scenario.kind.part_names())
    lie_as_said = scenario.kind.has_given_starts()
    robots = [robot.name for robot in scenario.cell.robots]
    for skill, failure in execution.failures.items():
        at_a_part = skill in TaskKind.HANDLING
        if failure.then != "again" and at_a_part:
            words = f"{skill} is no process: a failed skill is retried, or restarted with another object"
            yield ("execution", "failures", skill, "then"), f"{words} (valid: again)"
        asks = failure.rework is not None and failure.rework.then == "ask"
        if asks and execution.recovery.ask is None:
            place = ("execution", "failures", skill, "rework", "then")
            yield place, "there is nobody to ask: give recovery.ask (valid: scrap)"
        if failure.wrong > 0.0 and skill != "pick":
            words = f"no wrong part is found in {skill}: leave it out (valid: pick)"
            yield ("execution", "failures", skill, "wrong"), words
        if failure.beside > 0.0:
            place = ("execution", "failures", skill, "beside")
            if skill != "pick":
                words = f"nothing is found beside its place in {skill}: leave it out"
                yield place, f"{words} (valid: pick)"
            elif not lie_as_said:
                words = "only parts of an assembly without sources and products lie beside where they are said to be"
                yield place, f"{words}: leave it out"
            if failure.beside + failure.wrong > 1.0:
                yield place, "with wrong it is more than all that are lost"
        if failure.slips > 0.0 and skill not in ("place-down", "place-up", "handover"):
            words = f"nothing is in the hand before {skill}, so that it could slip: leave it out"
            yield ("execution", "failures", skill, "slips"), words
        if failure.loses > 0.0 and not at_a_part:
            words = f"nothing can be lost in {skill}, in which nothing changes hands: leave it out"
            place = ("execution", "failures", skill, "loses")
            yield place, f"{words} (valid: {', '.join(TaskKind.HANDLING)})"
        for name in failure.parts:
            at: KeyPath = ("execution", "failures", skill, "parts", name, "[key]")
            robot, _, part = name.rpartition("/")
            yield from check_known_name(at, "part", part, things)
            yield from check_known_name(at, "robot", robot or None, robots)


def _check_processes(scenario: Scenario) -> Problems:
    """Yield processes whose name is taken or whose duration is missing."""
    for name in scenario.processes:
        at: KeyPath = ("assembly", "processes", name)
        if name in _TAKEN:
            yield at, f"a process cannot be called {name!r}: that means something else"
        elif name not in scenario.execution.skills:
            yield at, f"how long does {name} take? Give it a duration"


def _check_overrides(scenario: Scenario) -> Problems:
    robots = tuple(robot.name for robot in scenario.cell.robots)
    kinds = (
        *assembly_kind(scenario.assembly).object_kinds(),
        *_changed_tools(scenario.cell),
    )
    seen: dict[tuple[str, str | None, str | None], int] = {}
    for i, item in enumerate(scenario.execution.skill_overrides):
        at: KeyPath = ("execution", "skill_overrides", i)
        yield from check_known_name((*at, "robot"), "robot", item.robot, robots)
        what, none = "type of object", "there are no objects"
        yield from check_known_name((*at, "object"), what, item.object, kinds, none)
        key = (item.skill, item.robot, item.object)
        if key in seen:
            yield at, f"the same exception as entry {seen[key] + 1}"
        seen.setdefault(key, i)

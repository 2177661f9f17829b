"""Workcell for an open plan (the JSON plan format of ``twin judge``), with all objects that the plan names."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from planning.cell.workcell import Workcell
from twin.document.validation import Problems, check_known_name
from twin.document.yaml_text import KeyPath
from twin.judge.open_plan import OpenPlan, require_no_faults
from twin.scenario.sections.kind import AssemblySection, assembly_kind


def cell_for(
    plan: OpenPlan, path: Path, cell: Workcell, assembly: AssemblySection
) -> Workcell:
    """Return the cell with all objects that a plan names.

    Further bricks of a feeding station, ``<station>.2`` and so on, are only in the cell where a plan
    uses them.

    Args:
        plan: the plan.
        path: its file.
        cell: of its scenario.
        assembly: of its scenario.

    Raises:
        InvalidScenarioError: the plan names unknown robots, joints or objects.
    """
    kind = assembly_kind(assembly)
    known = {item.name: item for item in cell.objects}
    for _, _, motion in plan.placed():
        for name in (motion.object, *(event.object for event in motion.events)):
            if name is None or name in known:
                continue
            if (item := kind.object_named(name, known)) is not None:
                known[item.name] = item
    whole = replace(cell, objects=tuple(known.values()))
    require_no_faults(path, _misfits(plan, whole))
    return whole


def _misfits(plan: OpenPlan, cell: Workcell) -> Problems:
    """Yield names of a plan that are not in the cell."""
    robots = {robot.name: robot for robot in cell.robots}
    machines = {item.name for item in cell.machines}
    named = (*(o.name for o in cell.objects), *(f.name for f in cell.fixtures))
    things = sorted(set(named))
    for name, own in plan.robots.items():
        at: KeyPath = ("robots", name)
        yield from check_known_name((*at, "[key]"), "robot", name, robots)
        if name in robots and sorted(own.joints) != sorted(
            robots[name].model.joint_names
        ):
            joints = ", ".join(robots[name].model.joint_names)
            yield (*at, "joints"), f"are not those of {name}, each once: {joints}"
    for name in plan.machines:
        words = "the scenario has no machines"
        yield from check_known_name(
            ("machines", name, "[key]"), "machine", name, machines, words
        )
    objects = sorted(item.name for item in cell.objects)
    for at, name, motion in plan.placed():
        yield from check_known_name((*at, "object"), "object", motion.object, things)
        for k, touched in enumerate(motion.touches):
            yield from check_known_name((*at, "touches", k), "thing", touched, things)
        for k, event in enumerate(motion.events):
            place = (*at, "events", k)
            yield from check_known_name(
                (*place, event.verb), "object", event.object, objects
            )
            if event.to is not None:
                yield from check_known_name((*place, "to"), "robot", event.to, robots)
            if name in machines and event.verb not in ("appear", "leave"):
                yield (
                    (*place, event.verb),
                    "a machine lets objects appear and leave only",
                )

"""What a run of an assembly of parts is to come to, for the audit."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from planning.parts.assembly import MachineWork, PartAssembly, PlacePart, Work
from planning.transforms import Transform, readonly
from twin.audit.wanted import ChangedTool, Wanted, WantedProcess, WantedRest
from twin.audit.wanted import Place as WantedPlace
from twin.planning.part_assembly.built import assembly_of, joined_pairs
from twin.planning.part_assembly.line import Line, written_out
from twin.scenario.sections.cell import CellSection
from twin.scenario.sections.parts import PartsSection
from twin.scenario.sections.shapes import build_transform


def wanted_of(section: PartsSection, cell: CellSection) -> Wanted:
    """Return the goals of the parts, where they lie on their way, and what is done to them.

    Args:
        section: what the file says of the assembly.
        cell: what it says of robots and fixtures.
    """
    line = written_out(section, whole=True)
    assembly = assembly_of(line)
    gone = {
        name for leaving in line.supply.leaves.values() for name, _ in leaving.parts
    }
    kinds = {part.name: part.shape_words for part in line.section.parts}
    places = tuple(
        WantedPlace(
            f"goal of step {k}",
            assembly.goals[step.part],
            kinds[step.part],
            step.part,
            held=step.hold is not None,
            name=step.name,
            after=step.after,
        )
        for k, step in enumerate(assembly.steps, start=1)
        if isinstance(step, PlacePart) and step.stop is None and step.part not in gone
    )
    processes = tuple(
        _wanted_process(cell, step, k)
        for k, step in enumerate(assembly.steps, start=1)
        if isinstance(step, Work)
    )
    return Wanted(
        places,
        "weight",
        section.touch_m,
        max(
            [section.grips.opening_m]
            + [p.grips.opening_m or 0.0 for p in section.parts if p.grips]
        ),
        processes=processes,
        joined=joined_pairs(section),
        joined_overlap_m=section.joined_overlap_m,
        rests=tuple(_wanted_rests(cell, line, assembly)),
        doors=frozenset(job.door for job in line.jobs.values() if job.door),
        tools=tuple(_changed_tools(cell)),
        keeps={
            step.part: step.until
            for step in assembly.steps
            if isinstance(step, PlacePart) and step.until is not None
        },
    )


def _changed_tools(cell: CellSection) -> Iterator[ChangedTool]:
    for robot in cell.robots:
        for name in robot.tools:
            section = cell.tools[name]
            assert section.rack is not None
            yield ChangedTool(
                name,
                robot.name,
                build_transform(section.mount),
                build_transform(section.rack),
                section.grip(name),
                first=name == robot.tools[0],
            )


def _wanted_rests(
    cell: CellSection, line: Line, assembly: PartAssembly
) -> Iterator[WantedRest]:
    """Yield where parts are put down on their way, and worked at without a robot."""
    where = {
        part.name: build_transform(part.start)
        for part in line.section.parts
        if part.start is not None
    }
    if line.section.order == "find":  # then all is done at parts in their places
        where |= {name: assembly.goals[name] for name in assembly.placed}
    for k, step in enumerate(assembly.steps, start=1):
        if isinstance(step, PlacePart):
            where[step.part] = assembly.goals[step.part]
            if step.stop is None:
                continue
            frame = _fixture_frame(cell, step.stop.owner, step.stop.frame)
            where[step.part] = readonly(frame @ step.stop.pose)
            yield WantedRest(step.words, step.part, where[step.part])
        elif isinstance(step, MachineWork):
            yield WantedRest(
                step.words,
                step.part,
                where[step.part],
                process=step.process,
                machine=line.section.processes[step.process].machine,
                name=step.name or f"step {k}",
                after=step.after,
            )


def _fixture_frame(
    cell: CellSection, fixture: str | None, frame: str | None
) -> Transform:
    """Return the pose of a fixture of the file, or of one of its frames; None for the world."""
    for item in cell.fixtures:
        if item.name == fixture:
            inside = np.eye(4) if frame is None else build_transform(item.frames[frame])
            return np.asarray(build_transform(item.pose) @ inside)
    return np.eye(4)


def _wanted_process(cell: CellSection, step: Work, number: int) -> WantedProcess:
    spot, tool = step.spot, step.process.tool
    owner, pose = spot.owner, spot.pose
    robots = step.robots
    if tool is not None:
        having = [r.name for r in cell.robots if tool in (r.tool, *r.tools)]
        robots = tuple(name for name in having if step.done_by(name))
    if any(item.name == owner for item in cell.fixtures):
        pose = _fixture_frame(cell, owner, spot.frame) @ pose
        owner = None
    return WantedProcess(
        words=step.words,
        process=step.process.name,
        owner=owner,
        pose=pose,
        path=step.process.path or (readonly(np.eye(4)),),
        frame=step.process.frame,
        robots=robots,
        tool=tool,
        hold=step.hold,
        name=step.name or f"step {number}",
        after=step.after,
    )

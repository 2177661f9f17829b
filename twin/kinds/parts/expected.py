"""Expected result of an assembly of parts, for the audit: goals, intermediate places and processes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from planning.parts.assembly import MachineWork, PlacePart, Work
from planning.transforms import Transform, read_only_copy
from twin.audits.expectations import (
    ChangedTool,
    Expectations,
    ExpectedProcess,
    ExpectedRest,
)
from twin.audits.expectations import Place as WantedPlace
from twin.kinds.parts.alike import expand_pairs
from twin.kinds.parts.built import assembly_of, joined_pairs, overlaps_of
from twin.kinds.parts.kind import PartKind
from twin.kinds.parts.line import write_out_line
from twin.scenario.sections.cell import CellSection


def expectations_of(kind: PartKind, cell: CellSection) -> Expectations:
    """Return the goals, intermediate places and processes of the parts."""
    section = kind.section
    line = write_out_line(section, whole=True)
    assembly, parts = assembly_of(line), {p.name: p for p in line.section.parts}
    gone = {
        name for leaving in line.supply.leaves.values() for name, _ in leaving.parts
    }
    where = {k: p.start.transform() for k, p in parts.items() if p.start}
    if section.order == "find":  # processes are then done on parts at their goals
        where |= {name: assembly.goals[name] for name in assembly.placed}
    places, processes, rests = [], [], []
    goals = {
        name: (own, number)
        for own in line.alike
        if line.section.products is None
        for number, name in enumerate(own.with_goals, start=1)
    }
    for k, step in enumerate(assembly.steps, start=1):
        known: Any = {"name": step.name or f"step {k}", "after": step.after}
        if isinstance(step, Work):
            processes.append(_wanted_process(cell, step, {**known, "step": k}))
        elif isinstance(step, MachineWork):
            machine = section.processes[step.process].machine
            for part in step.parts:
                done = step.words, part, where[part], step.process, machine
                rests.append(ExpectedRest(*done, **known, step=k))
        elif step.stop is not None:
            frame = _fixture_frame(cell, step.stop.owner, step.stop.frame)
            where[step.part] = read_only_copy(frame @ step.stop.pose)
            rests.append(ExpectedRest(step.words, step.part, where[step.part], step=k))
        else:
            where[step.part] = assembly.goals[step.part]
            if step.part not in gone:
                words, shape = f"goal of step {k}", parts[step.part].shape_words
                of: tuple[str, ...] = ()
                if step.part in goals:
                    own, number = goals[step.part]
                    words, shape, of = (
                        f"goal {number} of {own.kind}",
                        own.kind,
                        own.names,
                    )
                place = WantedPlace(
                    words,
                    assembly.goals[step.part],
                    shape,
                    None if of else step.part,
                    any_of=frozenset(of),
                    held=step.hold is not None,
                    name=step.name,
                    after=step.after,
                )
                places.append(place)
    own_grips = [part.grips for part in section.parts if part.grips]
    return Expectations(
        tuple(places),
        "weight",
        section.touch_m,
        max([section.grips.opening_m, *(own.opening_m or 0.0 for own in own_grips)]),
        gripped_at=section.grips.frame,
        by_suction=frozenset(
            name for name in assembly.goals if assembly.handling(name).grips.suction
        ),
        processes=tuple(processes),
        joined=expand_pairs(joined_pairs(section), line.alike),
        overlaps_m={
            **overlaps_of(line.section).said,
            **expand_pairs(overlaps_of(section).said, line.alike),
        },
        rests=tuple(rests),
        doors=frozenset(job.door for job in line.jobs.values() if job.door),
        tools=tuple(_changed_tools(cell)),
        lags={
            (step.name or f"step {k}", lag.step): lag.least
            for k, step in enumerate(assembly.steps, start=1)
            for lag in step.lags
        },
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
                section.mount.transform(),
                section.rack.transform(),
                section.grip(name),
                first=name == robot.tools[0],
            )


def _fixture_frame(
    cell: CellSection, fixture: str | None, frame: str | None
) -> Transform:
    """Return the pose of a fixture of the file, or of one of its frames; None for the world."""
    for item in cell.fixtures:
        if item.name == fixture:
            inside = np.eye(4) if frame is None else item.frames[frame].transform()
            return np.asarray(item.pose.transform() @ inside)
    return np.eye(4)


def _wanted_process(cell: CellSection, step: Work, known: Any) -> ExpectedProcess:
    spot, tool = step.spot, step.process.tool
    owner, pose = spot.owner, spot.pose
    robots = step.robots
    if tool is not None:
        having = [r.name for r in cell.robots if tool in (r.tool, *r.tools)]
        robots = tuple(name for name in having if step.done_by(name))
    if any(item.name == owner for item in cell.fixtures):
        pose = _fixture_frame(cell, owner, spot.frame) @ pose
        owner = None
    return ExpectedProcess(
        words=step.words,
        process=step.process.name,
        owner=owner,
        pose=pose,
        path=step.process.path or (read_only_copy(np.eye(4)),),
        frame=step.process.frame,
        robots=robots,
        tool=tool,
        hold=step.hold,
        **known,
    )

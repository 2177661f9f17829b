"""Assemblies of parts of a scenario: from their section to data of planning, and to motions."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from planning.cell.workcell import CONTACT_DEPTH, CellObject, Workcell
from planning.expectations import ChangedTool, Expectations, WantedProcess, WantedRest
from planning.expectations import Place as WantedPlace
from planning.parts.assembly import MachineWork, PlacePart, Work
from planning.steps.tool_changes import with_every_tool
from planning.tasks.task import DOOR
from planning.transforms import Transform, readonly
from twin.document.validation import Found
from twin.document.yaml_text import KeyPath
from twin.durations.lifetimes import SkillOverride
from twin.host.progress import StageWatch
from twin.planning.build_workcell import build_shape, build_workcell
from twin.planning.kind import AssemblyKind, PlannedMotions
from twin.planning.part_assembly.alike import (
    alike_parts,
    listed_steps,
    of_each,
    with_named_parts,
)
from twin.planning.part_assembly.built import (
    assembly_of,
    joined_pairs,
    line_pattern,
    overlaps_of,
)
from twin.planning.part_assembly.fits import place_misses
from twin.planning.part_assembly.line import Line, machine_durations, written_out
from twin.planning.part_assembly.ordered_parts import OrderedParts
from twin.planning.part_assembly.problems import find_part_problems, machine_names
from twin.scenario.sections.cell import CellSection
from twin.scenario.sections.parts import PartSection, PartsSection
from twin.scenario.sections.scenario import Scenario
from twin.scenario.sections.shapes import as_planned, build_transform

if TYPE_CHECKING:
    from planning.motion.sequential import MotionSettings
    from planning.tasks.work import AssemblyWork, WorkAhead


_GREY_BLUE = (196, 214, 226)

_ROUNDING = 0.001
"""What is joined may be deeper in each other than its file says by this [m]."""

ORDERS = "orders tried"
"""Name of the stage for progress displays."""


@dataclass(frozen=True)
class PartKind(AssemblyKind):
    """An assembly of parts of a scenario.

    Attributes:
        section: what the file says.
        whole: whether all products are written out, and not those of a pattern only.
    """

    section: PartsSection
    whole: bool = False

    @property
    def line(self) -> Line:
        """The products that are planned."""
        return written_out(self.section, whole=self.whole)

    def written_out(self) -> PartKind:
        """Return the same with every product planned by itself."""
        return replace(self, whole=True)

    def steps(self) -> int:
        """Return the number of steps, of one product or of all."""
        return len(listed_steps(self.section)) * (self.products() if self.whole else 1)

    def wanted_steps(self) -> int:
        """Return the number of steps without those of spare products."""
        products = self.section.products
        spare = products.spare if products and self.whole else 0
        return self.steps() - spare * len(listed_steps(self.section))

    def products(self) -> int:
        """Return how many products are made; of those that are written out, with the spare ones."""
        products = self.section.products
        if products is None:
            return 1
        return products.count + (products.spare if self.whole else 0)

    def supply(self) -> str:
        """Return in words what there is to build with."""
        return f"{len(with_named_parts(self.section).parts)} parts"

    def names(self) -> Iterator[tuple[KeyPath, str]]:
        """Yield the names of the parts, each with its key."""
        for i, part in enumerate(self.section.parts):
            yield ("assembly", "parts", i, "name"), part.name
        where = {part.name: i for i, part in enumerate(self.section.parts)}
        for own in alike_parts(self.section):
            for name in own.names:
                yield ("assembly", "parts", where[own.kind], "name"), name
        yield from machine_names(self.section)

    def problems(self, cell: CellSection) -> Found:
        """Yield the problems of the section: steps and parts name what there is, no part twice."""
        return find_part_problems(self.section, cell)

    def object_kinds(self) -> Iterable[str]:
        """Return the types of the parts, each once."""
        return dict.fromkeys(part.shape_words for part in self.section.parts)

    def objects(self, folder: Path = Path()) -> tuple[CellObject, ...]:
        """Return the parts where they are at the start."""
        return _objects(self.line, folder)

    def machines(self) -> tuple[str, ...]:
        """Return the machines of sources, those that work, and what takes products away."""
        return self.line.machines()

    def machine_durations(self) -> tuple[SkillOverride, ...]:
        """Return how long these take for their tasks."""
        return machine_durations(self.section)

    def due(self) -> tuple[tuple[float, ...], int | None]:
        """Return when each product is due [s], and how many at the beginning do not count."""
        products = self.section.products
        return ((), None) if products is None else (products.due_s(), products.start_up)

    def contact_depth(self) -> float:
        """Return how deep they may be: bars that are joined may meet in a node [m]."""
        said = overlaps_of(self.section).said.values()
        return max([CONTACT_DEPTH, *(deep + _ROUNDING for deep in said)])

    def wanted(self, cell: CellSection) -> Expectations:
        """Return the goals of the parts, the processes, and how far fingers stand open."""
        return _wanted(self.section, cell)

    def place_misses(self, scenario: Scenario, folder: Path) -> Mapping[str, float]:
        """Return how likely robots whose repeatability is stated miss the places of parts."""
        robots = scenario.cell.robots
        if not any(robot.repeatability_m for robot in robots):
            return {}
        cell = with_every_tool(build_workcell(scenario, folder))
        return place_misses(OrderedParts(cell, self.section), robots)

    def plan(
        self, cell: Workcell, settings: MotionSettings, watch: StageWatch
    ) -> PlannedMotions:
        """Find the candidates, choose, and plan one task after another."""
        from twin.planning.goals import plan_in_turns

        assembly, work = self._work(cell, watch)
        return self.finished(plan_in_turns(cell, assembly, work, settings, watch))

    def ahead(self, cell: Workcell, watch: StageWatch) -> WorkAhead:
        """Return the work of any number of products, looked at when they are planned; see ``AssemblyKind``.

        All are looked at beforehand where that is one search, so only for the sake of spare ones.
        """
        from planning.parts.candidates import StepsAhead
        from planning.parts.work import first_work
        from planning.tasks.work import WorkAhead
        from twin.planning.goals import ASSIGNMENT

        section, period = self.section, len(listed_steps(self.section))
        first: Callable[[int], AssemblyWork]
        assembly, spare = assembly_of(self.line), self.wanted_steps() < self.steps()
        searched = section.order == "find" or bool(assembly.alike)
        if not spare and (searched or self.line.products == 1):
            return super().ahead(cell, watch)
        if searched:
            first = self._work(cell, watch)[1].of_first
        else:
            with watch.stage("assignment", ASSIGNMENT):
                first = partial(first_work, StepsAhead(cell, assembly))
        return WorkAhead(self.steps(), first, self.wanted_steps(), period)

    def _work(self, cell: Workcell, watch: StageWatch) -> tuple[Any, AssemblyWork]:
        """Return what is built, and its work."""
        from planning.parts.alike import find_alike_candidates
        from planning.parts.candidates import find_candidates
        from planning.parts.order import find_ordered_candidates, in_found_order
        from planning.parts.work import part_work
        from twin.planning.goals import ASSIGNMENT

        assembly = assembly_of(self.line)
        with watch.stage("assignment", ASSIGNMENT):
            if self.section.order == "find":
                find = partial(find_ordered_candidates, progress=watch.reporter(ORDERS))
                found = find_alike_candidates(cell, assembly, find, in_found_order)
            else:
                found = find_alike_candidates(cell, assembly, find_candidates)
            work = part_work(found)
        return found.assembly if assembly.alike else assembly, work

    def finished(self, motions: PlannedMotions) -> PlannedMotions:
        """Return motions with the way in which they go on, and which tasks are for which product."""
        line = self.line
        if line.products == 1 or self.whole:
            return motions
        pattern = line_pattern(line, motions.motion_plan.tasks)
        return replace(motions, pattern=pattern)


def _wanted(section: PartsSection, cell: CellSection) -> Expectations:
    """Return the goals of the parts, where they lie on their way, and what is done to them."""
    line = written_out(section, whole=True)
    assembly, parts = assembly_of(line), {p.name: p for p in line.section.parts}
    gone = {
        name for leaving in line.supply.leaves.values() for name, _ in leaving.parts
    }
    where = {k: build_transform(p.start) for k, p in parts.items() if p.start}
    if section.order == "find":  # then all is done at parts in their places
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
            lies = where[step.part]
            machine = section.processes[step.process].machine
            done = step.words, step.part, lies, step.process, machine
            rests.append(WantedRest(*done, **known, step=k))
        elif step.stop is not None:
            frame = _fixture_frame(cell, step.stop.owner, step.stop.frame)
            where[step.part] = readonly(frame @ step.stop.pose)
            rests.append(WantedRest(step.words, step.part, where[step.part], step=k))
        else:
            where[step.part] = assembly.goals[step.part]
            if step.part not in gone:
                words, kind = f"goal of step {k}", parts[step.part].shape_words
                of: tuple[str, ...] = ()
                if step.part in goals:
                    own, number = goals[step.part]
                    words, kind, of = (
                        f"goal {number} of {own.kind}",
                        own.kind,
                        own.names,
                    )
                place = WantedPlace(
                    words,
                    assembly.goals[step.part],
                    kind,
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
        joined=of_each(joined_pairs(section), line.alike),
        overlaps_m={
            **overlaps_of(line.section).said,
            **of_each(overlaps_of(section).said, line.alike),
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
                build_transform(section.mount),
                build_transform(section.rack),
                section.grip(name),
                first=name == robot.tools[0],
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


def _wanted_process(cell: CellSection, step: Work, known: Any) -> WantedProcess:
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
        **known,
    )


def _objects(line: Line, folder: Path) -> tuple[CellObject, ...]:
    parts = (_part(part, line, folder) for part in line.section.parts)
    return (*parts, *_doors(line, folder))


def _doors(line: Line, folder: Path) -> Iterator[CellObject]:
    """Yield the doors of machines, one for every time that one is shut."""
    for job in line.jobs.values():
        door = line.section.machines[job.machine].door if job.door else None
        if job.door is None or door is None:
            continue
        shape = build_shape(job.door, door.described, folder)
        pose = readonly(build_transform(door.pose))
        yield CellObject(
            job.door, DOOR, shape, pose, fixed=True, colour=_GREY_BLUE, later=True
        )


def _part(part: PartSection, line: Line, folder: Path) -> CellObject:
    shape = build_shape(part.name, part.described, folder)
    if part.centre_of_mass_m is not None:
        shape = replace(shape, own_centre=readonly(part.centre_of_mass_m))
    spare = [name for own in line.alike if own.goals for name in own.names]
    return as_planned(
        CellObject,
        part,
        kind=part.shape_words,
        shape=shape,
        mass=part.mass_kg or (part.density_kg_m3 or 0.0) * shape.volume,
        fixed=not {*line.section.placed, *line.numbers, *spare} & {part.name},
        later=part.name in line.later,
    )

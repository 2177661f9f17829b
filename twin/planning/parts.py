"""Assemblies of parts of a scenario: from their section to data of planning, and to motions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from planning.cell.workcell import CellObject, Workcell
from planning.parts.assembly import GripRules, PartAssembly, PartWays
from planning.parts.steps import Place, Process, Work
from planning.statics.joined import BalanceRules, Joined
from planning.statics.standing import Joint, StandingRules
from planning.tasks.supplies import supplied_work
from planning.transforms import Transform, readonly
from twin.audit.wanted import Place as WantedPlace
from twin.audit.wanted import Wanted, WantedProcess
from twin.durations import SkillOverride
from twin.host.progress import StageWatch
from twin.planning.build_shape import build_shape
from twin.planning.kind import AssemblyKind, PlannedMotions
from twin.planning.line.problems import check_line, machine_names
from twin.planning.line.written_out import Line, machine_durations, written_out
from twin.planning.part_problems import check_steps
from twin.scenario.document.problems import Problem, mark_problems
from twin.scenario.document.section import plain_values
from twin.scenario.document.yaml_text import KeyPath, YamlDocument
from twin.scenario.sections.cell import CellSection
from twin.scenario.sections.parts import (
    GripSection,
    PartSection,
    PartsSection,
    PlaceOfWork,
    StepSection,
)
from twin.scenario.sections.poses import build_transform

if TYPE_CHECKING:
    from planning.motion.sequential import MotionSettings


ORDERS = "orders tried"
"""Name of the stage for progress displays."""


@dataclass(frozen=True)
class PartKind(AssemblyKind):
    """An assembly of parts of a scenario.

    Attributes:
        section: what the file says.
    """

    section: PartsSection

    def steps(self) -> int:
        """Return the number of steps."""
        return len(self.section.steps)

    def supply(self) -> str:
        """Return in words what there is to build with."""
        return f"{len(self.section.parts)} parts"

    def names(self) -> Iterator[tuple[KeyPath, str]]:
        """Yield the names of the parts, each with its key."""
        for i, part in enumerate(self.section.parts):
            yield ("assembly", "parts", i, "name"), part.name
        yield from machine_names(self.section)

    def problems(self, document: YamlDocument) -> list[Problem]:
        """Return the problems of the section: steps and parts name what there is, no part twice."""
        found = (*check_steps(self.section), *check_line(self.section))
        return mark_problems(document, found)

    def object_kinds(self) -> Iterable[str]:
        """Return the types of the parts, each once."""
        return dict.fromkeys(part.shape_words for part in self.section.parts)

    def objects(self, folder: Path = Path()) -> tuple[CellObject, ...]:
        """Return the parts where they are at the start."""
        line = written_out(self.section)
        placed = (*line.section.placed, *line.numbers)
        parts = (_part(part, placed, folder) for part in line.section.parts)
        return tuple(replace(part, later=part.name in line.later) for part in parts)

    def machines(self) -> tuple[str, ...]:
        """Return the machines of sources, and of what takes products away."""
        return written_out(self.section).machines()

    def machine_durations(self) -> tuple[SkillOverride, ...]:
        """Return how long these take for their tasks."""
        return machine_durations(self.section)

    def due(self) -> tuple[tuple[float, ...], int | None]:
        """Return when each product is due [s], and how many at the beginning do not count."""
        products = self.section.products
        return ((), None) if products is None else (products.due_s(), products.start_up)

    def products(self) -> int:
        """Return the number of products."""
        return written_out(self.section).products

    def wanted(self, cell: CellSection) -> Wanted:
        """Return the goals of the parts, the processes, and how far fingers stand open."""
        line, section = written_out(self.section, whole=True), self.section
        assembly = _build_assembly(line)
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
            if isinstance(step, Place) and step.part not in gone
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
            joined=frozenset(frozenset(item.parts) for item in section.joined),
        )

    def plan(
        self, cell: Workcell, settings: MotionSettings, watch: StageWatch
    ) -> PlannedMotions:
        """Find the candidates, choose, and plan one task after another."""
        from planning.parts.candidates import find_candidates
        from planning.parts.expansion import part_work
        from planning.parts.order import find_ordered_candidates
        from twin.planning.in_turns import ASSIGNMENT, plan_in_turns

        line = written_out(self.section)
        assembly = _build_assembly(line)
        with watch.stage("assignment", ASSIGNMENT):
            found = (
                find_ordered_candidates(cell, assembly, watch.reporter(ORDERS))
                if self.section.order == "find"
                else find_candidates(cell, assembly)
            )
            work = supplied_work(part_work(found), line.supply)
        return self.finished(plan_in_turns(cell, assembly, work, settings, watch))

    def finished(self, motions: PlannedMotions) -> PlannedMotions:
        """Return motions with the way in which they go on for further products."""
        from twin.planning.line.pattern import line_pattern

        line = written_out(self.section)
        if not line.repeats:
            return motions
        pattern = line_pattern(line, motions.motion_plan.tasks)
        return replace(motions, pattern=pattern)


def _wanted_process(cell: CellSection, step: Work, number: int) -> WantedProcess:
    owner, pose = step.owner, step.pose
    for fixture in cell.fixtures:
        if fixture.name == owner:
            frame = fixture.frames.get(step.frame) if step.frame else None
            inside = np.eye(4) if frame is None else build_transform(frame)
            owner = None
            pose = build_transform(fixture.pose) @ inside @ step.pose
    return WantedProcess(
        words=step.words,
        process=step.process.name,
        owner=owner,
        pose=pose,
        path=step.process.path or (readonly(np.eye(4)),),
        frame=step.process.frame,
        robots=step.robots,
        hold=step.hold,
        name=step.name or f"step {number}",
        after=step.after,
    )


def build_assembly(section: PartsSection) -> PartAssembly:
    """Return goals, steps, grips and supplies of a section, its products written out."""
    return _build_assembly(written_out(section))


def _build_assembly(line: Line) -> PartAssembly:
    section = line.section
    grips = _grip_rules(section.grips)
    return PartAssembly(
        goals={
            part.name: readonly(build_transform(part.goal))
            for part in section.parts
            if part.goal is not None
        },
        steps=tuple(_step(section, step) for step in section.steps),
        grips=grips,
        own_ways={
            part.name: _ways(part, section, grips)
            for part in section.parts
            if not _ordinary(part)
        },
        **plain_values(
            section,
            without=(
                *("kind", "parts", "sources", "products", "processes"),
                *("steps", "order", "grips", "balance", "joined"),
            ),
        ),
        balance=_balance(section),
        supply=line.supply,
    )


def _balance(section: PartsSection) -> BalanceRules | None:
    """Return what an assembly must stand by; None where that is not looked at."""
    own = section.balance
    if not own.check:
        return None
    rules = StandingRules(own.friction, np.deg2rad(own.tilt_deg), section.touch_m)
    joined = (
        Joined(
            Joint(first, second, item.force_n or np.inf, item.torque_nm or np.inf),
            item.by,
        )
        for item in section.joined
        for first, second in [item.parts]
    )
    return BalanceRules(rules, tuple(joined))


def _grip_rules(section: GripSection) -> GripRules:
    values = plain_values(section)
    values["directions"] = tuple(_unit(d) for d in values["directions"])
    return GripRules(**values)


def _ordinary(part: PartSection) -> bool:
    """Tell whether a part is handled as the assembly says."""
    own = (part.grips, part.approach_m, part.leave_m)
    down, up = (0.0, 0.0, -1.0), (0.0, 0.0, 1.0)
    return own == (None,) * 3 and (part.insert, part.take_out) == (down, up)


def _ways(part: PartSection, section: PartsSection, rules: GripRules) -> PartWays:
    """Return how one part is handled: as it says, else as the assembly says."""
    if part.grips is not None:
        given = plain_values(part.grips)
        own = {key: value for key, value in given.items() if value is not None}
        if "directions" in own:
            own["directions"] = tuple(_unit(d) for d in own["directions"])
        rules = replace(rules, **own)
    return PartWays(
        rules,
        part.approach_m or section.approach_m,
        part.leave_m or section.leave_m,
        _unit(part.insert),
        _unit(part.take_out),
    )


def _unit(direction: Sequence[float]) -> tuple[float, float, float]:
    x, y, z = (np.asarray(direction) / np.linalg.norm(direction)).tolist()
    return x, y, z


def _step(section: PartsSection, step: StepSection) -> Place | Work:
    if step.place is not None:
        return Place(
            name=step.known_as,
            after=step.after,
            robots=step.robots,
            hold=step.hold,
            part=step.place,
        )
    assert step.process is not None
    assert step.at is not None
    owner = step.at.part or step.at.fixture
    frames = {part.name: part.frames for part in section.parts}
    pose: Transform = np.eye(4)
    if step.at.part is not None and step.at.frame is not None:
        pose = build_transform(frames[step.at.part][step.at.frame])
    if step.at.pose is not None:
        pose = pose @ build_transform(step.at.pose)
    return Work(
        name=step.name,
        after=step.after,
        robots=step.robots,
        hold=step.hold,
        process=_process(section, step),
        at=_words(step.at),
        owner=owner,
        frame=step.at.frame if step.at.fixture is not None else None,
        pose=readonly(pose),
    )


def _process(section: PartsSection, step: StepSection) -> Process:
    """Return the process of a step, with what the step says of it."""
    assert step.process is not None
    own = section.processes[step.process]
    turn = own.turn_deg if step.turn_deg is None else step.turn_deg
    turns = np.arange(own.turns) * 360.0 / own.turns if turn is None else [turn]
    path = own.path if step.path is None else step.path
    return Process(
        name=step.process,
        tool=own.tool,
        frame=own.frame,
        approach=own.approach_m,
        path=tuple(readonly(build_transform(pose)) for pose in path),
        turns=tuple(np.deg2rad(turns).tolist()),
    )


def _words(at: PlaceOfWork) -> str:
    """Return a place of work in words: its owner and frame, else where it is."""
    named = [name for name in (at.part or at.fixture, at.frame) if name is not None]
    if at.pose is not None and at.frame is None:
        named.append("(" + ", ".join(f"{v:g}" for v in at.pose.xyz_m) + ")")
    return "/".join(named)


def _part(part: PartSection, steps: tuple[str, ...], folder: Path) -> CellObject:
    assert part.start is not None
    red, green, blue = part.colour
    return CellObject(
        name=part.name,
        kind=part.shape_words,
        shape=build_shape(part.name, part.described, folder),
        start=readonly(build_transform(part.start)),
        mass=part.mass_kg,
        fixed=part.name not in steps,
        colour=(red, green, blue),
    )

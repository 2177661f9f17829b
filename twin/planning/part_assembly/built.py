"""Assemblies of parts of a scenario: from their section to data of planning.

The pattern of a line, from the tasks of the products that were planned, and plans for all of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from planning.contacts.precedence import Overlaps
from planning.errors import PlanInvariantError
from planning.parts.assembly import (
    AnyStep,
    GripRules,
    MachineWork,
    PartAssembly,
    PartHandling,
    PlacePart,
    Process,
    StopOnTheWay,
    Work,
)
from planning.statics.standing import BalanceRules, Joined, Joint, StandingRules
from planning.tasks.task import ARRIVE, LEAVE, PRESENT, Task
from planning.tasks.work import buffers_of, is_done_to_a_product
from planning.transforms import Transform, readonly
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.repeat import Pattern, numbered, repeat_graph
from twin.host.progress import StageWatch
from twin.planning.part_assembly.line import Line, MachineJob, written_out
from twin.run.policies import IN_TURNS, SHORTENED
from twin.scenario.sections.parts import (
    GripSection,
    PartGripSection,
    PartSection,
    PartsSection,
    PlaceOfWork,
    StepSection,
)
from twin.scenario.sections.shapes import build_transform, plain_values


def build_assembly(section: PartsSection) -> PartAssembly:
    """Return goals, steps, grips and supplies of a section, its products written out."""
    return assembly_of(written_out(section))


def assembly_of(line: Line) -> PartAssembly:
    """Return goals, steps, grips and supplies of what is written out."""
    section = line.section
    grips = GripRules(**_grip_rules(section.grips))
    return PartAssembly(
        goals={
            part.name: readonly(build_transform(part.goal))
            for part in section.parts
            if part.goal is not None
        },
        steps=tuple(
            _step(section, step, line.jobs.get(number))
            for number, step in enumerate(section.steps, start=1)
        ),
        grips=grips,
        own_handling={
            part.name: _ways(part, section, grips)
            for part in section.parts
            if not _ordinary(part)
        },
        **plain_values(
            section,
            without=(
                *("kind", "parts", "sources", "products", "processes"),
                *("machines", "steps", "order", "grips", "balance", "joined"),
                "joined_overlap_m",
            ),
        ),
        balance=_balance(section),
        overlaps=Overlaps(frozenset(joined_pairs(section)), section.joined_overlap_m),
        supply=line.supply,
    )


def joined_pairs(section: PartsSection) -> dict[frozenset[str], float]:
    """Return the pairs that are joined, each with the room between the two [m]."""
    return {frozenset(item.parts): item.gap_m for item in section.joined}


def _balance(section: PartsSection) -> BalanceRules | None:
    """Return what an assembly must stand by; None where that is not looked at."""
    own = section.balance
    if not own.check:
        return None
    rules = StandingRules(own.friction, np.deg2rad(own.tilt_deg), section.touch_m)
    joined = (
        Joined(
            Joint(
                first,
                second,
                item.force_n or np.inf,
                item.torque_nm or np.inf,
                item.gap_m,
            ),
            item.by,
        )
        for item in section.joined
        for first, second in [item.parts]
    )
    return BalanceRules(rules, tuple(joined))


def _grip_rules(section: GripSection | PartGripSection) -> dict[str, Any]:
    values = plain_values(section)
    if "directions" in values:
        values["directions"] = tuple(_unit(d) for d in values["directions"])
    return values


def _ordinary(part: PartSection) -> bool:
    """Tell whether a part is handled as the assembly says."""
    own = (part.grips, part.approach_m, part.leave_m)
    down, up = (0.0, 0.0, -1.0), (0.0, 0.0, 1.0)
    return own == (None,) * 3 and (part.insert, part.take_out) == (down, up)


def _ways(part: PartSection, section: PartsSection, rules: GripRules) -> PartHandling:
    """Return how one part is handled: as it says, else as the assembly says."""
    if part.grips is not None:
        rules = replace(rules, **_grip_rules(part.grips))
    return PartHandling(
        rules,
        part.approach_m or section.approach_m,
        part.leave_m or section.leave_m,
        _unit(part.insert),
        _unit(part.take_out),
    )


def _unit(direction: Sequence[float]) -> tuple[float, float, float]:
    x, y, z = (np.asarray(direction) / np.linalg.norm(direction)).tolist()
    return x, y, z


def _step(section: PartsSection, step: StepSection, job: MachineJob | None) -> AnyStep:
    if step.place is not None:
        return PlacePart(
            name=step.known_as,
            after=step.after,
            robots=step.robots,
            hold=step.hold,
            part=step.place,
            until=step.until,
            stop=None if step.at is None else _stop(step.at),
        )
    assert step.process is not None
    assert step.at is not None
    if job is not None:
        assert step.at.part is not None
        return MachineWork(
            name=step.name,
            after=step.after,
            process=step.process,
            machine=job.machine,
            part=step.at.part,
            door=job.door,
        )
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


def _stop(at: PlaceOfWork) -> StopOnTheWay:
    pose = np.eye(4) if at.pose is None else build_transform(at.pose)
    return StopOnTheWay(_words(at), at.fixture, at.frame, readonly(pose))


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


def line_pattern(line: Line, tasks: Sequence[Task]) -> Pattern:
    """Return how the plan of some products goes on.

    Args:
        line: what was planned.
        tasks: of the plan, in order.
    """
    steps = len(line.section.steps) // line.period
    product = np.array(
        [
            line.numbers[str(task.object)][1]
            if task.kind in (ARRIVE, PRESENT)
            else (task.step - 1) // steps + 1
            for task in tasks
        ],
        dtype=np.int64,
    )
    lags = sorted(set(_lags(line, tasks)))
    return Pattern(
        line.products,
        line.period,
        product,
        np.array(lags, dtype=np.int64).reshape(-1, 3),
        line.numbers,
    )


def _lags(line: Line, tasks: Sequence[Task]) -> Iterator[tuple[int, int, int]]:
    """Yield what waits for what in an earlier copy."""
    # A part that is put down on its way is picked again: it has left the source by then.
    picks = {t.object: t.index for t in reversed(tasks) if t.kind == "pick"}
    come: dict[str, list[int]] = {}
    arrive: dict[str, list[int]] = {}
    leave: list[int] = []
    first: list[int] = []
    for task in tasks:
        if task.kind == PRESENT:
            come.setdefault(task.robot, []).append(task.index)
            for handling in task.handlings:
                part, number = line.numbers[handling.object]
                if number > line.period:
                    own = numbered(part, number - line.period)
                    yield task.index, picks[own], 1
        elif task.kind == ARRIVE:
            arrive.setdefault(task.robot, []).append(task.index)
        elif task.kind == LEAVE:
            leave.append(task.index)
        elif leave or task.step in line.supply.elsewhere:
            continue
        elif is_done_to_a_product(task):
            first.append(task.index)
    if leave:
        yield from ((leave[-1], task, 1) for task in first)
    for conveyor, (machine, buffer) in buffers_of(line.supply).items():
        before = come.get(machine, [])
        for k, task_index in enumerate(arrive.get(conveyor, [])):
            earlier = k - 1 - buffer
            if earlier < 0:
                lag = -(earlier // len(before))
                yield before[earlier % len(before)], task_index, lag


PRODUCTS = "all products"
"""Name of the stage for progress displays."""


def repeated_plans(
    plans: Mapping[str, TemporalPlanGraph], pattern: Pattern | None, watch: StageWatch
) -> dict[str, TemporalPlanGraph]:
    """Return plans for all products, the given ones where these are that already.

    Args:
        plans: by their names in twin.run.policies, that in turns before the shortened one.
        pattern: how they go on, None where they do not.
        watch: measures the stage, which is products.

    Raises:
        PlanInvariantError: what one product is made by is in the way of the next.
    """
    if pattern is None:
        return dict(plans)
    found: dict[str, TemporalPlanGraph] = {}
    with watch.stage("products", PRODUCTS):
        for name, tpg in plans.items():
            try:
                found[name] = repeat_graph(tpg, pattern)
            except PlanInvariantError:
                # A shorter way of one product is in the way of the next; HOME never is.
                if name != SHORTENED or IN_TURNS not in found:
                    raise
                found[name] = found[IN_TURNS]
    return found

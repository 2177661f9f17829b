"""Conversion of the scenario section of an assembly of parts to planning data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from planning.contacts.interference import Overlaps
from planning.grips.grip import GripRules
from planning.parts.assembly import (
    AnyStep,
    MachineWork,
    PartAssembly,
    PartHandling,
    PlacePart,
    Process,
    Spot,
    TimeLag,
    Work,
)
from planning.statics.standing_rules import Joint, StandingRules
from planning.transforms import Transform, read_only_copy
from twin.kinds.parts.line import Line, MachineJob
from twin.kinds.parts.section import (
    PartGripSection,
    PartSection,
    PartsSection,
    PlaceOfWork,
    StepSection,
)
from twin.scenario.sections.shapes import plain_values, to_planning_class


def assembly_of(line: Line) -> PartAssembly:
    """Return goals, steps, grips and supplies of an expanded section."""
    section = line.section
    usual = to_planning_class(
        PartHandling, section, grips=_grip_rules(section.grips, GripRules())
    )
    return to_planning_class(
        PartAssembly,
        section,
        goals={
            part.name: read_only_copy(part.goal.transform())
            for part in section.parts
            if part.goal is not None
        },
        steps=tuple(
            _step(section, step, line.jobs.get(number), line.lags.get(number, ()))
            for number, step in enumerate(section.steps, start=1)
        ),
        usual=usual,
        own={part.name: _handling(part, usual) for part in section.parts},
        balance=_balance(section),
        overlaps=overlaps_of(section),
        supply=line.supply,
        alike=tuple(own.names for own in line.alike if own.goals and not own.sourced),
        returns=line.products > line.period,
    )


def overlaps_of(section: PartsSection) -> Overlaps:
    """Return the allowed overlaps of joined and of press-fitted parts."""
    joined = frozenset(joined_pairs(section))
    said = dict.fromkeys(joined, section.joined_overlap_m)
    for fit in section.fits:
        pair = frozenset(fit.parts)
        said[pair] = max(fit.press_m, said.get(pair, 0.0))
    return Overlaps(said, joined, section.joined_overlap_m)


def joined_pairs(section: PartsSection) -> dict[frozenset[str], float]:
    """Return the joined pairs with their gaps [m]."""
    return {frozenset(item.parts): item.gap_m for item in section.joined}


def _balance(section: PartsSection) -> StandingRules | None:
    """Return the statics settings of an assembly; None without a balance check."""
    own = section.balance
    if not own.check:
        return None
    joints = (
        to_planning_class(Joint, item, first=first, second=second)
        for item in section.joined
        for first, second in [item.parts]
    )
    return to_planning_class(
        StandingRules, own, touch=section.touch_m, joints=tuple(joints)
    )


def _grip_rules(section: PartGripSection, rules: GripRules) -> GripRules:
    """Return grip rules overridden by a section."""
    values = plain_values(section)
    for key in ("close_s", "open_s"):
        values.pop(key, None)  # when, not where: execution asks for them
    if section.directions is not None:
        values["directions"] = tuple(map(_unit, section.directions))
    return replace(rules, **values)


def _handling(part: PartSection, usual: PartHandling) -> PartHandling:
    """Return the handling of a part: its own settings, else the assembly's."""
    rules = usual.grips
    if part.grips is not None:
        rules = _grip_rules(part.grips, rules)
    return PartHandling(
        rules,
        part.approach_m or usual.approach,
        part.leave_m or usual.leave,
        _unit(part.insert),
        _unit(part.take_out),
    )


def _unit(direction: Sequence[float]) -> tuple[float, float, float]:
    x, y, z = (np.asarray(direction) / np.linalg.norm(direction)).tolist()
    return x, y, z


def _step(
    section: PartsSection,
    step: StepSection,
    job: MachineJob | None,
    lags: tuple[TimeLag, ...],
) -> AnyStep:
    at = step.at
    when: Any = {"after": tuple(x.step for x in step.follows), "lags": lags}
    if step.place is not None:
        stop = None if at is None else _spot(section, at)
        about = {"name": step.known_as, "part": step.place}
        return to_planning_class(PlacePart, step, stop=stop, **about, **when)
    assert at is not None
    if job is not None:
        parts = job.parts or (at.part,)
        own: Any = {"machine": job.machine, "parts": parts, "door": job.door}
        return to_planning_class(MachineWork, step, **own, **when)
    return to_planning_class(
        Work, step, process=_process(section, step), spot=_spot(section, at), **when
    )


def _spot(section: PartsSection, at: PlaceOfWork) -> Spot:
    """Return a place of work; frames of parts are poses in the part's own frame."""
    pose: Transform = np.eye(4)
    if at.part is not None and at.frame is not None:
        frames = {part.name: part.frames for part in section.parts}
        pose = frames[at.part][at.frame].transform()
    if at.pose is not None:
        pose = pose @ at.pose.transform()
    frame = at.frame if at.fixture is not None else None
    return Spot(_words(at), at.part or at.fixture, frame, read_only_copy(pose))


def _process(section: PartsSection, step: StepSection) -> Process:
    """Return the process of a step, with the step's settings."""
    assert step.process is not None
    own = section.processes[step.process]
    turn = own.turn_deg if step.turn_deg is None else step.turn_deg
    turns = np.arange(own.turns) * 360.0 / own.turns if turn is None else [turn]
    path = own.path if step.path is None else step.path
    return to_planning_class(
        Process,
        own,
        name=step.process,
        path=tuple(read_only_copy(pose.transform()) for pose in path),
        turns=tuple(np.deg2rad(turns).tolist()),
    )


def _words(at: PlaceOfWork) -> str:
    """Return a text on a place of work: owner and frame, else position."""
    named = [name for name in (at.part or at.fixture, at.frame) if name is not None]
    if at.pose is not None and at.frame is None:
        named.append("(" + ", ".join(f"{v:g}" for v in at.pose.xyz_m) + ")")
    return "/".join(named)

"""Spare parts: interchangeable parts that can replace a lost one."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace

import numpy as np

from planning.cell.workcell import Attachment
from planning.errors import InfeasibleStepError
from planning.handling.tool_changes import with_tools
from planning.parts.alike import with_renamed_parts
from planning.parts.candidates import PartCandidates, PartCollector
from planning.parts.part_steps import KnownStep, PartStep, place_step
from planning.tasks.assignment import NO_TOOLS

_MOST = 6
"""Greatest number of spare parts for one step: those nearest to the lost one."""


def with_spares(
    candidates: PartCandidates, number: int, present: Collection[str]
) -> PartCandidates | None:
    """Return candidates with spare parts for a step, None where there are no others.

    The part of the step is lost. Steps with held parts, or with parts from a source, have no spares.

    Args:
        candidates: candidates of all steps. number: number of the step, from 1.
        present: parts that lie where they were at the start.
    """
    step, assembly = candidates.steps[number - 1], candidates.assembly
    if not isinstance(step, PartStep) or step.held or candidates.paths.keeps:
        return None
    cell, lost = with_tools(candidates.cell, NO_TOOLS), step.part
    group = next((own for own in assembly.alike if lost.name in own), ())
    free = set(group) - assembly.goals.keys()
    known = {name for k, name in candidates.spares if k == number}

    def far(name: str) -> tuple[float, str]:
        away = cell.object(name).start[:3, 3] - lost.start[:3, 3]
        return float(np.linalg.norm(away)), name

    spares, primaries = dict(candidates.spares), list(candidates.problem.primaries)
    paths = candidates.paths
    for name in sorted((set(present) & free) - known, key=far)[:_MOST]:
        around = {
            **step.around,
            name: (cell.object(name), Attachment(None, cell.object(name).start)),
        }
        placing = replace(step.step, part=name)
        other = with_renamed_parts(assembly, {lost.name: name})
        try:
            own = place_step(cell, other, number, placing, replace(step, around=around))
        except InfeasibleStepError:
            continue
        steps = [own if k == number - 1 else s for k, s in enumerate(candidates.steps)]
        collector = PartCollector(candidates.cell, other, steps, {})
        collector.add(number, own)
        if collector.primaries:
            spares[number, name] = own
            primaries += collector.primaries
            found = collector.paths
            paths = replace(
                paths,
                unpaired={**paths.unpaired, **found.unpaired},
                tries={**paths.tries, **found.tries},
                relays={**paths.relays, **found.relays},
            )
    if len(spares) == len(candidates.spares):
        return None
    problem = replace(candidates.problem, primaries=tuple(primaries))
    return replace(candidates, problem=problem, paths=paths, spares=spares)


def with_chosen_spares(
    candidates: PartCandidates, objects: Iterable[tuple[int, str | None]]
) -> PartCandidates:
    """Return candidates in which the chosen spare parts replace the parts of their steps.

    Args:
        candidates: of all steps.
        objects: numbers of steps, each with the part that it places; others are not looked at.
    """
    if not candidates.spares:
        return candidates
    own = {
        number: candidates.spares[number, name]
        for number, name in objects
        if name is not None and (number, name) in candidates.spares
    }
    if not own:
        return candidates
    names = dict[str, str]()
    for number, spare in own.items():
        step = candidates.steps[number - 1]
        assert isinstance(step, PartStep)
        names[step.part.name] = spare.part.name
    items = {item.name: item for item in candidates.cell.objects}
    steps = list[KnownStep]()
    for number, known in enumerate(candidates.steps, start=1):
        step = own.get(number, known)
        # Where a spare part was it is no more, and in its place it has its own name.
        around = {
            names.get(k, k): (items[names[k]] if k in names else item, at)
            for k, (item, at) in step.around.items()
            if k not in names.values()
        }
        touched = {names.get(k, k): gap for k, gap in step.touched.items()}
        steps.append(replace(step, touched=touched, around=around))
    paths = replace(candidates.paths, steps=steps)
    return replace(candidates, steps=tuple(steps), paths=paths)

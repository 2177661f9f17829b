"""Checks of what a scenario says of rejected parts: the steps that are done again, and the bin."""

from __future__ import annotations

from twin.document.validation import Problems, check_known_name
from twin.kinds.parts.section import PartsSection
from twin.scenario.sections.cell import CellSection
from twin.scenario.sections.execution import ExecutionSection


def find_reject_problems(
    section: PartsSection, execution: ExecutionSection, cell: CellSection
) -> Problems:
    """Yield problems of the bin, and steps that are not done again when a process fails."""
    place, at = execution.recovery.bin, ("execution", "recovery", "bin")
    if place is not None and place != "person":
        known, name = [item.name for item in cell.fixtures], place.fixture
        yield from check_known_name((*at, "fixture"), "fixture", name, known)
        if any(robot.tools for robot in cell.robots):
            yield at, "robots that change tools put nothing into a bin (valid: person)"
    variants = section.products.variants if section.products else {}
    made = [section.of_variant(variant) for variant in variants] or [section]
    for skill, said in execution.failures.items():
        again = (
            name
            for own in made
            for k, step in enumerate(own.steps)
            if step.process == skill
            for name in _done_again(own, k)
        )
        valid = tuple(dict.fromkeys(again))
        for i, name in enumerate(said.named):
            if name not in valid:
                key = ("execution", "failures", skill, "rework", "steps", i)
                words = f"{name} is no step that works at what {skill} rejects, before that and where it lies"
                yield key, f"{words} (valid: {', '.join(valid) or 'none'})"


def _done_again(section: PartsSection, number: int) -> list[str]:
    """Return the names of the processes done to the part of a step before it, since that came to its place.

    Where the order is found, those done to it at any time. What was behind a door has come again.
    """
    checked, listed = section.steps[number], section.order == "listed"
    part, found = checked.at and checked.at.part, list[str]()
    for step in section.steps[:number] if listed else section.steps:
        process = section.processes.get(step.process or "")
        machine = section.machine_of(step)
        if process is None:
            came = step.place == part
        elif step is checked or (step.at and step.at.part) != part:
            continue
        else:
            came = machine is not None and machine.door is not None
        if came and listed:
            found = []
        elif not came and process is not None and step.name is not None:
            found.append(step.name)
    return found

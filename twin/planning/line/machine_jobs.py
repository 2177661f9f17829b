"""Machines that work at parts of a scenario: which of them does which step, behind which door."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from scheduling.repetition.pattern import numbered
from twin.scenario.sections.parts import PartsSection


@dataclass(frozen=True)
class MachineJob:
    """A step that is done without a robot.

    Attributes:
        machine: whose task it is; what nobody does has a chain of its own for every step.
        door: name of the object that is its door for as long as it works, None for none.
        part: what this door is called in every product, None for none.
        product: for which product it works, from 1.
    """

    machine: str
    door: str | None = None
    part: str | None = None
    product: int = 1


def machine_jobs(section: PartsSection, period: int) -> Mapping[int, MachineJob]:
    """Return what does the steps that no robot does, by their numbers from 1.

    Args:
        section: with the steps of all products that are written out.
        period: how many these are.
    """
    uses = Counter(step.process for step in section.steps if step.process)
    length = len(section.steps) // period
    found: dict[int, MachineJob] = {}
    counted: Counter[str] = Counter()
    turns: Counter[tuple[str, int]] = Counter()
    for number, step in enumerate(section.steps, start=1):
        name = step.process or ""
        process = section.processes.get(name)
        if process is None or not process.without_robot:
            continue
        product = (number - 1) // length + 1
        if process.machine is None:
            counted[name] += 1
            own = name if uses[name] == 1 else numbered(name, counted[name])
            found[number] = MachineJob(own, product=product)
            continue
        machine = process.machine
        declared = section.machines.get(machine)
        if declared is None or declared.door is None:
            found[number] = MachineJob(machine, product=product)
            continue
        turns[machine, product] += 1
        part = f"{machine}.door"
        if turns[machine, product] > 1:
            part += str(turns[machine, product])
        door = numbered(part, product) if section.products is not None else part
        found[number] = MachineJob(machine, door, part, product)
    return found

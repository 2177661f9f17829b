"""Windows of time between steps that no plan can keep: what lies between takes longer."""

from __future__ import annotations

from graphlib import TopologicalSorter

from twin.check.finding import Finding, Findings, Subject
from twin.scenario.sections.parts import PartsSection, StepSection

Waits = dict[int, list[tuple[int, float, float]]]
"""By step: an earlier one, the least time after it, and how long the step itself takes at least [s]."""


def check_windows(subject: Subject) -> Findings:
    """Yield steps that come after others that take longer than their window lets them.

    What must be done between two steps is what the one comes after and what comes after the other: the
    longest way by least durations and least times. Motions count as nothing.
    """
    section = subject.scenario.assembly
    if not isinstance(section, PartsSection):
        return
    numbers = {step.known_as: k for k, step in enumerate(section.steps)}
    waits: Waits = {}
    for k, step in enumerate(section.steps):
        takes = _least_s(subject, step)
        known = [own for own in step.follows if own.step in numbers]
        waits[k] = [(numbers[own.step], own.at_least_s, takes) for own in known]
    for k, step in enumerate(section.steps):
        for i, own in enumerate(step.follows):
            if own.within_s is None or own.step not in numbers:
                continue
            least, way = _longest(waits, numbers[own.step], k)
            if least > own.within_s:
                names = [section.steps[n].known_as or f"step {n + 1}" for n in way]
                yield Finding(
                    ("assembly", "steps", k, "after", i),
                    f"this can never be kept: at most {own.within_s:g} s may pass, and {', '.join(names)} take at"
                    f" least {least:g} s, {least - own.within_s:g} s more; give within_s more time, or let less"
                    " come between",
                    error=True,
                )


def _longest(waits: Waits, first: int, last: int) -> tuple[float, list[int]]:
    """Return the longest time from the end of a step to the begin of a later one [s], and by which steps."""
    found: dict[int, tuple[float, list[int]]] = {first: (0.0, [first])}
    before = {k: [n for n, _, _ in own] for k, own in waits.items()}
    for k in TopologicalSorter(before).static_order():
        for n, lag, takes in waits.get(k, ()):
            if n in found and k != first:
                seconds = found[n][0] + lag + (takes if k != last else 0.0)
                if k not in found or seconds > found[k][0]:
                    found[k] = seconds, [*found[n][1], k]
    return found[last]


def _least_s(subject: Subject, step: StepSection) -> float:
    """Return the least duration of a process [s]; 0 for other steps, and where nothing says it."""
    execution, name = subject.scenario.execution, step.process or ""
    model = execution.skill_models(subject.folder).get(name)
    overrides = execution.skill_exceptions(subject.folder)
    others = [own.duration.minimum for own in overrides if own.skill == name]
    return min([model.minimum, *others]) if model is not None else 0.0

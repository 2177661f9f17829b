"""Checks for time windows between steps, and due times of products, that no plan can meet."""

from __future__ import annotations

from collections.abc import Iterator
from graphlib import TopologicalSorter
from itertools import pairwise, product

import numpy as np

from twin.checks.finding import (
    CheckContext,
    Finding,
    Findings,
)
from twin.kinds.parts.checks.context import for_part_assemblies
from twin.kinds.parts.ordered_parts import OrderedParts
from twin.kinds.parts.section import PartsSection, StepSection
from twin.kinds.parts.sources import ConveyorSection

Waits = dict[int, list[tuple[int, float, float]]]
"""For each step, the earlier steps it follows, each with the least time in between and the least duration of the step [s]."""


@for_part_assemblies
def check_windows(subject: CheckContext, parts: OrderedParts) -> Findings:
    """Yield steps whose time window is shorter than the work within it.

    The work between two steps is the longest chain of steps from the earlier to the later one, by least durations
    of processes and least times between steps. Motions count as zero.
    """
    section = parts.section
    numbers = {step.known_as: k for k, step in enumerate(section.steps)}
    waits: Waits = {}
    for k, step in enumerate(section.steps):
        takes = _least_s(subject, step)
        known = [own for own in step.follows if own.step in numbers]
        waits[k] = [(numbers[own.step], own.at_least_s, takes) for own in known]
    products = section.products
    for variant, (k, step) in product(
        (products and products.variants) or [""], enumerate(section.steps)
    ):
        there = section.steps_of(variant)
        for i, own in enumerate(step.follows):
            first = numbers.get(own.step)
            if own.within_s is None or first not in there or k not in there:
                continue
            least, longest = _longest(
                {n: [w for w in waits[n] if w[0] in there] for n in there}, first, k
            )
            if least > own.within_s:
                names = [section.steps[n].known_as or f"step {n + 1}" for n in longest]
                yield Finding(
                    ("assembly", "steps", k, "after", i),
                    f"this can never be kept: at most {own.within_s:g} s may pass, and {', '.join(names)} take at"
                    f" least {least:g} s, {least - own.within_s:g} s more; give within_s more time, or let less"
                    " come between",
                    error=True,
                )


def _longest(waits: Waits, first: int, last: int) -> tuple[float, list[int]]:
    """Return the longest time from the end of a step to the start of a later one [s], and the steps of that chain."""
    found: dict[int, tuple[float, list[int]]] = {first: (0.0, [first])}
    before = {k: [n for n, _, _ in own] for k, own in waits.items()}
    for k in TopologicalSorter(before).static_order():
        for n, lag, takes in waits.get(k, ()):
            if n in found and k != first:
                seconds = found[n][0] + lag + (takes if k != last else 0.0)
                if k not in found or seconds > found[k][0]:
                    found[k] = seconds, [*found[n][1], k]
    return found[last]


def _least_s(subject: CheckContext, step: StepSection) -> float:
    """Return the least duration of a process [s]; 0 for other steps, and if unknown."""
    execution, name = subject.scenario.execution, step.process or ""
    model = execution.skill_models(subject.folder).get(name)
    overrides = execution.skill_exceptions(subject.folder)
    others = [own.duration.minimum for own in overrides if own.skill == name]
    return min([model.minimum, *others]) if model is not None else 0.0


@for_part_assemblies
def check_due_times(subject: CheckContext, parts: OrderedParts) -> Findings:
    """Yield due times that decrease or cannot be kept."""
    products = parts.section.products
    if products is None:
        return
    due = products.due_s()
    sequence = products.sequence(len(due))
    for who, gap, uses in _paces(subject, parts.section) if due else ():
        takes = np.array([uses[variant] for variant in sequence or [""] * len(due)])
        ready = np.cumsum(takes) - gap
        late = ready - np.array(due)
        if late.max() > 0.0:
            k = int(np.argmax(late > 0.0))
            yield Finding(
                ("assembly", "products", "due" if products.due else "variants"),
                f"due: product {k + 1} is due at {due[k]:g} s, and {who} takes {takes[k]:g} s for"
                f" {'it' if sequence else 'each product'}, so that it is not complete before {ready[k]:g} s; let"
                " products be due later",
            )
    for k, (first, then) in enumerate(pairwise(due)):
        if then < first and products.due and not sequence:
            yield Finding(
                ("assembly", "products", "due", k + 1),
                f"due: product {k + 2} is due at {then:g} s, before product {k + 1} at {first:g} s, and products are"
                " finished in their order; usual are times that rise",
            )


def _paces(
    subject: CheckContext, section: PartsSection
) -> Iterator[tuple[str, float, dict[str, float]]]:
    """Yield conveyors and machines of a line: description, time saved at the start, and time per product by variant [s].

    From mean durations; motions and other steps count as zero.
    """
    folder, products = subject.folder, section.products
    variants = list(products.variants if products else ()) or [""]
    steps = {k: section.of_variant(k).steps for k in variants}
    for name, source in section.sources.items():
        parts = {p.name: p.count or 1 for p in section.parts if p.source == name}
        if isinstance(source, ConveyorSection) and parts:
            every = source.interval.located(folder).mean
            taken = {k: {s.place or "" for s in own} for k, own in steps.items()}
            yield (
                f"source {name}",
                every,
                {
                    k: every * sum(parts.get(n, 0) for n in own)
                    for k, own in taken.items()
                },
            )
    models = subject.scenario.execution.skill_models(folder)
    for name in section.machines:
        done = [k for k, own in section.processes.items() if own.machine == name]
        together = section.machines[name].capacity
        means = {k: models[k].mean / together for k in done if k in models}
        yield (
            f"machine {name}",
            0.0,
            {
                k: sum(means.get(step.process or "", 0.0) for step in own)
                for k, own in steps.items()
            },
        )

"""Batches that begin before they are full: since when their parts wait in the machine, and which ones a plan closes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from planning.tasks.task import TimeWindow
from scheduling.graph.rollout import earliest_times
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.graph.windows import window_gaps
from twin.document.validation import Problems
from twin.document.yaml_text import KeyPath
from twin.kinds.parts.batches import MOST_UNEVEN, Run, batch_runs, batch_sizes
from twin.kinds.parts.between import AfterSection
from twin.kinds.parts.section import MachineSection, PartsSection, StepSection

_SAME_S = 1e-6
"""Times that differ by less are the same [s]."""


def with_start_windows(product: PartsSection) -> PartsSection:
    """Return a product in which whatever is put into a machine with ``start_after_s`` has a window until that begins.

    Args:
        product: with the steps of one product.
    """
    steps = list(product.steps)
    for k, step in enumerate(steps):
        machine = _machine(product, step)
        put_in = _put_in(steps, k)
        if machine is None or machine.start_after_s is None or put_in is None:
            continue
        known = steps[put_in].known_as or ""
        window = AfterSection(step=known, within_s=machine.start_after_s)
        steps[k] = step.changed(after=(*step.follows, window))
    return product.changed(steps=tuple(steps))


def waits_in_batches(
    section: PartsSection, tpg: TemporalPlanGraph
) -> dict[str, list[list[float]]]:
    """Return how long before each batch begins its parts are in the machine at nominal times, in their order [s].

    Args:
        section: of the assembly.
        tpg: a plan from the beginning.

    Returns:
        By machine with ``start_after_s``, batch by batch.
    """
    times, waits = earliest_times(tpg), dict[int, dict[str, float]]()
    gaps = window_gaps(tpg, np.concatenate(times.start), np.concatenate(times.end))
    put_in = {step.at.part for step in section.steps if step.process and step.at}
    for window, gap in zip(tpg.windows, gaps.tolist(), strict=True):
        machine = section.machines.get(tpg.tasks[window.due].robot)
        if machine is None or machine.start_after_s is None:
            continue
        if window.done == TimeWindow.EARLIER:
            continue
        task = tpg.tasks[window.done]
        name = str(task.object)
        if task.kind == "place-down" and {name, name.rpartition(".")[0]} & put_in:
            own = waits.setdefault(window.due, {})
            own[name] = min(gap, own.get(name, gap))
    found: dict[str, list[list[float]]] = {}
    for due in sorted(waits, key=lambda due: tpg.tasks[due].step):
        found.setdefault(tpg.tasks[due].robot, []).append([*waits[due].values()])
    return found


def closed_batches(
    batches: Sequence[Sequence[float]], longest: float
) -> tuple[int, ...] | None:
    """Return the sizes of the first batches, up to one that takes parts in for too long: of that, those in by then.

    Only a plan in which a batch waits for a part says when that part comes. So what comes after a batch that is
    closed is full again, and closed in turn by the plan in which it is.

    Args:
        batches: how long before the begin of each batch its parts are in the machine [s].
        longest: that a batch takes parts in after its first one [s].

    Returns:
        None where no batch takes parts in for longer.
    """
    for k, waits in enumerate(batches):
        for n in range(2, len(waits) + 1):
            if max(waits[:n]) - min(waits[:n]) > longest + _SAME_S:
                return (*map(len, batches[:k]), n - 1)
    return None


def with_batches(
    section: PartsSection, sizes: Mapping[str, tuple[int, ...]]
) -> PartsSection:
    """Return the section with the sizes of the first batches of some machines."""
    machines = dict(section.machines)
    for name, own in sizes.items():
        machines[name] = machines[name].changed(batches=own)
    return section.changed(machines=machines)


def batch_start_problems(section: PartsSection) -> Problems:
    """Yield sizes and starts of batches that cannot be: above the capacity, of several runs, or since nobody knows when."""
    sizes, products = batch_sizes(section), section.products
    variants = (products and products.variants) or [""]
    for name, machine in section.machines.items():
        at: KeyPath = ("assembly", "machines", name)
        starts = machine.start_after_s is not None
        if not (machine.batches or starts):
            continue
        key = "start_after_s" if starts else "batches"
        if machine.capacity == 1:
            yield (
                (*at, key),
                f"{key} is of several parts: leave it out, or write capacity: 2",
            )
        for k, size in enumerate(machine.batches):
            if size > machine.capacity:
                words = f"must be at most capacity, {machine.capacity}, not {size}"
                yield (*at, "batches", k), words
        if products and products.count > MOST_UNEVEN:
            words = f"at most {MOST_UNEVEN} products are made in batches of several sizes: leave {key} out"
            yield ("assembly", "products", "count"), words
        runs = set[Run]()
        for variant in variants:
            numbers = section.steps_of(variant)
            steps = [section.steps[k] for k in numbers]
            for k, run in enumerate(batch_runs(steps, sizes)):
                if run is None or _machine(section, steps[k]) is not machine:
                    continue
                runs.add(run)
                put_in = _put_in(steps, k)
                where: KeyPath = (
                    "assembly",
                    "steps",
                    numbers[k if put_in is None else put_in],
                )
                if starts and put_in is None:
                    yield (
                        where,
                        f"start_after_s of {name} counts from when this is put in: place it by a step before",
                    )
                elif starts and put_in is not None and steps[put_in].known_as is None:
                    yield (
                        where,
                        f"start_after_s of {name} counts from when this is complete: give it a name, such as name: loaded",
                    )
        if len(runs) > 1:
            yield (
                (*at, key),
                f"{key} is of one run of one process in a product, not of {len(runs)}: leave it out",
            )


def _machine(section: PartsSection, step: StepSection) -> MachineSection | None:
    """Return the machine of a step."""
    process = section.processes.get(step.process or "")
    return section.machines.get(process.machine or "") if process else None


def _put_in(steps: Sequence[StepSection], number: int) -> int | None:
    """Return the index of the step that puts the part of a step where it is worked at."""
    at = steps[number].at
    earlier = range(number - 1, -1, -1)
    return next((k for k in earlier if at and steps[k].place == at.part), None)

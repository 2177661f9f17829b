"""Batches that begin before they are full: since when their parts wait in the machine, and which ones a plan closes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from scheduling.graph.rollout import earliest_times
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.graph.windows import window_gaps
from twin.document.validation import Problems
from twin.document.yaml_text import KeyPath
from twin.kinds.parts.batches import MOST_UNEVEN, Run, batch_runs, batch_sizes
from twin.kinds.parts.between import AfterSection
from twin.kinds.parts.section import PartsSection, StepSection

_SAME_S = 1e-6
"""Times that differ by less are the same [s]."""


def with_start_windows(product: PartsSection) -> PartsSection:
    """Return a product with a window from each step that fills a machine with ``start_after_s`` to the run there."""
    steps = list(product.steps)
    for k, step in enumerate(steps):
        machine, put_in = product.machine_of(step), _put_in(steps, k)
        if machine and machine.start_after_s and put_in is not None:
            known = steps[put_in].known_as or ""
            window = AfterSection(step=known, within_s=machine.start_after_s)
            steps[k] = step.changed(after=(*step.follows, window))
    return product.changed(steps=tuple(steps))


def waits_in_batches(
    section: PartsSection, tpg: TemporalPlanGraph
) -> dict[str, list[list[float]]]:
    """Return how long before each batch begins its parts are in the machine at nominal times, in their order [s].

    They are by machine with ``start_after_s``, batch by batch; the plan is one from the beginning.
    """
    clocked = {name for name, own in section.machines.items() if own.start_after_s}
    if not clocked:
        return {}
    times, waits = earliest_times(tpg), dict[int, dict[str, float]]()
    gaps = window_gaps(tpg, np.concatenate(times.start), np.concatenate(times.end))
    put_in = {step.at.part for step in section.steps if step.process and step.at}
    for window, gap in zip(tpg.windows, gaps.tolist(), strict=True):
        task, due = tpg.tasks[window.done], tpg.tasks[window.due]
        name = str(task.object)
        known = {name, name.rpartition(".")[0]} & put_in
        if due.robot in clocked and task.kind == "place-down" and known:
            own = waits.setdefault(window.due, {})
            own[name] = min(gap, own.get(name, gap))
    found: dict[str, list[list[float]]] = {}
    for run in sorted(waits, key=lambda run: tpg.tasks[run].step):
        found.setdefault(tpg.tasks[run].robot, []).append([*waits[run].values()])
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
        None where no batch does for longer.
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
    for name in sizes.keys() & machines.keys():
        machines[name] = machines[name].changed(batches=sizes[name])
    return section.changed(machines=machines)


def batch_start_problems(section: PartsSection) -> Problems:
    """Yield sizes and starts of batches that cannot be: above the capacity, of several runs, or counted from no step."""
    sizes, products = batch_sizes(section), section.products
    for name, machine in section.machines.items():
        key = "start_after_s" if machine.start_after_s else "batches"
        at: KeyPath = ("assembly", "machines", name)
        if not getattr(machine, key):
            continue
        for k, size in enumerate(machine.batches):
            if size > machine.capacity:
                words = f"must be at most capacity, {machine.capacity}, not {size}"
                yield (*at, "batches", k), words
        if products and products.count > MOST_UNEVEN:
            words = f"at most {MOST_UNEVEN} products are made in batches of several sizes: leave {key} out"
            yield ("assembly", "products", "count"), words
        runs = set[Run]()
        for variant in (products and products.variants) or [""]:
            numbers = section.steps_of(variant)
            steps = [section.steps[k] for k in numbers]
            for k, run in enumerate(batch_runs(steps, sizes)):
                if run is None or section.machine_of(steps[k]) is not machine:
                    continue
                runs.add(run)
                put_in = _put_in(steps, k)
                named = put_in is not None and steps[put_in].known_as
                if machine.start_after_s and not named:
                    where = numbers[k if put_in is None else put_in]
                    words = f"start_after_s of {name} counts from the step that puts a part there: give that step and its name, such as name: loaded"
                    yield ("assembly", "steps", where), words
        if len(runs) != 1:
            words = f"is of batches (capacity) of one run of one process in a product, not of {len(runs)}"
            yield (*at, key), f"{key} {words}: leave it out"


def _put_in(steps: Sequence[StepSection], number: int) -> int | None:
    """Return the index of the step that puts the part of a step where it is worked at."""
    at = steps[number].at
    earlier = range(number - 1, -1, -1)
    return next((k for k in earlier if at and steps[k].place == at.part), None)

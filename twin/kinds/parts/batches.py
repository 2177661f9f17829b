"""Batches of machines with capacity: which steps are one run, and the order of the steps of products around it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain, repeat
from types import MappingProxyType

from twin.document.validation import Problems
from twin.document.yaml_text import KeyPath
from twin.kinds.parts.section import PartsSection, StepSection

Run = tuple[str, int]
"""Steps of one process that follow each other in a product: the process, and which of its runs."""

MOST_UNEVEN = 500
"""Most products that are planned one by one, as the last batch is smaller than the others."""


def batch_sizes(section: PartsSection) -> dict[str, int]:
    """Return the number of parts in a batch, by process; nothing without a machine for several."""
    several = {k: own.capacity for k, own in section.machines.items()}
    found = {k: several.get(p.machine or "", 1) for k, p in section.processes.items()}
    return {name: size for name, size in found.items() if size > 1}


def first_batches(section: PartsSection) -> dict[str, tuple[int, ...]]:
    """Return the numbers of parts in the first batches, by process, where they are given."""
    given = {k: own.batches for k, own in section.machines.items() if own.batches}
    processes = section.processes.items()
    return {name: given[p.machine] for name, p in processes if p.machine in given}


def order_in_batches(
    products: Sequence[Sequence[StepSection]],
    sizes: Mapping[str, int],
    given: Mapping[str, Sequence[int]] = MappingProxyType({}),
) -> list[tuple[tuple[int, int], ...]]:
    """Return the steps of all products in the order in which they are done; the steps of a batch are one entry.

    Products are advanced one after another. One whose step joins a batch waits until that is full; products that
    waited come before those after them. When nothing can be done otherwise, the batch of the earliest step begins as
    it is.

    Args:
        products: steps of each product in their order.
        sizes: number of parts in a full batch, by process.
        given: those of the first batches, by process; a process for which there are some has one run a product.

    Returns:
        Of each entry, the product and the step within it, both from 0; of a batch, those of each of its parts.
    """
    runs: list[list[Run | None]] = [list(batch_runs(own, sizes)) for own in products]
    done, waits = [0] * len(products), dict[int, Run]()
    waiting: dict[Run, list[tuple[int, int]]] = {}
    found: list[tuple[tuple[int, int], ...]] = []
    numbers = {k: chain(given.get(k, ()), repeat(size)) for k, size in sizes.items()}
    full = {k: next(own) for k, own in numbers.items()}

    def begin(run: Run) -> None:
        batch = waiting.pop(run)
        full[run[0]] = next(numbers[run[0]])
        found.append(tuple(batch))
        for product, _ in batch:
            waits.pop(product, None)

    first = 0
    while True:
        while first < len(products) and done[first] == len(products[first]):
            first += 1
        movable = (
            k
            for k in range(first, len(products))
            if done[k] < len(products[k])
            and (k not in waits or waits[k] == runs[k][done[k]])
        )
        product = next(movable, None)
        if product is None and not waiting:
            return found
        if product is None:
            begin(min(waiting, key=lambda run: waiting[run][0][1]))
            continue
        step, run = done[product], runs[product][done[product]]
        done[product] += 1
        if run is None:
            found.append(((product, step),))
            continue
        waits[product] = run
        waiting.setdefault(run, []).append((product, step))
        if len(waiting[run]) == full[run[0]]:
            begin(run)


def batch_runs(
    steps: Sequence[StepSection], sizes: Mapping[str, int]
) -> Iterator[Run | None]:
    """Yield the run of each step, None for those that are in no batch.

    A part that is processed again, and a step that comes after another one of the run, begin a new run.
    """
    number = 0
    process: str | None = None
    parts, names = set[str](), set[str]()
    for step in steps:
        part = None if step.at is None else step.at.part
        if step.process not in sizes or part is None:
            process = None
            yield None
            continue
        after = {own.step for own in step.follows}
        if step.process != process or part in parts or after & names:
            process, parts, names, number = step.process, set(), set(), number + 1
        parts.add(part)
        names |= {step.name} if step.name else set()
        yield step.process or "", number


def batch_unit(section: PartsSection) -> int:
    """Return the number of products after which all batches have been full."""
    sizes = batch_sizes(section)
    runs = Counter(run for run in batch_runs(section.steps, sizes) if run is not None)
    return math.lcm(*(sizes[k] // math.gcd(sizes[k], n) for (k, _), n in runs.items()))


def batch_names(groups: Sequence[Sequence[StepSection]]) -> dict[str | None, str]:
    """Return the name of the batch, which is the first one of its steps, by the others."""
    found: dict[str | None, str] = {}
    for group in groups:
        known = [step.name for step in group if step.name]
        found.update((name, known[0]) for name in known[1:])
    return found


def batch_problems(section: PartsSection) -> Problems:
    """Yield batches that cannot be: without an order, with spare products, or with fewer places than parts."""
    sizes, products = batch_sizes(section), section.products
    runs = list(batch_runs(section.steps, sizes))
    of_run, lies = Counter(runs), dict[str, int]()
    for k, (step, run) in enumerate(zip(section.steps, runs, strict=True)):
        grid = products and (step.at.grid if step.at else products.places)
        if step.at and step.at.grid and (products is None or step.place is None):
            words = "the places of a grid are taken by one product after another"
            at: KeyPath = ("assembly", "steps", k, "at", "grid")
            yield at, f"{words}: give products, and place, or leave grid out"
        lies[step.place or ""] = grid.size if grid else 1
        if run is None or step.at is None or products is None:
            continue
        part, needed = step.at.part or "", -(-sizes[run[0]] // of_run[run])
        if lies.get(part, 1) < min(needed, products.count):
            yield (
                _capacity(section, run[0]),
                f"{part} has {lies.get(part, 1)} of {needed} places for this: give the step that puts it there"
                f" at: {{grid: {{counts: [{needed}, 1], ..}}}}, or write capacity: {lies.get(part, 1) * of_run[run]}",
            )
    for name in sizes:
        if section.order == "find":
            words = "batches are in the order of the steps: leave order out"
            yield _capacity(section, name), words
        if products and (products.spare or products.rush):
            key, what = (
                ("spare", "is spare") if products.spare else ("rush", "is rushed")
            )
            where = ("assembly", "products", key)
            yield where, f"no batch {what}: leave {key} out, or write capacity: 1"
    if sizes and section.changeovers:
        words = (
            "products of a batch alternate: leave changeovers out, or write capacity: 1"
        )
        yield ("assembly", "changeovers"), words
    unit = batch_unit(section)
    if products and products.count > MOST_UNEVEN and products.count % unit:
        whole = products.count // unit * unit
        words = f"more than {MOST_UNEVEN} products are made in whole batches: write {whole} or {whole + unit}"
        yield ("assembly", "products", "count"), words


def _capacity(section: PartsSection, process: str) -> KeyPath:
    machine = section.processes[process].machine or ""
    return "assembly", "machines", machine, "capacity"


def merged_batches(
    groups: Sequence[Sequence[StepSection]], names: Mapping[str | None, str]
) -> tuple[StepSection, ...]:
    """Return the steps, one for each batch, with the names of batches; see ``batch_names``."""

    def merged(group: Sequence[StepSection]) -> StepSection:
        after = [own for step in group for own in step.follows]
        if len(group) == 1 and not names:
            return group[0]
        own = (x.model_copy(update={"step": names.get(x.step, x.step)}) for x in after)
        first = group[0]
        name = next((step.name for step in group if step.name), None)
        until = names.get(first.until, first.until)
        update = {"after": tuple(own), "name": name, "until": until}
        return first.model_copy(update=update)

    return tuple(merged(group) for group in groups)

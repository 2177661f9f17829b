"""Checks of assembly sections: references and consistency of steps, sources and products."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import chain

import networkx as nx

from twin.document.validation import Problems, check_known_name, unknown_name
from twin.document.yaml_text import KeyPath
from twin.durations.composed import AnyDuration
from twin.kinds.parts.alike import find_alike_problems
from twin.kinds.parts.batch_starts import batch_start_problems
from twin.kinds.parts.batches import batch_problems
from twin.kinds.parts.line import OUTFEED, Line, feeding_machine
from twin.kinds.parts.section import PartSection, PartsSection, StepSection
from twin.kinds.parts.sources import ConveyorSection, VariantSection
from twin.kinds.statics import check_distinct_ends
from twin.scenario.sections.cell import CellSection

_MOST_OF_VARIANTS = 5000
"""Most products where they are of several variants."""


def find_part_problems(section: PartsSection, cell: CellSection) -> Problems:
    """Yield all inconsistencies of an assembly of parts.

    Args:
        section: passed the checks of its single values.
        cell: around it.
    """
    yield from find_alike_problems(section)
    yield from _check_steps(section)
    yield from _check_line(section)
    yield from batch_problems(section)
    yield from batch_start_problems(section)
    yield from _check_variants(section)
    yield from _check_rush(section)
    yield from _check_work(section, cell)


def _check_steps(section: PartsSection) -> Problems:
    names: dict[str, int] = {}
    for k, step in enumerate(section.steps):
        at: KeyPath = ("assembly", "steps", k)
        yield from _check_step(section, step, at)
        known = step.known_as
        if known is None:
            continue
        if known in names:
            twice = step.place is not None and step.at is None and step.name is None
            earlier = names[known] + 1
            yield (
                at,
                f"{known} is already placed in step {earlier}"
                if twice
                else f"the name {known!r} is already that of step {earlier}",
            )
        names.setdefault(known, k)
    yield from _check_machines(section)
    yield from _check_placed_once(section)
    yield from _check_order(section, names)
    yield from _check_until(section, names)
    # Two different things are joined, by a step that there is.
    for k, item in enumerate(section.joined):
        at = ("assembly", "joined", k)
        yield from check_distinct_ends(
            at, item.parts, section.placed, "joined to", " by a step"
        )
        yield from check_known_name((*at, "by"), "step", item.by, names)
    # Two different things fit each other, and how is said once.
    listed: dict[frozenset[str], int] = {}
    for k, fit in enumerate(section.fits):
        at = ("assembly", "fits", k)
        first, second = fit.parts
        earlier = listed.setdefault(frozenset(fit.parts), k)
        own = [
            *check_distinct_ends(
                at, fit.parts, section.placed, "pressed into", " by a step"
            )
        ]
        yield from own
        if not own and earlier != k:
            yield at, f"how {first} and {second} fit is already said by fits.{earlier}"


def _check_until(section: PartsSection, names: dict[str, int]) -> Problems:
    """Yield steps whose ``until`` is no later step."""
    for k, step in enumerate(section.steps):
        at: KeyPath = ("assembly", "steps", k, "until")
        yield from check_known_name(at, "step", step.until, names)
        later = names.get(step.until or "", k + 1)
        if later == k:
            words = "until names a later one, which joins it"
            yield at, f"{step.until} is this step: {words}"
        elif section.order == "listed" and later < k:
            words = "change the order, or write order: find"
            yield at, f"{step.until} is listed before, as step {later + 1}: {words}"


def _check_step(section: PartsSection, step: StepSection, at: KeyPath) -> Problems:
    parts = {part.name: part for part in section.parts}
    process = section.processes.get(step.process or "")
    yield from check_known_name((*at, "place"), "part", step.place, parts)
    own = parts.get(step.place or "")
    if own is not None and own.goal is None and own.goals is None:
        yield (*at, "place"), f"{step.place} has no goal"
    none = f"there is no process {step.process!r}: give processes one"
    yield from check_known_name(
        (*at, "process"), "process", step.process, section.processes, none
    )
    yield from check_known_name((*at, "hold"), "part", step.hold, parts)
    if step.hold is not None and step.hold == step.place and step.hold in parts:
        words = f"{step.hold} is in the hand of who places it: hold another part"
        yield (*at, "hold"), words
    place = step.at
    if process is not None and process.without_robot:
        yield from _check_machine_step(step, at)
    elif place is not None and place.frame is None and place.pose is None:
        yield (*at, "at"), "give a frame, a pose or both"
    if place is None or place.part is None:
        return
    if step.place is not None:
        words = "a part is put down at a fixture or in the world"
        yield (*at, "at", "part"), words
        return
    yield from check_known_name((*at, "at", "part"), "part", place.part, parts)
    if place.part in parts:
        frames = tuple(parts[place.part].frames)
        yield from _check_frame(at, place.part, place.frame, frames)


def _check_machine_step(step: StepSection, at: KeyPath) -> Problems:
    """Yield invalid keys of machine steps: they are done at a resting part, without a robot."""
    for key in ("robots", "hold", "path", "turn_deg"):
        if getattr(step, key) is not None:
            yield (*at, key), f"no robot does {step.process}: leave {key} out"
    own = step.at
    if own is None or own.part is None:
        words = f"{step.process} is done at a part: at: {{part: NAME}}"
        yield (*at, "at"), words
    elif own.frame is not None or own.pose is not None:
        words = f"{step.process} is done at {own.part} where that lies: leave this out"
        yield (*at, "at", "pose" if own.frame is None else "frame"), words


def _check_machines(section: PartsSection) -> Problems:
    """Yield unknown machines of processes, and machines without a process."""
    machines = section.machines
    for name, process in section.processes.items():
        at: KeyPath = ("assembly", "processes", name, "machine")
        none = f"there is no machine {process.machine!r}: give machines one"
        yield from check_known_name(at, "machine", process.machine, machines, none)
    used = {process.machine for process in section.processes.values()}
    for name in machines:
        if name not in used:
            yield ("assembly", "machines", name), f"no process is done by {name}"


def _check_frame(
    at: KeyPath, owner: str, frame: str | None, frames: tuple[str, ...]
) -> Problems:
    """Yield an unknown frame of a step's part or fixture."""
    if frame is None or frame in frames:
        return
    words = f"{owner}: {unknown_name('frame', frame, frames)}"
    if not frames:
        words = f"{owner} has no frames, so none is called {frame!r}: give it frames, or a pose here"
    yield (*at, "at", "frame"), words


def _check_placed_once(section: PartsSection) -> Problems:
    seen: dict[str, int] = {}
    for k, step in enumerate(section.steps):
        at: KeyPath = ("assembly", "steps", k, "place")
        if step.place is None:
            continue
        if step.place in seen and (step.name is not None or step.at is not None):
            words = f"{step.place} is already placed in step {seen[step.place] + 1}"
            yield at, words
        if step.at is None:
            seen.setdefault(step.place, k)
        elif step.place not in section.placed:
            words = "is put down on its way, and no step puts it in its place"
            yield at, f"{step.place} {words}"
        elif section.order == "find":
            words = "what is put down on its way needs steps in their order: leave order out"
            yield (*at[:-1], "at"), words


def _check_order(section: PartsSection, names: dict[str, int]) -> Problems:
    """Yield steps after unknown steps or themselves."""
    at: KeyPath
    after: nx.DiGraph[int] = nx.DiGraph()
    for k, step in enumerate(section.steps):
        for i, own in enumerate(step.follows):
            name, at = own.step, ("assembly", "steps", k, "after", i)
            yield from check_known_name(at, "step", name, names)
            if name not in names:
                continue
            after.add_edge(k, names[name])
            if section.order == "listed" and names[name] > k:
                words = "change the order, or write order: find"
                yield at, f"{name} is listed later, as step {names[name] + 1}: {words}"
    if not nx.is_directed_acyclic_graph(after):
        cycle = [edge[0] for edge in nx.find_cycle(after)]
        known = [section.steps[k].known_as or f"step {k + 1}" for k in cycle]
        words = " after ".join([*known, known[0]])
        yield ("assembly", "steps", cycle[0], "after"), f"no order can be: {words}"


def _check_line(section: PartsSection) -> Problems:
    """Yield unknown sources of parts, and unused sources."""
    placed, sources = set(section.placed), tuple(section.sources)
    used: dict[str, PartSection] = {}
    for i, part in enumerate(section.parts):
        at: KeyPath = ("assembly", "parts", i)
        own = (*at, "source")
        for name in part.sources:
            none = f"there is no source {name!r}: give sources one"
            yield from check_known_name(own, "source", name, sources, none)
            first = used.setdefault(name, part)
            if first.sources != part.sources:
                words = f"{first.name} comes from {' and '.join(first.sources)}"
                yield own, f"{words}: what shares {name} must name the same sources"
            if part.sources.count(name) > 1:
                yield own, f"{name} is named twice: name each source once"
                break
        if {*part.sources} & {*sources} and part.name not in placed:
            words = f"so nothing comes from {' and '.join(part.sources)}"
            yield own, f"no step places {part.name}, {words}"
        elif part.source is None and section.products and part.name in placed:
            words = "and is needed for every product: let it come from a source"
            yield (*at, "start"), f"{part.name} lies there once, {words}"
    yield from _check_carriers(section)
    for name in sources:
        if name not in used:
            words = f"no part comes from the source {name!r}"
            yield ("assembly", "sources", name), words
    if section.order == "find" and (sources or section.products):
        words = "are taken in the order of the steps: list them in that order"
        yield ("assembly", "order"), f"parts of sources {words}"


def _carriers(section: PartsSection) -> dict[str, KeyPath]:
    """Return who brings and takes away for several, each with the key that names it first."""
    found: dict[str, KeyPath] = {}
    for name, source in section.sources.items():
        if not isinstance(source, ConveyorSection) and source.refill_by:
            at: KeyPath = ("assembly", "sources", name, "refill_by")
            found.setdefault(source.refill_by, at)
    if section.products is not None:
        own = section.products.leave_by or OUTFEED
        at = ("assembly", "products", *(["leave_by"] if own != OUTFEED else []))
        found.setdefault(own, at)
    return found


def _check_carriers(section: PartsSection) -> Problems:
    """Yield sources for which one carrier takes different times though they give parts of one kind."""
    times: dict[tuple[str, str], tuple[str, AnyDuration]] = {}
    for name, source in section.sources.items():
        if isinstance(source, ConveyorSection) or source.refill_by is None:
            continue
        for part in section.parts:
            key, own = (source.refill_by, part.shape_words), source.refill_time
            if name in part.sources and times.setdefault(key, (name, own))[1] != own:
                key_of = "refill_s" if source.refill is None else "refill"
                words = f"for {times[key][0]}, of the same parts, {source.refill_by} takes another time"
                yield ("assembly", "sources", name, key_of), f"{words}: give both one"
                break


def _check_variants(section: PartsSection) -> Problems:
    """Yield unknown and empty variants, and steps that need a part which their products do not have."""
    products = section.products
    variants = products.variants if products else {}
    none, at = "there are no variants: give products.variants", ("assembly", "products")
    for k, step in enumerate(section.steps):
        for i, name in enumerate(step.variants or ()):
            own = ("assembly", "steps", k, "variants", i)
            yield from check_known_name(own, "variant", name, variants, none)
    yield from _check_changeovers(section, variants)
    if products is None or not variants:
        return
    if products.count + products.spare + len(products.rushed) > _MOST_OF_VARIANTS:
        words = f"at most {_MOST_OF_VARIANTS} products of several variants are planned, spare ones included"
        yield (*at, "count"), words
    order = () if isinstance(products.order, str) else products.order
    for i, name in enumerate(order):
        yield from check_known_name((*at, "order", i), "variant", name, variants)
    for name, variant in variants.items():
        if order and name not in order:
            words = f"order has no {name}: name it there, or leave {name} out"
            yield (*at, "variants", name), words
        if order and variant.share is not None:
            words = "order says how many there are: leave share out"
            yield (*at, "variants", name, "share"), words
        if not section.of_variant(name).placed:
            words = f"no step of {name} puts a part in its place: let one name it in variants"
            yield (*at, "variants", name), words
    for i, part in enumerate(section.parts):
        if part.several:
            words = f"{part.name} stands for parts that are alike, and products of several variants have none"
            yield ("assembly", "parts", i), f"{words}: give each an entry of its own"
    for k, step in enumerate(section.steps):
        needed = [step.hold, step.at.part if step.at else None]
        needed += [step.place] if step.at else []
        for thing in {*needed} & {*section.placed}:
            puts = [
                s.variants or variants
                for s in section.steps
                if s.place == thing and not s.at
            ]
            has = {*(step.variants or variants)} & variants.keys()
            lacking = sorted(has - {*chain(*puts)})
            if lacking:
                words = f"of variant {lacking[0]} no step puts {thing} in its place, which this step needs"
                yield ("assembly", "steps", k), f"{words}: give this step variants"


def _check_rush(section: PartsSection) -> Problems:
    """Yield what depends on the order of products where rush orders change it."""
    products, words = section.products, "another order of products would change it"
    if products is None or not products.rush:
        return
    made = [section.of_variant(k) for k in products.variants or ("",)]
    some = {step.known_as for step in section.steps if step.variants}
    firsts = {part.name: part.sources[:1] for part in section.parts}
    for name in section.sources:
        taken = [[k for k in own.taken if firsts[k] == (name,)] for own in made]
        if len({tuple(own) for own in taken if own}) > 1:
            what = "give each part a source of its own, or leave rush out"
            yield ("assembly", "sources", name), f"{words}: {what}"
    for k, step in enumerate(section.steps):
        machine = section.machine_of(step)
        least = [x.step for x in step.follows if x.at_least_s]
        own = step.variants and (least or (machine and machine.door))
        if own or some.intersection(least):
            what = "least times and doors are of all variants, or leave rush out"
            yield ("assembly", "steps", k), f"{words}: {what}"
    alike = [("parts", i) for i, part in enumerate(section.parts) if part.several]
    for at in (*alike, *([("changeovers",)] if section.changeovers else [])):
        yield ("assembly", *at), f"{words}: leave it or products.rush out"


def _check_changeovers(
    section: PartsSection, variants: Mapping[str, VariantSection]
) -> Problems:
    """Yield changeovers of unknown machines and variants, and second ones of a machine."""
    changed: dict[str | None, int] = {}
    none = "there are no variants: give products.variants"
    for i, item in enumerate(section.changeovers):
        at: KeyPath = ("assembly", "changeovers", i)
        known = "there are no machines: leave machine out"
        yield from check_known_name(
            (*at, "machine"), "machine", item.machine, section.machines, known
        )
        if item.duration is not None and not variants:
            yield at, none
        for before, times in item.durations.items():
            own = (*at, "durations", before)
            yield from check_known_name(own, "variant", before, variants, none)
            for name in times:
                yield from check_known_name(
                    (*own, name), "variant", name, variants, none
                )
        if (first := changed.setdefault(item.machine, i)) != i:
            words = f"changeovers.{first} is of {item.machine or 'the whole cell'} already: say it there"
            yield at, words


def machine_names(section: PartsSection) -> Problems:
    """Yield the names of machines, each with its key."""
    carriers = _carriers(section)
    for name, source in section.sources.items():
        at: KeyPath = ("assembly", "sources", name)
        machine = feeding_machine(name, source)
        yield at, name
        if machine != name and machine not in carriers:
            yield at, machine
    for name in section.machines:
        yield ("assembly", "machines", name), name
    for name, process in section.processes.items():
        if process.unattended:
            yield ("assembly", "processes", name), name
    for number, own in Line(section).lags.items():
        for lag in own:
            if lag.machine is not None:
                yield ("assembly", "steps", number - 1, "after"), lag.machine
    for i, item in enumerate(section.changeovers):
        if item.chain != item.machine:
            yield ("assembly", "changeovers", i), item.chain
    yield from ((at, name) for name, at in carriers.items())


def disturbed_machines(section: PartsSection) -> Iterator[str]:
    """Yield the names of the machines that may be disturbed, without unattended processes."""
    served = {
        name
        for name, source in section.sources.items()
        if feeding_machine(name, source) in _carriers(section)
    }
    for at, machine in machine_names(section):
        if at[1] not in ("processes", "steps") and machine not in served:
            yield machine


def _check_work(section: PartsSection, cell: CellSection) -> Problems:
    """Yield processes without capable robots, and unknown places."""
    robots = cell.robots
    outfit_tools = (own.tool for robot in robots for own in robot.outfits)
    tools = tuple(dict.fromkeys(tool for tool in outfit_tools if tool))
    for name, process in section.processes.items():
        if process.tool is not None and process.tool not in tools:
            at: KeyPath = ("assembly", "processes", name, "tool")
            words = f"no robot has the tool {process.tool!r}"
            yield at, words + (f" (valid: {', '.join(tools)})" if tools else "")
    fixtures = {item.name: item for item in cell.fixtures}
    for name, machine in section.machines.items():
        for i, own in enumerate(machine.fixtures):
            at = ("assembly", "machines", name, "fixtures", i)
            yield from check_known_name(at, "fixture", own, fixtures)
    things = (*(part.name for part in section.parts), *fixtures)
    pairs = {
        "joined": [item.parts for item in section.joined],
        "fits": [item.parts for item in section.fits],
    }
    for key, listed in pairs.items():
        for k, both in enumerate(listed):
            for i, name in enumerate(both):
                at = ("assembly", key, k, "parts", i)
                yield from check_known_name(at, "part or fixture", name, things)
    names = [robot.name for robot in robots]
    for k, step in enumerate(section.steps):
        at = ("assembly", "steps", k)
        for i, name in enumerate(step.robots or ()):
            yield from check_known_name((*at, "robots", i), "robot", name, names)
        if step.hold is not None and len(robots) == 1:
            yield (*at, "hold"), "another robot has to hold it, and there is only one"
        if step.at is None or step.at.fixture is None:
            continue
        known = (*at, "at", "fixture")
        yield from check_known_name(known, "fixture", step.at.fixture, fixtures)
        if (fixture := fixtures.get(step.at.fixture)) is not None:
            frames = tuple(fixture.frames)
            yield from _check_frame(at, fixture.name, step.at.frame, frames)

"""Checks of assemblies of parts: steps, sources and products name what there is and go together."""

from __future__ import annotations

from collections.abc import Iterator

from twin.planning.part_assembly.line import OUTFEED, presenter
from twin.scenario.document.validation import Found, unknown_name
from twin.scenario.document.yaml_text import KeyPath
from twin.scenario.sections.cell import CellSection
from twin.scenario.sections.parts import PartsSection, PlaceOfWork, StepSection


def check_steps(section: PartsSection) -> Found:
    """Yield what is wrong with the steps, each with its key.

    Args:
        section: passed the checks of its single values.
    """
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
    yield from _check_joined(section, names)


def _check_until(section: PartsSection, names: dict[str, int]) -> Found:
    """What is kept hold of is let go of after a step that comes later."""
    for k, step in enumerate(section.steps):
        at: KeyPath = ("assembly", "steps", k, "until")
        if step.until is None:
            continue
        if step.until not in names:
            yield at, unknown_name("step", step.until, tuple(names))
        elif names[step.until] == k:
            yield (
                at,
                f"{step.until} is this step: until names a later one, which joins it",
            )
        elif section.order == "listed" and names[step.until] < k:
            yield (
                at,
                f"{step.until} is listed before, as step {names[step.until] + 1}: change the order,"
                " or write order: find",
            )


def _check_joined(section: PartsSection, names: dict[str, int]) -> Found:
    """Two different things are joined, by a step that there is."""
    for k, item in enumerate(section.joined):
        at: KeyPath = ("assembly", "joined", k)
        first, second = item.parts
        if first == second:
            yield at, f"{first} cannot be joined to itself"
        elif not {first, second} & set(section.placed):
            yield at, f"neither {first} nor {second} is placed by a step"
        if item.by is not None and item.by not in names:
            yield (*at, "by"), unknown_name("step", item.by, tuple(names))


def _check_step(section: PartsSection, step: StepSection, at: KeyPath) -> Found:
    parts = {part.name: part for part in section.parts}
    if step.place is not None:
        if step.place not in parts:
            yield (*at, "place"), unknown_name("part", step.place, tuple(parts))
        elif parts[step.place].goal is None:
            yield (*at, "place"), f"{step.place} has no goal"
    elif step.process not in section.processes:
        words = unknown_name("process", str(step.process), tuple(section.processes))
        if not section.processes:
            words = f"there is no process {step.process!r}: give processes one"
        yield (*at, "process"), words
    elif section.processes[step.process].without_robot:
        yield from _check_machine_step(step, at)
    if step.at is not None and not _without_robot(section, step):
        yield from _check_frame_given(step.at, (*at, "at"))
    if step.at is not None and step.place is not None and step.at.part is not None:
        words = "a part is put down at a fixture or in the world"
        yield (*at, "at", "part"), words
    elif step.at is not None and step.at.part is not None:
        if step.at.part not in parts:
            words = unknown_name("part", step.at.part, tuple(parts))
            yield (*at, "at", "part"), words
        elif step.at.frame is not None:
            owner, frames = step.at.part, tuple(parts[step.at.part].frames)
            if step.at.frame not in frames:
                words = unknown_frame(owner, step.at.frame, frames)
                yield (*at, "at", "frame"), words
    if step.hold is not None:
        if step.hold not in parts:
            yield (*at, "hold"), unknown_name("part", step.hold, tuple(parts))
        elif step.hold == step.place:
            words = f"{step.hold} is in the hand of who places it: hold another part"
            yield (*at, "hold"), words


def _without_robot(section: PartsSection, step: StepSection) -> bool:
    process = section.processes.get(step.process or "")
    return process is not None and process.without_robot


def _check_frame_given(place: PlaceOfWork, at: KeyPath) -> Found:
    if place.frame is None and place.pose is None:
        yield at, "give a frame, a pose or both"


def _check_machine_step(step: StepSection, at: KeyPath) -> Found:
    """What no robot does is done at a part, where that lies."""
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


def _check_machines(section: PartsSection) -> Found:
    """Processes are done by machines that there are, and every machine does one."""
    names = tuple(section.machines)
    for name, process in section.processes.items():
        at: KeyPath = ("assembly", "processes", name, "machine")
        if process.machine is not None and process.machine not in names:
            words = unknown_name("machine", process.machine, names)
            if not names:
                words = f"there is no machine {process.machine!r}: give machines one"
            yield at, words
    used = {process.machine for process in section.processes.values()}
    for name in names:
        if name not in used:
            yield ("assembly", "machines", name), f"no process is done by {name}"


def unknown_frame(owner: str, name: str, frames: tuple[str, ...]) -> str:
    """Say that a part or fixture has no frame of a name."""
    if not frames:
        return f"{owner} has no frames, so none is called {name!r}: give it frames, or a pose here"
    return f"{owner}: {unknown_name('frame', name, frames)}"


def _check_placed_once(section: PartsSection) -> Found:
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
            words = (
                f"{step.place} is put down on its way, and no step puts it in its place"
            )
            yield at, words
        elif section.order == "find":
            words = "what is put down on its way needs steps in their order: leave order out"
            yield (*at[:-1], "at"), words


def _check_order(section: PartsSection, names: dict[str, int]) -> Found:
    """Steps come after steps that there are, and not after themselves."""
    after: dict[int, list[int]] = {}
    for k, step in enumerate(section.steps):
        for i, name in enumerate(step.after):
            at: KeyPath = ("assembly", "steps", k, "after", i)
            if name not in names:
                yield at, unknown_name("step", name, tuple(names))
                continue
            after.setdefault(k, []).append(names[name])
            if section.order == "listed" and names[name] > k:
                yield (
                    at,
                    f"{name} is listed later, as step {names[name] + 1}: change the order, or write"
                    " order: find",
                )
    if cycle := _cycle(after):
        words = " after ".join(
            section.steps[k].known_as or f"step {k + 1}" for k in cycle
        )
        yield ("assembly", "steps", cycle[0], "after"), f"no order can be: {words}"


def _cycle(after: dict[int, list[int]]) -> list[int]:
    """Return steps that wait for each other in a circle, the first one again at the end."""
    done: set[int] = set()

    def search(way: list[int]) -> list[int]:
        for other in after.get(way[-1], ()):
            if other in way:
                return [*way[way.index(other) :], other]
            if other not in done and (found := search([*way, other])):
                return found
        done.add(way[-1])
        return []

    return next((found for k in after if (found := search([k]))), [])


def check_line(section: PartsSection) -> Found:
    """Yield what is wrong with sources and products, each with its key.

    Args:
        section: passed the checks of its single values.
    """
    placed, sources = set(section.placed), tuple(section.sources)
    used = {part.source for part in section.parts}
    for i, part in enumerate(section.parts):
        at: KeyPath = ("assembly", "parts", i)
        if part.source is not None and part.source not in section.sources:
            words = unknown_name("source", part.source, sources)
            if not sources:
                words = f"there is no source {part.source!r}: give sources one"
            yield (*at, "source"), words
        elif part.source is not None and part.name not in placed:
            yield (
                (*at, "source"),
                f"no step places {part.name}, so nothing comes from {part.source}",
            )
        elif part.source is None and section.products and part.name in placed:
            yield (
                (*at, "start"),
                f"{part.name} lies there once, and is needed for every product: let it come from"
                " a source",
            )
    for name in sources:
        if name not in used:
            yield (
                ("assembly", "sources", name),
                f"no part comes from the source {name!r}",
            )
    if section.order == "find" and (sources or section.products):
        yield (
            ("assembly", "order"),
            "parts of sources are taken in the order of the steps: list them in that order",
        )


def machine_names(section: PartsSection) -> Found:
    """Yield the names of machines, each with its key."""
    for name, source in section.sources.items():
        at: KeyPath = ("assembly", "sources", name)
        for machine in dict.fromkeys((name, presenter(name, source))):
            yield at, machine
    for name in section.machines:
        yield ("assembly", "machines", name), name
    for name, process in section.processes.items():
        if process.unattended:
            yield ("assembly", "processes", name), name
    if section.products is not None:
        yield ("assembly", "products"), OUTFEED


def disturbed_machines(section: PartsSection) -> Iterator[str]:
    """Yield the names of the machines that may be disturbed; what nobody does is none."""
    for at, machine in machine_names(section):
        if at[1] != "processes":
            yield machine


def check_work(section: PartsSection, cell: CellSection) -> Found:
    """Yield processes that no robot of the cell can do, and places that it does not have.

    Args:
        section: passed the checks of its single values.
        cell: around it.
    """
    robots = cell.robots
    worn = (own.tool for robot in robots for own in robot.outfits)
    tools = tuple(dict.fromkeys(tool for tool in worn if tool))
    for name, process in section.processes.items():
        if process.tool is not None and process.tool not in tools:
            at: KeyPath = ("assembly", "processes", name, "tool")
            words = f"no robot has the tool {process.tool!r}"
            yield at, words + (f" (valid: {', '.join(tools)})" if tools else "")
    fixtures = {item.name: item for item in cell.fixtures}
    for name, machine in section.machines.items():
        for i, own in enumerate(machine.fixtures):
            if own not in fixtures:
                words = unknown_name("fixture", own, tuple(fixtures))
                yield ("assembly", "machines", name, "fixtures", i), words
    things = (*(part.name for part in section.parts), *fixtures)
    for k, item in enumerate(section.joined):
        for i, name in enumerate(item.parts):
            if name not in things:
                at = ("assembly", "joined", k, "parts", i)
                yield at, unknown_name("part or fixture", name, things)
    names = [robot.name for robot in robots]
    for k, step in enumerate(section.steps):
        at = ("assembly", "steps", k)
        for i, name in enumerate(step.robots or ()):
            if name not in names:
                yield (*at, "robots", i), unknown_name("robot", name, names)
        if step.hold is not None and len(robots) == 1:
            yield (*at, "hold"), "another robot has to hold it, and there is only one"
        if step.at is None or step.at.fixture is None:
            continue
        fixture = fixtures.get(step.at.fixture)
        if fixture is None:
            words = unknown_name("fixture", step.at.fixture, tuple(fixtures))
            yield (*at, "at", "fixture"), words
        elif step.at.frame is not None and step.at.frame not in fixture.frames:
            frames = tuple(fixture.frames)
            words = unknown_frame(fixture.name, step.at.frame, frames)
            yield (*at, "at", "frame"), words

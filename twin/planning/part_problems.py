"""Checks of the steps of an assembly of parts: they name what there is, and can follow each other."""

from __future__ import annotations

from collections.abc import Iterator

from twin.scenario.document.problems import unknown_name
from twin.scenario.document.yaml_text import KeyPath
from twin.scenario.sections.parts import PartsSection, StepSection

Found = Iterator[tuple[KeyPath, str]]


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
            twice = step.place is not None and step.name is None
            earlier = names[known] + 1
            yield (
                at,
                f"{known} is already placed in step {earlier}"
                if twice
                else f"the name {known!r} is already that of step {earlier}",
            )
        names.setdefault(known, k)
    yield from _check_placed_once(section)
    yield from _check_order(section, names)
    yield from _check_joined(section, names)


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
    if step.at is not None and step.at.part is not None:
        if step.at.part not in parts:
            words = unknown_name("part", step.at.part, tuple(parts))
            yield (*at, "at", "part"), words
        elif step.at.frame is not None:
            frames = parts[step.at.part].frames
            if step.at.frame not in frames:
                yield (*at, "at", "frame"), unknown_frame(step.at.frame, tuple(frames))
    if step.hold is not None:
        if step.hold not in parts:
            yield (*at, "hold"), unknown_name("part", step.hold, tuple(parts))
        elif step.hold == step.place:
            words = f"{step.hold} is in the hand of who places it: hold another part"
            yield (*at, "hold"), words


def unknown_frame(name: str, frames: tuple[str, ...]) -> str:
    """Say that something has no frame of a name."""
    return unknown_name("frame", name, frames) if frames else "it has no frames"


def _check_placed_once(section: PartsSection) -> Found:
    seen: dict[str, int] = {}
    for k, step in enumerate(section.steps):
        if step.place is None:
            continue
        if step.place in seen and step.name is not None:
            words = f"{step.place} is already placed in step {seen[step.place] + 1}"
            yield ("assembly", "steps", k, "place"), words
        seen.setdefault(step.place, k)


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

"""Checks of sources and products: names that there are, parts that come from them, room for all."""

from __future__ import annotations

from collections.abc import Iterator

from twin.planning.line.written_out import OUTFEED, presenter
from twin.scenario.document.problems import unknown_name
from twin.scenario.document.yaml_text import KeyPath
from twin.scenario.sections.parts import PartsSection

Found = Iterator[tuple[KeyPath, str]]


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

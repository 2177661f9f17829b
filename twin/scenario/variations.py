"""Inputs that a study varies: ``skills.pick.scale=1,1.5,2`` and what it does to a scenario."""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from planning.errors import ScenarioError
from twin.scenario.sections.scenario import Scenario, resolved, restored

Variant = Mapping[str, Any]
"""A value for each key that is varied."""


@dataclass(frozen=True)
class Variation:
    """A key of the execution section, and the values it takes.

    Attributes:
        key: dotted path below ``execution``, such as ``skills.pick.scale``.
        values: at least one, each once.
    """

    key: str
    values: tuple[Any, ...]


def parse_variation(text: str) -> Variation:
    """Return the variation that ``key=value,value,...`` names; values are JSON or plain words.

    Raises:
        ScenarioError: there is no key, no value, or a value twice.
    """
    key, equals, rest = text.partition("=")
    key = key.strip().removeprefix("execution.")
    if not equals or not key or not rest.strip():
        raise ScenarioError(
            f"cannot vary {text!r}: write key=value,value such as"
            " skills.pick.scale=1,1.5,2"
        )
    values = tuple(_value(item) for item in _split(rest))
    if len({json.dumps(value) for value in values}) < len(values):
        raise ScenarioError(f"cannot vary {text!r}: a value is there twice")
    return Variation(key, values)


def variants(variations: Sequence[Variation]) -> tuple[Variant, ...]:
    """Return every combination of values, the last key changing fastest; one empty if none.

    Raises:
        ScenarioError: a key is varied twice.
    """
    keys = [variation.key for variation in variations]
    for key in keys:
        if keys.count(key) > 1:
            raise ScenarioError(f"{key} is varied twice")
    return tuple(
        dict(zip(keys, values, strict=True))
        for values in itertools.product(*(v.values for v in variations))
    )


def varied(scenario: Scenario, variant: Variant) -> Scenario:
    """Return a scenario in which the keys of a variant have its values.

    Raises:
        ScenarioError: a key is not one of the execution section, or a value does not fit;
            the message names the keys that are valid there.
    """
    if not variant:
        return scenario
    content = resolved(scenario)
    assign_variant(content, variant)
    try:
        return restored(content)
    except ScenarioError as error:
        raise ScenarioError(f"cannot vary {', '.join(variant)}: {error}") from None


def assign_variant(content: dict[str, Any], variant: Variant) -> None:
    """Write the values of a variant into the execution section of a resolved scenario.

    Raises:
        ScenarioError: there is no such key; the message names those there are.
    """
    for key, value in variant.items():
        _assign(content["execution"], key, value)


class _NewSection(dict[str, Any]):
    """A section that the scenario leaves out, made by the first key that is set in it."""


def _assign(tree: dict[str, Any], key: str, value: Any) -> None:
    *path, last = key.split(".")
    if path[:1] == ["skills"] and len(path) > 1:
        # A skill without a section has the packaged timings.
        tree["skills"].setdefault(path[1], {"kind": "packaged", "skill": path[1]})
    if path[:1] == ["failures"] and len(path) > 1:
        tree["failures"].setdefault(path[1], {"probability": 0.0})
    place: Any = tree
    walked = "execution"
    for name in path:
        entry = _entry(place, name, key, walked)
        if place[entry] is None:
            place[entry] = _NewSection()
        place = place[entry]
        walked += f".{name}"
    # What skills, failures and sections that the scenario does not have say of themselves is
    # left to the checks of the section.
    free = path[:1] in (["skills"], ["failures"]) and isinstance(place, dict)
    free = free or isinstance(place, _NewSection)
    place[last if free else _entry(place, last, key, walked)] = value


def _entry(place: Any, name: str, key: str, walked: str) -> str | int:
    """Return the key or position of an entry that is there."""
    if isinstance(place, list):
        if name.isdigit() and int(name) < len(place):
            return int(name)
        raise ScenarioError(
            f"cannot vary {key}: {walked} has no entry {name!r}",
            choices=tuple(str(k) for k in range(len(place))),
        )
    if not isinstance(place, dict):
        raise ScenarioError(f"cannot vary {key}: {walked} is a plain value")
    if name not in place:
        raise ScenarioError(
            f"cannot vary {key}: {walked} has no {name!r}", choices=tuple(place)
        )
    return name


def _split(text: str) -> list[str]:
    """Split at commas that are not inside brackets."""
    items, depth, current = [], 0, ""
    for char in text:
        depth += (char in "[{") - (char in "]}")
        if char == "," and depth == 0:
            items.append(current)
            current = ""
        else:
            current += char
    return [item.strip() for item in (*items, current)]


def _value(text: str) -> Any:
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        return text

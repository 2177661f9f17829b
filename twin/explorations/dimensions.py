"""Design variables ("dimensions") of a design exploration, and the changes of the scenario that a design makes."""

from __future__ import annotations

import copy
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from planning.errors import ScenarioError
from planning.robots.registry import ROBOTS
from twin.document.validation import (
    FileProblem,
    InvalidScenarioError,
    UnknownName,
    parse_document,
    unknown_name,
    validate_document,
)
from twin.document.yaml_text import YamlDocument
from twin.explorations.keys import key_path, resolved_value
from twin.explorations.section import ExploreSection, VarySection, explore_section
from twin.reading.checks import find_problems
from twin.scenario.schema import scenario_schema
from twin.scenario.sections.scenario import Scenario, resolve_scenario
from twin.scenario.variations import Variant, Variation, write_variant

Values = Mapping[str, Any]
"""What a design has at each key that is varied."""

_MOST_DESIGNS = 5000
"""That are counted up where all values are given."""

_MOST_TRIED = 100
"""Values of a key that are looked at before anything is evaluated."""

_NO_DESIGN = {
    "seed": "; all designs see the same draws",
    "name": "",
    "description": "",
    "version": "",
}
"""Keys that change nothing about a cell."""

_NUMBER = r"-?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_RANGE = re.compile(rf"({_NUMBER})\.\.({_NUMBER})$")
_BETWEEN = re.compile(r"[^\[{,]*\.\.[^/,]*$")
"""Patterns of a range, and of text with the dots of one."""

_ORDER = "order"

_PREFIX = re.compile(
    r"^(?:cell\.(?:robots|fixtures|tools)|assembly\.(?:parts|sources)|execution)\."
)
_POSE = re.compile(r"(?:\.pose)?\.(xyz_m|rpy_deg)\.([012])$")
"""Parts of keys omitted in texts, and their names for positions."""


@dataclass(frozen=True)
class Dimension:
    """A varied key.

    Attributes:
        key: of the scenario.
        base: its value there, None where the scenario leaves it out.
        low, high: bounds of numbers; None where there are values or orders.
        choices: the values to choose from; empty for numbers and orders.
        whole: whether numbers are whole ones.
        moves: values of other keys that change by as much as this one.
        mirrors: values of keys that change by the opposite amount.
    """

    key: str
    base: Any
    low: float | None = None
    high: float | None = None
    choices: tuple[Any, ...] = ()
    whole: bool = False
    moves: tuple[tuple[str, float], ...] = ()
    mirrors: tuple[tuple[str, float], ...] = ()

    @property
    def ordered(self) -> bool:
        """True if the dimension is an order of list entries."""
        return self.low is None and not self.choices

    def holds(self, value: Any) -> bool:
        """Return whether a value is in the dimension."""
        if self.low is not None and self.high is not None:
            number = isinstance(value, int | float) and not isinstance(value, bool)
            return number and self.low <= value <= self.high
        if self.choices:
            return value in self.choices
        return (
            isinstance(value, list)
            and len(value) == len(self.base)
            and all(value.count(entry) == self.base.count(entry) for entry in value)
        )

    def change(self, value: Any) -> Variant:
        """Return the changes of a value to the scenario; empty for the scenario's own."""
        if value == self.base:
            return {}
        found = {self.key: value}
        for linked, sign in ((self.moves, 1.0), (self.mirrors, -1.0)):
            for key, base in linked:
                found[key] = base + sign * (value - self.base)
        return found

    def words(self, value: Any) -> str:
        """Return a text on the change of a value."""
        linked = len(self.moves) + len(self.mirrors)
        more = f", and {linked} more with it" if linked else ""
        return self._words(value) + more

    def _words(self, value: Any) -> str:
        name = _PREFIX.sub("", self.key)
        numbers = all(
            isinstance(v, int | float) and not isinstance(v, bool)
            for v in (self.base, value)
        )
        if numbers and (place := _POSE.search(name)):
            axis = "xyz"[int(place[2])]
            by = value - self.base
            if place[1] == "xyz_m":
                return f"{name[: place.start()]} {axis} by {1000.0 * by:+.0f} mm"
            return f"{name[: place.start()]} turned about {axis} by {by:+.3g} deg"
        if numbers:
            return f"{name} {self.base:.5g} -> {value:.5g}"
        if self.ordered:
            return f"{name} in the order {', '.join(map(entry_name, value))}"
        return f"{name} {self.base} -> {value}"


def entry_name(entry: Any) -> str:
    """Return the name of a list entry."""
    if not isinstance(entry, Mapping):
        return str(entry)
    for key in ("name", "place", "part", "process", "brick", "robot"):
        if entry.get(key):
            return str(entry[key])
    return str(entry)


def variant_of(dimensions: Sequence[Dimension], values: Values) -> Variant:
    """Return the changes of a design to the scenario; empty for the base design."""
    found: dict[str, Any] = {}
    for one in dimensions:
        if one.key in values:
            found |= one.change(values[one.key])
    return found


def base_values(dimensions: Sequence[Dimension]) -> Values:
    """Return the scenario's values."""
    return {one.key: one.base for one in dimensions}


def vary_section(text: str) -> VarySection:
    """Parse a dimension ``key=low..high``, ``key=a,b,c`` or ``key=order``.

    Raises:
        ScenarioError: it cannot be read.
    """
    key, _, rest = text.partition("=")
    bounds = _RANGE.match(rest.strip())
    own = key.strip().removeprefix("execution.")
    syntax = "write key=low..high, key=a,b,c or key=order"
    if not own or not rest.strip():
        raise ScenarioError(f"cannot vary {text!r}: {syntax}")
    if not bounds and _BETWEEN.match(rest.strip()):
        words = "low and high of a range are numbers, with two dots between them"
        raise ScenarioError(f"cannot vary {text!r}: {words}; {syntax}")
    try:
        if bounds:
            low, high = map(_number, bounds.groups())
            return VarySection(key=own, low=low, high=high)
        if rest.strip() == _ORDER:
            return VarySection(key=own, order=True)
        found = Variation.parse(text)
        return VarySection(key=found.key, values=found.values)
    except ValueError as error:
        said = str(error).splitlines()
        words = next((line for line in said if "Value error" in line), said[0])
        words = words.strip().removeprefix("Value error, ").partition(" [type=")[0]
        raise ScenarioError(f"cannot vary {text!r}: {words}; {syntax}") from None


def _number(text: str) -> int | float:
    return int(text) if re.fullmatch(r"-?\d+", text) else float(text)


def dimensions_of(
    scenario: Scenario,
    section: ExploreSection,
    document: YamlDocument,
    folder: Path | None = None,
) -> tuple[Dimension, ...]:
    """Return the dimensions of a section, with the scenario's values.

    Args:
        scenario: the explored scenario.
        section: of the file, or made of options.
        document: the file, for places of keys that are wrong.
        folder: where relative paths start: values are then looked at, too, each by itself.

    Raises:
        InvalidScenarioError: a key is not there, or does not fit; with all places in the file.
        ScenarioError: the same, where the file does not have the key.
    """
    content = resolve_scenario(scenario)
    found: list[Dimension] = []
    problems: list[tuple[tuple[str | int, ...], str]] = []
    for number, vary in enumerate(section.vary):
        at = ("explore", "vary", number)
        try:
            one = _dimension(content, vary)
            _refuse(one, found)
            found.append(one)
            if folder is not None:
                _require_possible(scenario, content, folder, one)
        except ScenarioError as error:
            problems.append(((*at, "key"), str(error)))
    for number, expression in enumerate(section.expressions):
        for key in expression.keys:
            try:
                _require_number(
                    key, resolved_value(content, key), "give one of a number"
                )
            except ScenarioError as error:
                goals = len(section.goals)
                place = ("goals", number) if number < goals else ("constraints",)
                problems.append((("explore", *place), str(error)))
    if folder is not None:
        known = _priced(scenario, found)
        problems += (
            (
                ("explore", "prices", name, "[key]"),
                unknown_name("model or tool", name, known),
            )
            for name in section.prices
            if name not in known
        )
    if not problems:
        return tuple(found)
    if explore_section(scenario) == section and document.nearest(problems[0][0]):
        faults: list[FileProblem] = [document.problem(*item) for item in problems]
        raise InvalidScenarioError(document.path, faults, document.lines)
    raise ScenarioError("; ".join(text for _, text in problems))


def _refuse(one: Dimension, others: Sequence[Dimension]) -> None:
    """Refuse a key that another dimension also changes."""
    own = {one.key, *(key for key, _ in (*one.moves, *one.mirrors))}
    for other in others:
        there = {other.key, *(key for key, _ in (*other.moves, *other.mirrors))}
        for key in sorted(own):
            if any(_holds(key, k) or _holds(k, key) for k in there):
                raise ScenarioError(f"{key} is varied twice")


def _priced(scenario: Scenario, dimensions: Sequence[Dimension]) -> tuple[str, ...]:
    """Return the names that may have a price: existing or varied models and tools."""
    robots = scenario.cell.robots
    own = [name for r in robots for name in (r.model, r.tool, *r.tools) if name]
    others = [v for one in dimensions for v in one.choices if isinstance(v, str)]
    come_with = [tool for entry in ROBOTS.values() for tool in entry.tools]
    names = (*own, *scenario.cell.tools, *others, *ROBOTS, *come_with)
    return tuple(dict.fromkeys(names))


def _require_possible(
    scenario: Scenario, content: Mapping[str, Any], folder: Path, one: Dimension
) -> None:
    """Refuse a value that is invalid whatever the other keys are.

    That is one by which something is wrong at the key itself: a number beyond what it may be, or a name
    that nothing has. What is wrong elsewhere because of it, others that vary may set right.
    """
    tried = [one.low, one.high] if one.choices == () else one.choices[:_MOST_TRIED]
    for value in () if one.ordered else tried:
        other = copy.deepcopy(dict(content))
        write_variant(other, {one.key: value})
        path = key_path(other, one.key)
        document = parse_document(Path(scenario.name), json.dumps(other))
        words = f"cannot vary {one.key}: "
        try:
            own = validate_document(document, Scenario, scenario_schema)
        except InvalidScenarioError as error:
            at = document.mark_of(path)
            for problem in error.problems:
                if problem.mark == at:
                    raise ScenarioError(words + problem.message) from None
            continue
        for place, text in find_problems(own, folder):
            if place == path and isinstance(text, UnknownName):
                raise ScenarioError(words + text)


def _holds(key: str, other: str) -> bool:
    """Return whether a key equals another one or is nested in it."""
    return key == other or key.startswith(f"{other}.")


def _dimension(content: Mapping[str, Any], vary: VarySection) -> Dimension:
    key = vary.key
    base = resolved_value(content, key)
    if key in _NO_DESIGN:
        raise ScenarioError(f"cannot vary {key}: it is no design{_NO_DESIGN[key]}")
    if vary.order:
        if not isinstance(base, list) or len(base) < 2:
            raise ScenarioError(f"{key} is no list of two or more entries to order")
        return Dimension(key, base)
    if vary.values is not None:
        return Dimension(key, base, choices=tuple(map(_as_json, vary.values)))
    low, high = vary.low, vary.high
    assert low is not None
    assert high is not None
    _require_number(key, base)
    whole = all(isinstance(v, int) for v in (low, high)) and isinstance(
        base, int | None
    )
    linked = [
        tuple(
            (name, float(_require_number(name, resolved_value(content, name))))
            for name in names
        )
        for names in (vary.moves, vary.mirrors)
    ]
    if base is None and any(linked):
        raise ScenarioError(
            f"{key} has no value in the scenario that others could follow"
        )
    if whole:
        return Dimension(key, base, low, high, (), True, *linked)
    plain = None if base is None else float(base)
    return Dimension(key, plain, float(low), float(high), (), False, *linked)


def _as_json(value: Any) -> Any:
    """Return a value as a JSON type: lists for tuples."""
    if isinstance(value, tuple | list):
        return [_as_json(item) for item in value]
    if isinstance(value, Mapping):
        return {key: _as_json(item) for key, item in value.items()}
    return value


def _require_number(key: str, value: Any, advice: str = "give its values") -> Any:
    if isinstance(value, bool) or not isinstance(value, int | float | None):
        raise ScenarioError(f"{key} is no number, but {value!r}: {advice}")
    return 0.0 if value is None else value


def key_of(values: Values) -> str:
    """Return values as a text, the same for the same design."""
    return json.dumps(values, sort_keys=True)


def all_designs(dimensions: Sequence[Dimension]) -> list[Values]:
    """Return all designs of a finite space; else none."""
    given: list[Sequence[Any]] = []
    for one in dimensions:
        if one.whole and one.low is not None and one.high is not None:
            given.append(range(int(one.low), int(one.high) + 1))
        else:
            given.append(one.choices)
    if not 0 < math.prod(map(len, given)) <= _MOST_DESIGNS:
        return []
    keys = [one.key for one in dimensions]
    return [dict(zip(keys, values, strict=True)) for values in product(*given)]

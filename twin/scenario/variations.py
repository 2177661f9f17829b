"""Variations of scenario keys: ``skills.pick.scale=1,1.5,2``, applied to a scenario.

A key is a dotted path from the top of the scenario, or from its execution section. Entries of lists are addressed by
position or by name: ``cell.robots.left.base.xyz_m.0``. A distribution is given as a whole,
``jitter={kind: uniform, low_s: 0, high_s: 1}``, or key by key, ``jitter.kind=uniform``.
"""

from __future__ import annotations

import copy
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from planning.errors import ScenarioError
from planning.json_files import parse_json
from planning.tasks.task import TaskKind
from twin.document.validation import (
    InvalidScenarioError,
    parse_document,
    validate_document,
)
from twin.document.yaml_text import read_yaml
from twin.registry import DURATIONS
from twin.scenario.schema import scenario_schema
from twin.scenario.sections.cell import choose_robots
from twin.scenario.sections.scenario import Scenario, resolve_scenario

ROBOTS = "robots"
"""The key that is not one of the file: the number of robots, of the team where there is one."""

_SECTIONS = frozenset(Scenario.model_fields) - {"execution", "explore"}

Variant = Mapping[str, Any]
"""A value for each key that is varied."""


@dataclass(frozen=True)
class Variation:
    """A key of a scenario with a list of values.

    Attributes:
        key: dotted path from the top, such as ``cell.robots.left.base.xyz_m.0``, or below
            ``execution``, such as ``skills.pick.scale``.
        values: at least one, each once.
    """

    key: str
    values: tuple[Any, ...]

    @classmethod
    def of(cls, key: str, values: Iterable[Any]) -> Variation:
        """Return the variation of a key over values; those of numpy become plain ones.

        Raises:
            ScenarioError: these are no values, there are none, or one is there twice.
        """
        if isinstance(values, str) or not isinstance(values, Iterable):
            raise ScenarioError(
                f"cannot vary {key}: a list of values expected, not {values!r}"
            )
        plain = tuple(map(_plain, values))
        if not plain:
            raise ScenarioError(f"cannot vary {key}: no values")
        if len({json.dumps(value) for value in plain}) < len(plain):
            raise ScenarioError(f"cannot vary {key}: a value is there twice")
        return cls(short_key(key), plain)

    @classmethod
    def parse(cls, text: str) -> Variation:
        """Parse a variation ``key=value,value,...``.

        Values are JSON, lists and mappings in one line of YAML, or plain words.

        Raises:
            ScenarioError: there is no key, no value, or a value twice, or what is in brackets cannot
                be read.
        """
        key, equals, rest = text.partition("=")
        key = short_key(key.strip())
        if not equals or not key or not rest.strip():
            raise ScenarioError(
                f"cannot vary {text!r}: write key=value,value such as"
                " skills.pick.scale=1,1.5,2"
            )
        return cls.of(key, [_value(item) for item in _split(rest)])


def _plain(value: Any) -> Any:
    """Return a value as a JSON type."""
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def apply_variation(scenario: Scenario, variant: Variant) -> Scenario:
    """Return a scenario in which the keys of a variant have its values.

    Raises:
        ScenarioError: there is no such key, or a value does not fit; the message names the
            keys that are valid there.
    """
    if not variant:
        return scenario
    content = resolve_scenario(scenario)
    write_variant(content, variant)
    # JSON is YAML, too: errors are worded as in a file.
    document = parse_document(Path(scenario.name), json.dumps(content))
    try:
        return validate_document(document, Scenario, scenario_schema)
    except InvalidScenarioError as error:
        said = "; ".join(problem.message for problem in error.problems)
        raise ScenarioError(f"cannot vary {', '.join(variant)}: {said}") from None


def short_key(key: str) -> str:
    """Return a key for display: one of the execution section without the section's name."""
    own = key.removeprefix("execution.")
    return own if is_of_execution(own) else key


def is_of_execution(key: str) -> bool:
    """Return whether a key is in the execution section, which no plan depends on."""
    first = key.partition(".")[0]
    return first != ROBOTS and first not in _SECTIONS


def layout_of(variant: Variant) -> Variant:
    """Return the values of a variant that a plan depends on."""
    return {key: value for key, value in variant.items() if not is_of_execution(key)}


def write_variant(content: dict[str, Any], variant: Variant) -> None:
    """Write the values of a variant into a resolved scenario.

    Raises:
        ScenarioError: there is no such key; the message names those there are.
    """
    keys = [short_key(key) for key in variant]
    if twice := [key for key in keys if keys.count(key) > 1]:
        raise ScenarioError(f"{twice[0]} is varied twice")
    variant = dict(zip(keys, variant.values(), strict=True))
    # Setting the kind of a distribution removes the numbers of the old kind.
    for key in sorted(variant, key=lambda key: not key.endswith(".kind")):
        value = _plain(variant[key])
        if key == ROBOTS:
            continue
        if is_of_execution(key):
            _make_entries(content, key)
            _assign(content["execution"], key, value, "execution")
        else:
            _assign(content, key, value, "")
    if ROBOTS in variant:  # last, as other keys may be those of robots that go
        count = variant[ROBOTS]
        if not isinstance(count, int) or count < 1:
            raise ScenarioError(f"cannot vary robots: no number of robots: {count!r}")
        choose_robots(content["cell"], count)


class _FreeSection(dict[str, Any]):
    """A section whose keys are not checked here: it is new, or they depend on its kind."""


def _make_entries(content: dict[str, Any], key: str) -> None:
    """Create the missing section of a skill or disturbance."""
    section, _, rest = key.partition(".")
    skill = rest.partition(".")[0]
    execution = content["execution"]
    processes = content["assembly"].get("processes", {})
    if section in ("skills", "failures") and rest:
        named = (*execution["skills"], *execution["failures"], *processes)
        known = tuple(dict.fromkeys((*TaskKind.SKILLS, TaskKind.HOLD, *named)))
        if skill not in known:
            raise ScenarioError(
                f"cannot vary {key}: there is no skill {skill!r}", choices=known
            )
    if section == "skills" and rest:
        # A process without a section has its own duration.
        said = processes.get(skill, {}).get("duration") or {}
        own = execution["skills"].setdefault(skill, copy.deepcopy(said))
        execution["skills"][skill] = _FreeSection(own)
    if section == "failures" and rest:
        own = execution["failures"].setdefault(skill, {"probability": 0.0})
        execution["failures"][skill] = _FreeSection(own)


def _assign(tree: dict[str, Any], key: str, value: Any, walked: str) -> None:
    """Write a value at a dotted key of keys, positions and names of entries."""
    words = key.split(".")
    place: Any = tree
    while True:
        if isinstance(place, _FreeSection) and len(words) > 1:
            if words[1].isdigit() and words[0] not in place:
                whole = f"{walked}.{words[0]}"
                raise ScenarioError(
                    f"cannot vary {key}: the scenario leaves {walked} out; give {whole} as a whole"
                )
            place.setdefault(words[0], _FreeSection())
        elif isinstance(place, _FreeSection):
            if words[0].isdigit():
                raise ScenarioError(
                    f"cannot vary {key}: the scenario leaves {walked} out; give it as a whole"
                )
            place[words[0]] = value
            return
        entry, used = find_entry(place, words, key, walked)
        if used == len(words):
            place[entry] = value
            return
        walked = ".".join(filter(None, (walked, *words[:used])))
        words, found = words[used:], place[entry]
        if found in (None, {}) or (words == ["kind"] and _is_other(found, value)):
            place[entry] = _FreeSection()
        place = place[entry]


def _is_other(place: Any, kind: Any) -> bool:
    """Return whether a section is a distribution of another kind, which keeps nothing of the former."""
    if not isinstance(place, dict):
        return False
    kinds = {str(kind), str(place.get("kind"))}
    return len(kinds) == 2 and kinds <= {*DURATIONS.names(), "reference"}


def find_entry(
    place: Any, words: Sequence[str], key: str, walked: str
) -> tuple[str | int, int]:
    """Return the entry named by the first words, and their number: names may contain dots."""
    if isinstance(place, dict):
        entries: dict[str, str | int] = {name: name for name in place}
    elif isinstance(place, list):
        entries = {str(k): k for k in range(len(place))}
        entries |= {
            item["name"]: k
            for k, item in enumerate(place)
            if isinstance(item, dict) and isinstance(item.get("name"), str)
        }
    else:
        raise ScenarioError(f"cannot vary {key}: {walked} is a plain value")
    for used in range(len(words), 0, -1):
        if (name := ".".join(words[:used])) in entries:
            return entries[name], used
    here = f"{walked} has" if walked else "a scenario has"
    what = f"no entry {words[0]!r}" if isinstance(place, list) else f"no {words[0]!r}"
    others = [*sorted(_SECTIONS), ROBOTS] if walked == "execution" else []
    raise ScenarioError(
        f"cannot vary {key}: {here} {what}", choices=(*entries, *others)
    )


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
        return parse_json(text)
    except json.JSONDecodeError:
        if text[:1] not in ("{", "["):
            return text
    except ValueError as error:
        raise ScenarioError(f"cannot read {text[:60]!r}: {error}") from None
    document = read_yaml(Path(), text)
    for problem in document.problems:
        raise ScenarioError(f"cannot read {text!r}: {problem.message}")
    return document.data

"""Look-up of keys in a resolved scenario: their full paths and their values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from twin.document.yaml_text import KeyPath
from twin.scenario.variations import ROBOTS, find_entry, is_of_execution


def resolved_value(content: Mapping[str, Any], key: str) -> Any:
    """Return the value of a key in a resolved scenario, or None if the scenario omits the key.

    Raises:
        ScenarioError: there is no such key; the message names those there are.
    """
    if key == ROBOTS:
        team = content["cell"]["team"]
        return len(content["cell"]["robots"]) if team is None else team["count"]
    return _found(content, key)[1]


def key_path(content: Mapping[str, Any], key: str) -> KeyPath:
    """Return the full path of a key in a resolved scenario.

    Raises:
        ScenarioError: there is no such key; the message names those there are.
    """
    if key == ROBOTS:
        team = content["cell"]["team"] is not None
        return ("cell", "team", "count") if team else ("cell", "robots")
    return _found(content, key)[0]


def _found(content: Mapping[str, Any], key: str) -> tuple[KeyPath, Any]:
    """Return the existing part of a key's path and its value; None without a value."""
    inside = is_of_execution(key)
    place: Any = content["execution"] if inside else content
    words, walked = key.split("."), "execution" if inside else ""
    path: KeyPath = ("execution",) if inside else ()
    while words:
        if place is None or (inside and isinstance(place, dict) and not place):
            return path, None
        free = walked in ("execution.skills", "execution.failures")
        if free and words[0] not in place:
            return path, None
        entry, used = find_entry(place, words, key, walked)
        walked = ".".join(filter(None, (walked, *words[:used])))
        place, words, path = place[entry], words[used:], (*path, entry)
    return path, place

"""Changes of single values in the text of a YAML file: comments, order and layout of all else stay."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import yaml

from planning.errors import RequestError
from twin.document.yaml_text import KeyPath, plain_scalar

_DIGITS = 6
"""Decimals to which numbers are written."""

_MAPPINGS = (("assembly", "sources"),)
"""Paths of what is given by name."""


def with_value(text: str, path: KeyPath, value: Any) -> str:
    """Return a YAML text with the value at a path replaced or, where the last key is missing, added.

    Args:
        text: a valid YAML text.
        path: keys and positions of lists from the top.
        value: numbers, texts, lists and dicts, written in flow style.

    Raises:
        RequestError: there is no place for the value, or the text has aliases or is not YAML.
    """
    parent, last = _node_at(text, path[:-1]), path[-1]
    found = _child(parent, last)
    if found is not None:
        begin, end = found.start_mark.index, _end(text, found)
        return text[:begin] + _flow(value) + text[end:]
    if not isinstance(parent, yaml.MappingNode):
        raise RequestError(f"nothing at {_words(path)}")
    return _inserted(text, parent, f"{last}: {_flow(value)}")


def with_entry(text: str, path: KeyPath, value: Any) -> str:
    """Return a YAML text with an entry appended to the list, or added to the mapping by its ``name``, at a path.

    Where there is neither, a list is begun, and a mapping for keys of ``_MAPPINGS``.

    Raises:
        RequestError: there is no list or mapping.
    """
    above = _node_at(text, path[:-1])
    parent = _child(above, path[-1])
    by_name = isinstance(parent, yaml.MappingNode) or path in _MAPPINGS
    if by_name:
        rest = {key: own for key, own in value.items() if key != "name"}
    if parent is None:
        return with_value(text, path, {value["name"]: rest} if by_name else [value])
    if isinstance(parent, yaml.MappingNode):
        return _inserted(text, parent, f"{value['name']}: {_flow(rest)}")
    if not isinstance(parent, yaml.SequenceNode):
        raise RequestError(f"no list at {_words(path)}")
    return _inserted(text, parent, _flow(value), "" if parent.flow_style else "- ")


def _inserted(
    text: str, parent: yaml.CollectionNode, entry: str, dash: str = ""
) -> str:
    """Return the text with an entry after the last one of a mapping or list."""
    entries = parent.value
    if parent.flow_style or not entries:
        at = _end(text, parent) - 1
        comma = ", " if entries else ""
        return text[:at].rstrip(" ") + comma + entry + text[at:]
    last = entries[-1]
    key, final = last if isinstance(last, tuple) else (last, last)
    column = key.start_mark.column - (2 if dash else 0)
    end = _end(text, final)
    line_end = text.find("\n", end)
    at = len(text) if line_end < 0 else line_end
    return f"{text[:at]}\n{' ' * column}{dash}{entry}{text[at:]}"


def _node_at(text: str, path: KeyPath) -> yaml.Node:
    """Return the node at a path."""
    try:
        aliases = any(isinstance(own, yaml.AliasEvent) for own in yaml.parse(text))
        node: yaml.Node | None = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.YAMLError:
        words = "the file is not valid: undo the last change, or read it again"
        raise RequestError(words) from None
    if aliases:
        raise RequestError("a file with aliases (*NAME) can only be changed by hand")
    if node is None:
        raise RequestError("the file is empty")
    for k, entry in enumerate(path):
        found = _child(node, entry)
        if found is None:
            raise RequestError(f"nothing at {_words(path[: k + 1])}")
        node = found
    return node


def _child(node: yaml.Node, entry: Any) -> yaml.Node | None:
    if isinstance(node, yaml.MappingNode):
        return next((own for key, own in node.value if key.value == entry), None)
    if isinstance(node, yaml.SequenceNode) and isinstance(entry, int):
        return node.value[entry] if entry < len(node.value) else None
    return None


def _end(text: str, node: yaml.Node) -> int:
    """Return where the text of a node ends: block collections end in PyYAML at what follows them."""
    if not isinstance(node, yaml.CollectionNode) or node.flow_style or not node.value:
        return node.end_mark.index
    last = node.value[-1]
    return _end(text, last[1] if isinstance(last, tuple) else last)


def _flow(value: Any) -> str:
    """Return a value as YAML in flow style."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{k}: {_flow(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_flow, value)) + "]"
    if isinstance(value, float):
        rounded = round(value, _DIGITS) + 0.0
        return str(int(rounded)) if rounded == int(rounded) else repr(rounded)
    if isinstance(value, str) and value.isidentifier() and plain_scalar(value) == value:
        return value
    return json.dumps(value)


def _words(path: KeyPath) -> str:
    return ".".join(map(str, path))

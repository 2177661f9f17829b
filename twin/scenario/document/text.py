"""Writer of scenarios as YAML that people like to read: one line an entry."""

from __future__ import annotations

from typing import Any

import yaml

from twin.scenario.document.yaml_text import plain_scalar

_WIDTH = 100
"""Columns of a line of YAML, about."""


class _Dumper(yaml.SafeDumper):
    """Writes what fits on a line on one line, and indents lists."""

    def increase_indent(self, flow: bool = False, indentless: bool = False) -> None:
        super().increase_indent(flow, False)

    def represent_data(self, data: Any) -> yaml.Node:
        node = super().represent_data(data)
        if isinstance(node, yaml.CollectionNode) and _is_short(data):
            node.flow_style = True
        quoted = isinstance(data, str) and plain_scalar(data) != data
        if isinstance(node, yaml.ScalarNode) and quoted:
            node.style = "'"  # YAML 1.1, which PyYAML writes, reads some as text
        return node


def scenario_text(content: dict[str, Any], note: str) -> str:
    """Return a scenario file.

    Args:
        content: what the file says, as plain dictionaries, lists and scalars.
        note: goes on top as a comment.
    """
    body = yaml.dump(
        content,
        Dumper=_Dumper,
        sort_keys=False,
        width=_WIDTH + 60,
        default_flow_style=False,
    )
    return "".join(f"# {line}\n" for line in note.splitlines()) + body


def _is_short(data: Any) -> bool:
    """Tell whether a list or mapping holds little, and nothing that wants its own lines."""
    if isinstance(data, list) and any(isinstance(v, dict) for v in data):
        return False
    return len(repr(data)) <= _WIDTH and _depth(data) <= 3


def _depth(data: Any) -> int:
    if isinstance(data, dict):
        return 1 + max((_depth(v) for v in data.values()), default=0)
    if isinstance(data, list):
        return 1 + max((_depth(v) for v in data), default=0)
    return 0

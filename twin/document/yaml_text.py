"""Strict YAML reader: one document, no repeated keys, numbers of YAML 1.2, and the position of every value.

PyYAML follows YAML 1.1, where ``on`` is true, ``1e3`` is text and ``1:30`` is ninety. It also accepts repeated keys
and keeps the last value. Such values in a scenario would be silent mistakes. So this module uses PyYAML only to
parse the document to nodes, which have a line and column, and constructs the values itself.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

Spot = tuple[int, int]
"""Line and column within a text value, both counted from 0."""

KeyPath = tuple[str | int | Spot, ...]
"""Keys and list positions from the top of the document to a value, optionally with a position in its text.

A path that ends in ``"[key]"`` refers to the last key, not to its value.
"""

# Nested aliases can multiply values without bound; no real scenario has nearly so many.
_MOST_NODES = 500_000

_PLAIN_TAGS = ("tag:yaml.org,2002:map", "tag:yaml.org,2002:seq")

# Scenarios are nested six levels deep; the JSON reader of pydantic allows two hundred.
_DEEPEST = 60

LARGEST_TEXT = 8 << 20
"""Greatest number of characters in a document, which takes about a minute to parse."""

# Longer integers are no quantities, and Python refuses to parse those of more than 4300 digits.
_LONGEST_INT = 40

_BOOL = re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$")
_NULL = re.compile(r"^(?:~|null|Null|NULL|)$")
_INT = re.compile(r"^[-+]?[0-9]+$")
_OCT_HEX = re.compile(r"^0o[0-7]+$|^0x[0-9a-fA-F]+$")
_FLOAT = re.compile(
    r"^[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?$"
    r"|^[-+]?\.(?:inf|Inf|INF)$|^\.(?:nan|NaN|NAN)$"
)

_WIDTH = 100
"""Approximate number of columns of a line of YAML."""


@dataclass(frozen=True)
class Mark:
    """A position in a file, both numbers counted from 1."""

    line: int
    column: int


@dataclass(frozen=True)
class FileProblem:
    """A problem of a file.

    Attributes:
        mark: its position.
        message: the problem and its remedy.
    """

    mark: Mark
    message: str


class Elsewhere(str):
    """A message that refers to another position in the file, which is appended as line:column.

    Attributes:
        at: path to the value at the other position.
    """

    at: KeyPath

    def __new__(cls, message: str, at: KeyPath) -> Elsewhere:
        """Return the message with the position."""
        made = super().__new__(cls, message)
        made.at = at
        return made


@dataclass(frozen=True)
class YamlDocument:
    """A parsed file.

    Attributes:
        path: where it was read from.
        lines: the source text, line by line.
        data: dicts with text keys, lists, and scalars.
        keys: where the key of each mapping entry is written.
        values: where each value is written.
        problems: problems of the document as YAML.
    """

    path: Path
    lines: tuple[str, ...]
    data: Any
    keys: dict[KeyPath, Mark] = field(default_factory=dict)
    values: dict[KeyPath, Mark] = field(default_factory=dict)
    problems: tuple[FileProblem, ...] = ()

    def nearest(self, path: KeyPath) -> KeyPath:
        """Return ``path`` without the entries that are not in the document.

        Validators name parts of a path that nobody wrote, such as the tag of a union.
        """
        at: KeyPath = ()
        for entry in path:
            if (*at, entry) in self.values:
                at = (*at, entry)
        return at

    def mark_of(self, path: KeyPath, *, key: bool = False) -> Mark:
        """Return the position of the value at ``path``, or of its key, or of its container.

        A position in a text is exact only in a block (``|``), whose text starts on the line after its mark.
        Otherwise the position of the whole text is returned.
        """
        at = self.nearest(path)
        if key and at in self.keys:
            return self.keys[at]
        mark = self.values.get(at, Mark(1, 1))
        if not path or not isinstance(path[-1], tuple):
            return mark
        row, (line, column) = mark.line, path[-1]
        head = self.lines[row - 1][mark.column - 1 :]
        if not head.startswith("|") or row + line >= len(self.lines):
            return mark
        first = next((text for text in self.lines[row:] if text.strip()), "")
        indent = len(first) - len(first.lstrip(" "))
        return Mark(row + line + 1, indent + column + 1)

    def problem(self, path: KeyPath, message: str) -> FileProblem:
        """Return a problem at ``path``; problems of names are reported at their key."""
        if isinstance(message, Elsewhere):
            other = self._mark_of_named(message.at)
            message = f"{message} at {other.line}:{other.column}"
        return FileProblem(self._mark_of_named(path), message)

    def _mark_of_named(self, path: KeyPath) -> Mark:
        key = path[-1:] in (("name",), ("[key]",))
        return self.mark_of(path, key=key)


def read_yaml(path: Path, text: str) -> YamlDocument:
    """Parse ``text`` strictly; problems are listed in the result, never raised."""
    if len(text) > LARGEST_TEXT:
        words = f"the file has more than {LARGEST_TEXT >> 20} million characters"
        problem = FileProblem(Mark(1, 1), words)
        return YamlDocument(path, ("",), None, problems=(problem,))
    lines = tuple(text.splitlines()) or ("",)
    try:
        nodes = list(yaml.compose_all(text, Loader=yaml.SafeLoader))
    except yaml.YAMLError as error:
        return YamlDocument(path, lines, None, problems=(_syntax_problem(text, error),))
    except RecursionError:
        problem = FileProblem(Mark(1, 1), "the file is nested too deeply")
        return YamlDocument(path, lines, None, problems=(problem,))
    if not nodes or nodes[0] is None:
        problem = FileProblem(Mark(1, 1), "the file is empty")
        return YamlDocument(path, lines, None, problems=(problem,))
    builder = _Builder()
    if len(nodes) > 1 and nodes[1] is not None:
        builder.report(
            nodes[1], "a second document starts here: one file, one scenario"
        )
    data = builder.build(nodes[0], ())
    return YamlDocument(
        path, lines, data, builder.keys, builder.values, tuple(builder.problems)
    )


def _syntax_problem(text: str, error: yaml.YAMLError) -> FileProblem:
    if isinstance(error, yaml.MarkedYAMLError):
        mark = error.problem_mark or error.context_mark
        parts = [p for p in (error.context, error.problem) if p]
        text = ", ".join(parts) or "cannot be parsed"
        if "'\\t'" in text:
            text += " (indent with spaces, not tabs)"
        place = Mark(mark.line + 1, mark.column + 1) if mark else Mark(1, 1)
        return FileProblem(place, f"not valid YAML: {text}")
    if isinstance(error, yaml.reader.ReaderError):
        before = text[: error.position]
        place = Mark(before.count("\n") + 1, error.position - before.rfind("\n"))
        return FileProblem(place, f"not a text file: {error.reason}")
    return FileProblem(Mark(1, 1), f"not valid YAML: {error}")


class _Builder:
    """Converts composed nodes to values with their positions."""

    def __init__(self) -> None:
        self.keys: dict[KeyPath, Mark] = {}
        self.values: dict[KeyPath, Mark] = {}
        self.problems: list[FileProblem] = []
        self._open: set[int] = set()
        self._count = 0

    def report(self, node: yaml.Node, message: str) -> None:
        """Note a problem at the start of ``node``."""
        problem = FileProblem(_mark(node), message)
        if problem not in self.problems:
            self.problems.append(problem)

    def build(self, node: yaml.Node, path: KeyPath) -> Any:
        """Return the value of ``node`` at ``path``."""
        self.values[path] = _mark(node)
        self._count += 1
        if self._count > _MOST_NODES:
            self.report(node, f"more than {_MOST_NODES} values")
            return None
        if len(path) > _DEEPEST:
            self.report(node, f"nested more than {_DEEPEST} deep")
            return None
        if id(node) in self._open:
            self.report(node, "an alias refers to something that contains it")
            return None
        if isinstance(node, yaml.CollectionNode) and node.tag not in _PLAIN_TAGS:
            self.report(node, f"tag {node.tag!r} is not supported")
            return None
        self._open.add(id(node))
        try:
            if isinstance(node, yaml.MappingNode):
                return self._mapping(node, path)
            if isinstance(node, yaml.SequenceNode):
                return [self.build(n, (*path, i)) for i, n in enumerate(node.value)]
            if isinstance(node, yaml.ScalarNode):
                return self._scalar(node)
            raise TypeError(f"unknown kind of node: {node!r}")
        finally:
            self._open.remove(id(node))

    def _mapping(self, node: yaml.MappingNode, path: KeyPath) -> dict[str, Any]:
        out: dict[str, Any] = {}
        for key_node, value_node in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                self.report(key_node, "a key must be plain text")
                continue
            key = str(key_node.value)
            if key == "<<":
                self.report(key_node, "merge keys (<<) are not supported")
                continue
            if key in out:
                first = self.keys[(*path, key)]
                self.report(
                    key_node, f"key {key!r} is already given on line {first.line}"
                )
                continue
            self.keys[(*path, key)] = _mark(key_node)
            out[key] = self.build(value_node, (*path, key))
        return out

    def _scalar(self, node: yaml.ScalarNode) -> Any:
        text = str(node.value)
        if node.style is not None:  # a quoted or block scalar is always text
            return text
        standard = "tag:yaml.org,2002:"
        if not node.tag.startswith(standard) or "python" in node.tag:
            self.report(node, f"tag {node.tag!r} is not supported")
            return None
        return plain_scalar(text)


def plain_scalar(text: str) -> Any:
    """Return the value of an unquoted scalar in the core schema of YAML 1.2."""
    if _NULL.match(text):
        return None
    if _BOOL.match(text):
        return text.lower() == "true"
    if _INT.match(text) and len(text) < _LONGEST_INT:
        return int(text)
    if _OCT_HEX.match(text) and len(text) < _LONGEST_INT:
        return int(text, 0)
    if _FLOAT.match(text):
        return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
    return text


def _mark(node: yaml.Node) -> Mark:
    return Mark(node.start_mark.line + 1, node.start_mark.column + 1)


class _Dumper(yaml.SafeDumper):
    """Writes short lists and mappings on one line, and indents lists."""

    def increase_indent(self, flow: bool = False, indentless: bool = False) -> None:
        super().increase_indent(flow, False)

    def represent_data(self, data: Any) -> yaml.Node:
        node = super().represent_data(data)
        if isinstance(node, yaml.CollectionNode) and _is_short(data):
            node.flow_style = True
        quoted = isinstance(data, str) and plain_scalar(data) != data
        if isinstance(node, yaml.ScalarNode) and quoted:
            node.style = (
                "'"  # PyYAML writes YAML 1.1, in which some of these are plain text
            )
        return node


def scenario_text(content: dict[str, Any], note: str) -> str:
    """Return a scenario file.

    Args:
        content: its content, as plain dictionaries, lists and scalars.
        note: comment at the top.
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
    """Return whether a list or mapping is short and fits on one line."""
    if isinstance(data, list) and any(isinstance(v, dict) for v in data):
        return False
    return len(repr(data)) <= _WIDTH and _depth(data) <= 3


def _depth(data: Any) -> int:
    if isinstance(data, dict):
        return 1 + max((_depth(v) for v in data.values()), default=0)
    if isinstance(data, list):
        return 1 + max((_depth(v) for v in data), default=0)
    return 0

"""Validation of input files with pydantic, with error messages for the authors of these files."""

from __future__ import annotations

import difflib
import json
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from planning.errors import ScenarioError
from twin.document.yaml_text import FileProblem as FileProblem
from twin.document.yaml_text import KeyPath, Mark, YamlDocument, read_yaml

# Longest first, so that "rad_s" is not read as "s".
_UNITS = (
    "rad_s", "deg_s", "rad", "deg", "grams", "kg", "mm", "cm", "km", "ms", "min", "ns",
    "us", "in", "lb", "m", "s", "g", "h",
)  # fmt: skip
_UNIT_WORDS = {
    "m": "metres",
    "s": "seconds",
    "deg": "degrees",
    "rad": "radians",
    "kg": "kilograms",
    "rad_s": "radians per second",
}


Problems = Iterator[tuple[KeyPath, str]]
"""Problems of a scenario: pairs of a key and a message."""

# Kinds of pydantic's errors, and what was expected.
_EXPECTED = {
    "string_type": "text",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "finite_number": "a finite number",
    "bool_type": "true or false",
    "tuple_type": "a list [..]",
    "list_type": "a list [..]",
    "model_type": "a mapping (key: value)",
    "model_attributes_type": "a mapping (key: value)",
    "dict_type": "a mapping (key: value)",
}
_BOUNDS = {
    "greater_than": ("gt", "must be greater than"),
    "greater_than_equal": ("ge", "must be at least"),
    "less_than": ("lt", "must be less than"),
    "less_than_equal": ("le", "must be at most"),
}


Model = TypeVar("Model", bound=BaseModel)


class InvalidScenarioError(ScenarioError):
    """A scenario file is invalid; holds all problems.

    Attributes:
        path: the file.
        problems: in the order of the file.
        lines: source lines, for the excerpt under each message.
    """

    def __init__(
        self, path: Path, problems: Iterable[FileProblem], lines: Sequence[str] = ()
    ) -> None:
        self.path = path
        self.lines = tuple(lines)
        self.problems = tuple(
            sorted(set(problems), key=lambda p: (p.mark.line, p.mark.column, p.message))
        )
        super().__init__("\n".join(self.headline(p) for p in self.problems))

    def headline(self, problem: FileProblem) -> str:
        """Return ``file:line:column: message``; without a place where there is no text."""
        if not self.lines:
            return f"{self.path}: {problem.message}"
        mark = problem.mark
        return f"{self.path}:{mark.line}:{mark.column}: {problem.message}"

    def excerpt(self, problem: FileProblem) -> str:
        """Return the source line with a caret under the place; empty where there is none."""
        row = problem.mark.line - 1
        if not 0 <= row < len(self.lines) or not self.lines[row].strip():
            return ""
        start, width = 0, 100
        line, column = self.lines[row].replace("\t", " "), problem.mark.column - 1
        if len(line) > width:
            start = max(0, min(column - width // 2, len(line) - width))
            line = line[start : start + width]
        gutter = f"{problem.mark.line:>5} | "
        return f"{gutter}{line}\n{' ' * (len(gutter) - 2)}| {' ' * (column - start)}^"

    def report(self) -> str:
        """Return all problems with their excerpts, for a terminal."""
        parts = []
        for problem in self.problems:
            parts.append(self.headline(problem))
            if excerpt := self.excerpt(problem):
                parts.append(excerpt)
        return "\n".join(parts)


def closest_key(key: str, valid: Sequence[str]) -> str | None:
    """Return the most similar valid key, None when none is near."""
    stem, unit = _split_unit(key)
    for name in valid:
        valid_stem, valid_unit = _split_unit(name)
        if stem == valid_stem and unit != valid_unit and valid_unit:
            return name
    return next(iter(difflib.get_close_matches(key, valid, n=1, cutoff=0.6)), None)


def unknown_key(key: str, valid: Sequence[str]) -> str:
    """Return a message on an unknown key, with the most similar key and its unit."""
    meant = closest_key(key, valid)
    if meant is not None:
        (stem, unit), (meant_stem, meant_unit) = _split_unit(key), _split_unit(meant)
        if stem == meant_stem and unit != meant_unit:
            word = _UNIT_WORDS.get(meant_unit, meant_unit)
            return f"unknown key {key!r}: this quantity is in {word}, as {meant!r}"
    hint = f"; did you mean {meant!r}?" if meant is not None else ""
    known = f" (valid: {', '.join(valid)})" if valid else ""
    return f"unknown key {key!r}{hint}{known}"


class UnknownName(str):
    """Message of a problem caused by an unknown name."""

    __slots__ = ()


def unknown_name(what: str, name: str, valid: Sequence[str]) -> UnknownName:
    """Return a message on an unknown name, with the most similar one."""
    close = difflib.get_close_matches(name, valid, n=1, cutoff=0.6)
    hint = f"; did you mean {close[0]!r}?" if close else ""
    known = f" (valid: {', '.join(valid)})" if valid else ": there is none"
    return UnknownName(f"unknown {what} {name!r}{hint}{known}")


def check_known_name(
    at: KeyPath, what: str, name: str | None, valid: Collection[str], none: str = ""
) -> Problems:
    """Yield a problem if a given name is unknown.

    Args:
        at: its key.
        what: the kind of named thing.
        name: the name.
        valid: those there are.
        none: message where there are none.
    """
    if name is not None and name not in valid:
        said = none if not valid else ""
        yield at, said or unknown_name(what, name, tuple(valid))


def _split_unit(key: str) -> tuple[str, str]:
    for unit in _UNITS:
        if key.endswith("_" + unit):
            return key[: -len(unit) - 1], unit
    return key, ""


def parse_document(path: Path, text: str) -> YamlDocument:
    """Return the content of a file, as far as it is YAML.

    Raises:
        InvalidScenarioError: it is no YAML at all, or empty.
    """
    document = read_yaml(path, text)
    if document.data is None:
        problems = document.problems or [FileProblem(Mark(1, 1), "the file is empty")]
        raise InvalidScenarioError(path, problems, document.lines)
    return document


def validate_document(
    document: YamlDocument, model: type[Model], schema: Callable[[], dict[str, Any]]
) -> Model:
    """Return the section in a document.

    Args:
        document: a file.
        model: the type of the section.
        schema: returns the JSON schema of that: it is made where something is wrong.

    Raises:
        InvalidScenarioError: with all that is wrong with single values.
    """
    try:
        # Validating JSON text, not Python objects: strict mode then takes lists for tuples.
        return model.model_validate_json(json.dumps(document.data))
    except ValidationError as error:
        found = schema_problems(document, schema(), error.errors())
        problems = [*document.problems, *found]
        raise InvalidScenarioError(document.path, problems, document.lines) from None


def schema_problems(
    document: YamlDocument, schema: dict[str, Any], errors: Iterable[Any]
) -> list[FileProblem]:
    """Translate pydantic's errors, omitting consequences of others.

    Args:
        document: the file.
        schema: JSON schema of the whole file, to know which keys a mapping may have.
        errors: the entries of ``ValidationError.errors()``.
    """
    errors, kinds = _of_kinds_given(document, errors)
    out = []
    meant: set[KeyPath] = set()  # missing keys probably meant by an unknown key
    for error in errors:
        if error["type"] == "extra_forbidden":
            *parent, name = error["loc"]
            valid = _free_keys(document, schema, tuple(parent))
            at = _mapping_at(document, tuple(parent))
            if key := closest_key(str(name), valid):
                meant.add((*at, key))
            text = unknown_key(str(name), valid)
            out.append(document.problem((*at, name, "[key]"), text))
    for error in errors:
        kind, loc = str(error["type"]), tuple(error["loc"])
        at = document.nearest(loc)
        if kind == "missing":
            if (*at, loc[-1]) not in meant:
                where = f" in {key_label(at).removesuffix(': ')}" if at else ""
                text = f"key {loc[-1]!r} is missing{where}"
                out.append(FileProblem(document.mark_of(at), text))
        elif kind == "too_short" and len(_value_at(document, at)) >= int(
            error["ctx"]["min_length"]
        ):
            continue  # entries that are wrong do not count for pydantic
        elif kind != "extra_forbidden":
            node = _node_at(schema, loc)
            place = (*at, "kind") if kind == "union_tag_invalid" else at
            mark = document.mark_of(place, key=loc[-1:] == ("[key]",))
            words = " or ".join(kinds.get(at, ())) if kind in _EXPECTED else ""
            text = _explain(kind, error, node)
            if words:
                text = f"{words} expected, not {_given(error)}"
            out.append(FileProblem(mark, key_label(at) + text))
    return out


def _of_kinds_given(
    document: YamlDocument, errors: Iterable[Any]
) -> tuple[list[Any], dict[KeyPath, list[str]]]:
    """Merge the errors of values of union types, such as a number or a list.

    Returns:
        The errors without those of kinds that the value is not, where it is of another one and
        wrong by that; and all kinds that a value may be, where it is of none.
    """
    placed = [(document.nearest(tuple(error["loc"])), error) for error in errors]
    kept: list[Any] = []
    kinds: dict[KeyPath, list[str]] = {}
    for at, error in placed:
        # What follows the place is the name of a kind.
        if error["type"] in _EXPECTED and len(error["loc"]) > len(at):
            if any(
                place[: len(at)] == at
                and (len(place) > len(at) or other["type"] not in _EXPECTED)
                for place, other in placed
            ):
                continue
            kinds.setdefault(at, []).append(_EXPECTED[error["type"]])
            if len(kinds[at]) > 1:
                continue
        kept.append(error)
    return kept, {at: words for at, words in kinds.items() if len(words) > 1}


def _explain(kind: str, error: Mapping[str, Any], node: Mapping[str, Any]) -> str:
    value, context = error.get("input"), error.get("ctx", {})
    given = _given(error)
    if kind in ("value_error", "assertion_error"):
        return str(error["msg"]).removeprefix("Value error, ")
    if kind == "union_tag_not_found":
        return f"key 'kind' is missing (valid: {', '.join(_tags(node))})"
    if kind == "union_tag_invalid":
        return unknown_name("kind", str(context["tag"]), _tags(node))
    if kind in ("literal_error", "enum"):
        expected = str(context.get("expected", "")).replace("'", "")
        valid = expected.replace(" or ", ", ").split(", ")
        if isinstance(value, str):
            return unknown_name("value", value, valid)
        return f"{expected} expected, not {given}"
    if kind in _EXPECTED:
        quoted = kind == "string_type" and isinstance(value, int | float)
        hint = f': write it in quotes, "{value}"' if quoted else ""
        return f"{_EXPECTED[kind]} expected, not {given}{hint}"
    if kind == "string_pattern_mismatch":
        return f"{given} is no name: letters, digits, '_', '-' and '.' only"
    if kind in _BOUNDS:
        name, words = _BOUNDS[kind]
        bound = context[name]
        limit = f"{bound:g}" if isinstance(bound, float) else str(bound)
        return f"{words} {limit}, not {given}"
    if kind in ("too_short", "too_long"):
        least = context.get("min_length", context.get("max_length"))
        few = "at least " if kind == "too_short" else "at most "
        if node.get("minItems", 0) == node.get("maxItems"):
            few = ""
        count = len(value) if isinstance(value, list) else context["actual_length"]
        noun = "entry" if least == 1 else "entries"
        return f"{few}{least} {noun} expected, not {count}"
    return str(error["msg"])


def _given(error: Mapping[str, Any]) -> str:
    value = error.get("input")
    if value is None:
        return "nothing"
    if isinstance(value, dict):
        return "a mapping"
    if isinstance(value, list | tuple):
        return "a list"
    if isinstance(value, bool):
        return "true" if value else "false"
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def key_label(path: KeyPath) -> str:
    """Return a path in a file as prefix of messages: ``cell.robots[0].name: ``."""
    text = "".join(f"[{p}]" if isinstance(p, int) else f".{p}" for p in path)
    return f"{text.lstrip('.')}: " if text else ""


def _value_at(document: YamlDocument, path: KeyPath) -> Any:
    value = document.data
    for entry in path:
        value = value[entry]
    return value


def _mapping_at(document: YamlDocument, path: KeyPath) -> KeyPath:
    """Return the path of the innermost mapping; a tag may also be a key, as ``retries`` is."""
    at = document.nearest(path)
    while not isinstance(_value_at(document, at), dict):
        at = at[:-1]
    return at


def _free_keys(
    document: YamlDocument, schema: dict[str, Any], path: KeyPath
) -> list[str]:
    """Return the unused valid keys of the mapping at ``path``."""
    valid = list(_node_at(schema, path).get("properties", {}))
    given = _value_at(document, _mapping_at(document, path))
    return [key for key in valid if key not in given] or valid


def _node_at(schema: dict[str, Any], path: KeyPath) -> dict[str, Any]:
    """Return the part of the schema for ``path``, which may contain tags of unions."""
    node = _follow(schema, schema)
    for entry in path:
        if str(entry).startswith(("function-wrap[", "function-after[")):
            continue  # pydantic's tag of a section where a number or a name is allowed, too
        if entry in node.get("properties", {}):
            node = _follow(schema, node["properties"][entry])
        elif entry in _tags(node):
            ref = node["discriminator"]["mapping"][entry]
            node = _follow(schema, {"$ref": ref})
        elif isinstance(entry, int) and "items" in node:
            node = _follow(schema, node["items"])
        elif named := node.get("patternProperties"):
            node = _follow(schema, next(iter(named.values())))
        elif isinstance(node.get("additionalProperties"), dict):
            node = _follow(schema, node["additionalProperties"])
        else:
            return {}
    return node


def _tags(node: Mapping[str, Any]) -> list[str]:
    return list(node.get("discriminator", {}).get("mapping", {}))


def _follow(schema: dict[str, Any], node: dict[str, Any]) -> dict[str, Any]:
    while True:
        if "$ref" in node:
            node = schema["$defs"][str(node["$ref"]).rsplit("/", 1)[-1]]
        elif "anyOf" in node:  # "X or nothing" of optional keys
            node = next(n for n in node["anyOf"] if n.get("type") != "null")
        else:
            return node

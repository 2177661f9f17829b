"""Problems of a scenario file, as a person wants to read them: place, reason, remedy."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from planning.errors import ScenarioError
from twin.scenario.document.yaml_text import KeyPath, Mark, YamlDocument

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


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong with a file.

    Attributes:
        mark: where.
        message: what, and what to do about it.
    """

    mark: Mark
    message: str


def mark_problems(
    document: YamlDocument, found: Iterable[tuple[KeyPath, str]]
) -> list[Problem]:
    """Return problems found at some keys, each with its place in the text."""
    return [
        Problem(document.mark_of(path, key=path[-1:] == ("name",)), message)
        for path, message in found
    ]


class InvalidScenarioError(ScenarioError):
    """A scenario file with everything that is wrong with it.

    Attributes:
        path: the file.
        problems: in the order of the file.
        lines: source lines, for the excerpt under each message.
    """

    def __init__(
        self, path: Path, problems: Iterable[Problem], lines: Sequence[str] = ()
    ) -> None:
        self.path = path
        self.lines = tuple(lines)
        self.problems = tuple(
            sorted(set(problems), key=lambda p: (p.mark.line, p.mark.column, p.message))
        )
        super().__init__("\n".join(self.headline(p) for p in self.problems))

    def headline(self, problem: Problem) -> str:
        """Return ``file:line:column: message``; without a place where there is no text."""
        if not self.lines:
            return f"{self.path}: {problem.message}"
        mark = problem.mark
        return f"{self.path}:{mark.line}:{mark.column}: {problem.message}"

    def excerpt(self, problem: Problem) -> str:
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


def meant_key(key: str, valid: Sequence[str]) -> str | None:
    """Return the valid key that was probably meant, None when none is near."""
    stem, unit = _split_unit(key)
    for name in valid:
        valid_stem, valid_unit = _split_unit(name)
        if stem == valid_stem and unit != valid_unit and valid_unit:
            return name
    return next(iter(difflib.get_close_matches(key, valid, n=1, cutoff=0.6)), None)


def unknown_key(key: str, valid: Sequence[str]) -> str:
    """Say that a key is unknown, which one was probably meant, and in which unit."""
    meant = meant_key(key, valid)
    if meant is not None:
        (stem, unit), (meant_stem, meant_unit) = _split_unit(key), _split_unit(meant)
        if stem == meant_stem and unit != meant_unit:
            word = _UNIT_WORDS.get(meant_unit, meant_unit)
            return f"unknown key {key!r}: this quantity is in {word}, as {meant!r}"
    hint = f"; did you mean {meant!r}?" if meant is not None else ""
    known = f" (valid: {', '.join(valid)})" if valid else ""
    return f"unknown key {key!r}{hint}{known}"


def unknown_name(what: str, name: str, valid: Sequence[str]) -> str:
    """Say that a name is unknown, and which one was probably meant."""
    close = difflib.get_close_matches(name, valid, n=1, cutoff=0.6)
    hint = f"; did you mean {close[0]!r}?" if close else ""
    return f"unknown {what} {name!r}{hint} (valid: {', '.join(valid)})"


def schema_problems(
    document: YamlDocument, schema: dict[str, Any], errors: Iterable[Any]
) -> list[Problem]:
    """Translate pydantic's errors, leaving out those that only follow from another one.

    Args:
        document: the file.
        schema: JSON schema of the whole file, to know which keys a mapping may have.
        errors: the entries of ``ValidationError.errors()``.
    """
    out = []
    meant: set[KeyPath] = set()  # missing keys that an unknown key stands for
    for error in errors:
        if error["type"] == "extra_forbidden":
            *parent, name = error["loc"]
            valid = _free_keys(document, schema, tuple(parent))
            at = document.nearest(tuple(parent))
            if key := meant_key(str(name), valid):
                meant.add((*at, key))
            mark = document.mark_of((*at, name), key=True)
            out.append(Problem(mark, unknown_key(str(name), valid)))
    for error in errors:
        kind, loc = str(error["type"]), tuple(error["loc"])
        at = document.nearest(loc)
        if kind == "missing":
            if (*at, loc[-1]) not in meant:
                where = f" in {_label(at).removesuffix(': ')}" if at else ""
                text = f"key {loc[-1]!r} is missing{where}"
                out.append(Problem(document.mark_of(at), text))
        elif kind == "too_short" and len(_value_at(document, at)) >= int(
            error["ctx"]["min_length"]
        ):
            continue  # entries that are wrong do not count for pydantic
        elif kind != "extra_forbidden":
            node = _node_at(schema, loc)
            place = (*at, "kind") if kind == "union_tag_invalid" else at
            mark = document.mark_of(place, key=loc[-1:] == ("[key]",))
            out.append(Problem(mark, _label(at) + _explain(kind, error, node)))
    return out


def _explain(kind: str, error: Mapping[str, Any], node: Mapping[str, Any]) -> str:
    value, context = error.get("input"), error.get("ctx", {})
    given = "nothing" if value is None else _describe(value)
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
    if kind == "string_type":
        hint = f': write it in quotes, "{value}"' if _is_scalar(value) else ""
        return f"text expected, not {given}{hint}"
    if kind in ("int_type", "int_from_float"):
        return f"a whole number expected, not {given}"
    if kind == "float_type":
        return f"a number expected, not {given}"
    if kind == "bool_type":
        return f"true or false expected, not {given}"
    if kind in ("tuple_type", "list_type"):
        return f"a list [..] expected, not {given}"
    if kind in ("model_type", "model_attributes_type", "dict_type"):
        return f"a mapping (key: value) expected, not {given}"
    if kind == "string_pattern_mismatch":
        return f"{given} is no name: letters, digits, '_', '-' and '.' only"
    if kind == "finite_number":
        return f"a finite number expected, not {given}"
    bounds = {
        "greater_than": ("gt", "must be greater than"),
        "greater_than_equal": ("ge", "must be at least"),
        "less_than": ("lt", "must be less than"),
        "less_than_equal": ("le", "must be at most"),
    }
    if kind in bounds:
        name, words = bounds[kind]
        return f"{words} {_number(context[name])}, not {given}"
    if kind in ("too_short", "too_long"):
        least = context.get("min_length", context.get("max_length"))
        few = "at least " if kind == "too_short" else "at most "
        if node.get("minItems") == node.get("maxItems"):
            few = ""
        count = len(value) if isinstance(value, list) else context["actual_length"]
        noun = "entry" if least == 1 else "entries"
        return f"{few}{least} {noun} expected, not {count}"
    return str(error["msg"])


def _number(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _is_scalar(value: Any) -> bool:
    return isinstance(value, int | float)


def _describe(value: Any) -> str:
    if isinstance(value, dict):
        return "a mapping"
    if isinstance(value, list):
        return "a list"
    if isinstance(value, bool):
        return "true" if value else "false"
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _label(path: KeyPath) -> str:
    text = "".join(f"[{p}]" if isinstance(p, int) else f".{p}" for p in path)
    return f"{text.lstrip('.')}: " if text else ""


def _value_at(document: YamlDocument, path: KeyPath) -> Any:
    value = document.data
    for entry in path:
        value = value[entry]
    return value


def _free_keys(
    document: YamlDocument, schema: dict[str, Any], path: KeyPath
) -> list[str]:
    """Return the keys that the mapping at ``path`` may have and does not have yet."""
    valid = list(_node_at(schema, path).get("properties", {}))
    given = _value_at(document, document.nearest(path))
    return [key for key in valid if key not in given] or valid


def _split_unit(key: str) -> tuple[str, str]:
    for unit in _UNITS:
        if key.endswith("_" + unit):
            return key[: -len(unit) - 1], unit
    return key, ""


def _node_at(schema: dict[str, Any], path: KeyPath) -> dict[str, Any]:
    """Return the part of the schema for ``path``, in which tags of unions may stand."""
    node = _follow(schema, schema)
    for entry in path:
        if entry in node.get("properties", {}):
            node = _follow(schema, node["properties"][entry])
        elif entry in _tags(node):
            ref = node["discriminator"]["mapping"][entry]
            node = _follow(schema, {"$ref": ref})
        elif isinstance(entry, int) and "items" in node:
            node = _follow(schema, node["items"])
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

"""Problems of a scenario file: place, reason and remedy."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from pathlib import Path

from planning.errors import ScenarioError
from twin.scenario.document.yaml_text import KeyPath, YamlDocument
from twin.scenario.document.yaml_text import Problem as Problem

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


def _split_unit(key: str) -> tuple[str, str]:
    for unit in _UNITS:
        if key.endswith("_" + unit):
            return key[: -len(unit) - 1], unit
    return key, ""

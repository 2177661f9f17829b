"""The page of the two papers: a row for all that is numbered in them, and what rows name is there."""

import re
from pathlib import Path

import pytest
import typer

from twin.cli import app
from twin.scenario.schema import scenario_schema

ROOT = Path(__file__).parents[2]

NUMBERED = {
    "APEX-MR": {"Fig": 12, "Table": 2, "eq": 8, "Algorithm": 1, "App": 6},
    "Hartmann et al.": {"Fig": 13, "Table": 2, "eq": 8},
}
"""How many of each there are, by the heading of the table that has their rows."""

_LETTERS = {"I": 1, "II": 2, **{letter: k for k, letter in enumerate("ABCDEF", 1)}}
_NUMBER = r"(?:\d+|I+\b|[A-F]\b)"
_NUMBERS = rf"{_NUMBER}[a-c]?(?:(?:, | to | and ){_NUMBER})*"


def rows(paper: str) -> list[list[str]]:
    """Return the rows of a paper: what is in it, where it is here, what differs, what shows it."""
    page = (ROOT / "docs/reference/papers.md").read_text(encoding="utf-8")
    _, _, text = page.partition(f"\n## {paper}\n")
    lines = [line for line in text.partition("\n## ")[0].splitlines() if "|" in line]
    found = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines]
    return found[2:]


ROWS = [row for paper in NUMBERED for row in rows(paper)]


def numbers(text: str) -> set[int]:
    """Return what a list such as ``11 to 13`` or ``6, 13`` names."""
    found: set[int] = set()
    for part in re.split(", | and ", text):
        ends = [
            _LETTERS[end] if end in _LETTERS else int(end.rstrip("abc"))
            for end in part.split(" to ")
        ]
        found.update(range(ends[0], ends[-1] + 1))
    return found


@pytest.mark.parametrize("paper", NUMBERED)
def test_all_that_is_numbered_in_a_paper_has_a_row(paper: str) -> None:
    first = " ".join(row[0] for row in rows(paper))
    for kind, count in NUMBERED[paper].items():
        named = re.findall(rf"\b{kind}s?\.? ({_NUMBERS})", first)
        assert set().union(*map(numbers, named)) == set(range(1, count + 1)), kind


@pytest.mark.parametrize("row", ROWS, ids=[row[0][:40] for row in ROWS])
def test_a_row_names_what_is_there(row: list[str]) -> None:
    """It says where something is, and what shows it, but for hardware and learning."""
    what, where, differs, shown = row
    absent = re.search(r"(hardware|learning): no", differs)
    assert (where and shown) or absent, what
    commands = typer.main.get_command(app)
    keys = {
        key
        for part in scenario_schema()["$defs"].values()
        for key in part.get("properties", {})
    }
    for name in re.findall(r"`([^`]+)`", " ".join(row)):
        for path in re.findall(r"(?<![\w.])[a-z_]+/[\w./-]*", name):
            assert (ROOT / path).exists(), path
        if name.startswith("python -m "):
            module = ROOT / name.split()[2].replace(".", "/")
            assert module.is_dir() or module.with_suffix(".py").exists(), name
        elif name.startswith("twin "):
            command = commands.commands[name.split()[1]]  # type: ignore[attr-defined]
            options = {option for param in command.params for option in param.opts}
            assert set(re.findall(r"--[a-z-]+", name)) <= options, name
        elif re.fullmatch(r"[a-z_]+(\.[a-z_]+)+(: \w+)?", name) and "yaml" not in name:
            key = name.partition(":")[0]
            assert set(key.split(".")[1:]) <= keys, name

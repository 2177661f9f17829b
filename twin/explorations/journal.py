"""Log file ``journal.jsonl`` of a design exploration, with one evaluated design per line.

Each line is written before the sampler receives the result.
"""

from __future__ import annotations

import json
import logging
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from planning.errors import OutputError
from planning.files import read_file
from planning.json_files import parse_json
from twin.explorations.dimensions import Values
from twin.explorations.rungs import Evaluation, Outcome

JOURNAL = "journal.jsonl"

SEARCH, UNDONE, SINGLE = "search", "undone", "single"
"""Purposes of evaluations: search, gain of one change of the best design, single changes of the scenario."""

REPLANNED = "replanned"
"""Why a design is planned once more: with the seed of the planner that its row is about."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class TriedDesign:
    """A design that was tried.

    Attributes:
        design: its number; 0 is the scenario as it is.
        purpose: purpose of the evaluation.
        values: value of each varied key.
        asked_after: number of evaluations known to the sampler when this one was chosen.
        evaluation: its evaluation; workloads are not in the journal.
        same_as: the design that has the same values and was evaluated, None where this one was.
        about: its subject, for designs outside the search.
    """

    design: int
    purpose: str
    values: Values
    asked_after: int
    evaluation: Evaluation
    same_as: int | None = None
    about: str = ""

    @property
    def done(self) -> bool:
        """True if it is feasible and fully evaluated."""
        return self.evaluation.outcome == "done"

    def content(self) -> dict[str, Any]:
        """Return it for JSON; unknown values are None."""
        found = self.evaluation
        return {
            "design": self.design,
            "purpose": self.purpose,
            "about": self.about,
            "values": dict(self.values),
            "asked_after": self.asked_after,
            "same_as": self.same_as,
            "outcome": found.outcome,
            "rung": found.rung,
            "reason": found.reason,
            "violation": found.violation,
            "results": dict(found.results),
            "goals": list(found.goals),
            "turns_s": None if math.isnan(found.turns_s) else found.turns_s,
            "makespans_s": [None if math.isnan(v) else v for v in found.makespans_s],
            "cpu_s": {k: round(v, 4) for k, v in found.cpu_s.items()},
        }


def _number(value: Any) -> float:
    """Return a finite number; ValueError for anything else, such as a text of one."""
    if type(value) not in (int, float) or not math.isfinite(value):
        raise ValueError(f"{str(value)[:40]!r} is no number")
    return float(value)


def _count(value: Any) -> int:
    """Return a whole number of at least 0; ValueError for anything else."""
    if type(value) is not int or value < 0:
        raise ValueError(f"{str(value)[:40]!r} is no whole number of at least 0")
    return value


def _one_of(value: Any, choices: Sequence[str]) -> Any:
    """Return one of some words; ValueError for anything else."""
    if value not in choices:
        raise ValueError(f"{str(value)[:40]!r} is none of {', '.join(choices)}")
    return value


def parse_tried_design(row: Mapping[str, Any]) -> TriedDesign:
    """Parse a line; KeyError, TypeError or ValueError if it is invalid."""
    turns_s, same_as = row["turns_s"], row["same_as"]
    # A file of samples is named after the purpose, and a seed is what REPLANNED is about.
    purpose = _one_of(row["purpose"], (SEARCH, UNDONE, SINGLE, REPLANNED))
    if purpose == REPLANNED:
        int(row["about"])
    return TriedDesign(
        _count(row["design"]),
        purpose,
        dict(row["values"]),
        _count(row["asked_after"]),
        Evaluation(
            _one_of(row["outcome"], get_args(Outcome)),
            str(row["rung"]),
            str(row["reason"]),
            _number(row["violation"]),
            {str(k): _number(v) for k, v in row["results"].items()},
            tuple(map(_number, row["goals"])),
            math.nan if turns_s is None else _number(turns_s),
            tuple(math.nan if v is None else _number(v) for v in row["makespans_s"]),
            {str(k): _number(v) for k, v in row["cpu_s"].items()},
        ),
        None if same_as is None else _count(same_as),
        str(row["about"]),
    )


class Journal:
    """The journal of an exploration, read and appended to.

    Args:
        folder: of the exploration.

    Raises:
        OutputError: it cannot be read, or a line that is not the last is damaged.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / JOURNAL
        self.rows: list[TriedDesign] = []
        self._read()

    @property
    def searched(self) -> Sequence[TriedDesign]:
        """The designs of the search, in the order of the sampler's updates."""
        return [row for row in self.rows if row.purpose == SEARCH]

    def append(self, row: TriedDesign) -> None:
        """Append a design and flush it to the disk.

        Raises:
            OutputError: the file system refuses.
        """
        line = json.dumps(row.content(), allow_nan=False, ensure_ascii=False) + "\n"
        try:
            handle = os.open(self._path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
            try:
                data = line.encode()
                while data:
                    data = data[os.write(handle, data) :]
                os.fsync(handle)
            finally:
                os.close(handle)
        except OSError as error:
            raise OutputError(f"{self._path}: cannot be written: {error}") from error
        self.rows.append(row)

    def _read(self) -> None:
        try:
            data = read_file(self._path)
        except FileNotFoundError:
            return
        except OSError as error:
            raise OutputError(f"{self._path}: cannot be read: {error}") from error
        whole = data.rfind(b"\n") + 1
        if whole < len(data):
            _log.warning(
                "%s: the last line was not finished and is dropped", self._path
            )
            try:
                os.truncate(self._path, whole)
            except OSError as error:
                raise OutputError(f"{self._path}: cannot be mended: {error}") from error
        for number, line in enumerate(data[:whole].splitlines(), start=1):
            try:
                self.rows.append(parse_tried_design(parse_json(line)))
            except (
                *(ValueError, KeyError, TypeError, AttributeError, OverflowError),
            ) as error:
                raise OutputError(
                    f"{self._path}, line {number}: damaged: {error!r}"
                ) from None

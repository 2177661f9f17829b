"""Empirical distributions of measured durations.

CSV files of measured durations: in the unit of their column, or between two time stamps.
"""

from __future__ import annotations

import csv
import io
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from datetime import datetime
from decimal import Decimal, InvalidOperation
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Annotated, Literal, get_args

import numpy as np
from pydantic import Field

from planning.errors import ScenarioError
from planning.files import is_file, read_file
from planning.transforms import Array, readonly
from twin.durations.model import DurationModel, PackagedSkill

Columns = str | tuple[str, str]
"""Column of durations, or columns of the time stamps at which they start and end."""

Unit = Literal["s", "ms", "min", "h", "us", "ns"]
"""Unit of time of a column."""

_SECONDS = dict(
    zip(
        get_args(Unit),
        map(Decimal, ["1", "1e-3", "60", "3600", "1e-6", "1e-9"]),
        strict=True,
    )
)
UNITS = tuple(_SECONDS)

_SPELLED = {
    "s": "s sec secs second seconds",
    "ms": "ms msec msecs millis milliseconds",
    "min": "min mins minute minutes",
    "h": "h hr hrs hour hours",
    "us": "us usec microseconds \u00b5s \u03bcs",
    "ns": "ns nsec nanos nanoseconds",
}
_UNIT_OF = {word: unit for unit, words in _SPELLED.items() for word in words.split()}
_CAMEL = re.compile(r"(?<=[a-z])(?=[A-Z])")
_NAMED_UNIT = re.compile(r"(?:^|[\W_])([^\W\d_]+)[\])]?\s*$")

_Reader = Callable[[str], Decimal | None]


def named_unit(column: str) -> tuple[str, str | None]:
    """Return a column's name without its unit, in small letters, and the unit.

    ``cycle_time_ms``, ``cycle time [ms]`` and ``cycleTimeMs`` are in milliseconds; the unit is
    None where the name ends with none.
    """
    name = _CAMEL.sub("_", column).lower()
    found = _NAMED_UNIT.search(name)
    if found is None or found[1] not in _UNIT_OF:
        return name.strip(), None
    return name[: found.start()].rstrip(" _-.([/"), _UNIT_OF[found[1]]


def column_unit(
    path: Path, columns: Columns, names: Sequence[str], unit: str | None
) -> str | None:
    """Return the unit that the names of columns or ``unit`` say; None where neither does.

    Args:
        path: of the file, for messages.
        columns: of durations or of stamps.
        names: of all columns; ``_min`` beside ``_max`` is a minimum and no unit.
        unit: given apart from the names.

    Raises:
        ScenarioError: the unit is unknown, or names and ``unit`` contradict each other.
    """
    folded = {name.lower() for name in names}
    found = {} if unit is None else {unit: "the given unit"}
    for name in (columns,) if isinstance(columns, str) else columns:
        own = named_unit(name)[1]
        minimum = own == "min" and name.lower().replace("min", "max") in folded
        if own is not None and not minimum:
            found.setdefault(own, f"the name of column {name[:_LONGEST]!r}")
    if len(found) > 1 or not found.keys() <= _SECONDS.keys():
        told = " and ".join(f"{where} says {u!r}" for u, where in found.items())
        raise ScenarioError(f"{path}: {told}: which unit is it?", choices=UNITS)
    return next(iter(found), None)


_DELIMITERS = ",;\t"
# A file that is no table at all is not quoted.
_COLUMN = re.compile(r"[\w .-]{1,60}")
_SHOWN = 20  # names of columns in a message
_LONGEST = 40  # characters of such a name, and of a cell


def read_durations(
    path: Path,
    columns: Columns,
    labels: Sequence[str] = (),
    unit: str | None = None,
) -> list[tuple[tuple[str, ...], float]]:
    """Read durations [s] and what labels them from a CSV file with a header line.

    Cells are separated by commas, semicolons or tabs, as the header is. Where they are not
    separated by commas, numbers may have decimal commas. Time stamps are numbers or of ISO 8601.
    Numbers are in the unit of the column's name, else in ``unit``, else in seconds.

    Args:
        path: the file.
        columns: of the durations.
        labels: columns of labels.
        unit: of numbers, where the column's name has none; it may say the same.

    Returns:
        For each row its labels and its duration.

    Raises:
        ScenarioError: the file cannot be read, lacks a column or has no rows, a value is
            not a finite number of at least 0, or units contradict each other; the message names
            file and line.
    """
    wanted = (columns,) if isinstance(columns, str) else columns
    rows = []
    try:
        reader = csv_rows(path)
        names = tuple(reader.fieldnames or ())
        for name in (*wanted, *labels):
            if name not in names:
                raise ScenarioError(
                    f"{path}: no column {name[:_LONGEST]!r}",
                    choices=tuple(n for n in names[:_SHOWN] if _COLUMN.fullmatch(n)),
                )
        factor = _SECONDS[column_unit(path, columns, names, unit) or "s"]
        comma = reader.reader.dialect.delimiter != ","
        number = partial(_number, comma=comma, factor=factor)
        for row in reader:
            place = f"{path}:{reader.line_num}"
            # DictReader keeps what goes beyond the header under the key None.
            if any((cell or "").strip() for cell in row.pop(None, ())):
                raise ScenarioError(
                    f"{place}: more cells than columns; where commas are decimal, separate"
                    " cells by semicolons"
                )
            cells = [(row[name] or "").strip() for name in wanted]
            value = (
                _duration(place, wanted[0], cells[0], number)
                if isinstance(columns, str)
                else _span(place, columns, cells, number)
            )
            rows.append((tuple((row[name] or "").strip() for name in labels), value))
    except csv.Error as error:
        raise ScenarioError(f"{path}: is no CSV file: {error}") from error
    if not rows:
        raise ScenarioError(f"{path}: column {wanted[0]!r} has no rows")
    return rows


def csv_rows(path: Path) -> csv.DictReader[str]:
    """Return a reader of a CSV file with a header line, whose cells are separated as in there.

    Raises:
        ScenarioError: it cannot be read.
    """
    try:
        text = read_file(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ScenarioError(f"{path}: not UTF-8 (byte {error.start})") from None
    except OSError as error:
        raise ScenarioError(
            f"{path}: cannot read durations: {error.strerror}"
        ) from None
    header = text.partition("\n")[0]
    delimiter = max(_DELIMITERS, key=header.count)
    return csv.DictReader(io.StringIO(text, newline=""), delimiter=delimiter)


def _duration(place: str, column: str, text: str, number: _Reader) -> float:
    value = number(text)
    if value is None or value < 0:
        raise ScenarioError(
            f"{place}: {column} is {text[:_LONGEST]!r}, not a duration of at least 0"
        )
    return float(value)


def _span(
    place: str, columns: tuple[str, str], cells: Sequence[str], number: _Reader
) -> float:
    """Return the time between two stamps [s]."""
    stamps = []
    for column, text in zip(columns, cells, strict=True):
        value = number(text)
        stamp = _iso(text) if value is None else value
        if stamp is None:
            raise ScenarioError(
                f"{place}: {column} is {text[:_LONGEST]!r}, neither a number nor a time such"
                " as 2026-03-31T09:30:00.5"
            )
        stamps.append(stamp)
    first, last = stamps
    seconds: float
    if isinstance(first, Decimal) and isinstance(last, Decimal):
        seconds = float(last - first)
    elif (
        isinstance(first, datetime)
        and isinstance(last, datetime)
        and (first.tzinfo is None) == (last.tzinfo is None)
    ):
        seconds = (last - first).total_seconds()
    else:
        raise ScenarioError(
            f"{place}: {columns[0]} and {columns[1]} are not of one clock: both numbers,"
            " both times without an offset, or both with one"
        )
    if seconds < 0:
        raise ScenarioError(f"{place}: {columns[1]} is before {columns[0]}")
    return seconds


def _number(text: str, *, comma: bool, factor: Decimal) -> Decimal | None:
    """Return a finite number times a factor, None where the text is none."""
    if comma and text.count(",") == 1 and "." not in text:
        text = text.replace(",", ".")
    try:
        value = Decimal(text)
    except InvalidOperation:
        return None
    bounded = value.is_finite() and abs(value) < Decimal("1e300")
    return value * factor if bounded else None


def _iso(text: str) -> datetime | None:
    """Return a time of day on a date, None where the text is none."""
    try:
        return datetime.fromisoformat(text) if ":" in text else None
    except ValueError:
        return None


class _Sample(DurationModel, ABC):
    """Some durations, each as likely as any other."""

    @property
    @abstractmethod
    def values_s(self) -> Array:
        """The durations in rising order, shape (n,), read-only [s]."""

    def _ppf(self, u: Array) -> Array:
        """Return the inverse of the empirical distribution function."""
        n = len(self.values_s)
        index = np.floor(np.asarray(u) * n).astype(np.int64)
        return self.values_s[np.minimum(index, n - 1)]

    def _mean(self) -> float:
        return float(np.mean(self.values_s))

    def _minimum(self) -> float:
        return float(self.values_s[0])


class MeasuredTimes(_Sample):
    """Empirical distribution of given durations.

    Attributes:
        values: the durations [s].
    """

    values: Annotated[
        tuple[Annotated[float, Field(ge=0)], ...], Field(min_length=1, repr=False)
    ]

    @cached_property
    def values_s(self) -> Array:
        """The durations in rising order, shape (n,), read-only [s]."""
        return readonly(np.sort(self.values))

    # The sorted array is no part of what is compared: arrays have no one truth value.
    def __eq__(self, other: object) -> bool:
        if not isinstance(other, MeasuredTimes):
            return NotImplemented
        return (self.values, self.scale) == (other.values, other.scale)

    def __hash__(self) -> int:
        return hash((self.values, self.scale))


class Empirical(_Sample):
    """Drawn from measured times: a column of a CSV file, relative to the scenario file.

    Attributes:
        csv: path of the file, relative to that of the scenario.
        column: its column with the durations, whose name may end with their unit.
        unit: of the durations where the column's name has none; seconds by default.
    """

    kind: Literal["empirical"] = "empirical"
    csv: str
    column: str = "duration_s"
    unit: Unit | None = None

    def located(self, folder: Path) -> MeasuredTimes:
        """Return the durations of the file; ScenarioError names file and line."""
        path = folder / self.csv
        if not is_file(path):
            raise ScenarioError(f"no such file: {path}")
        rows = read_durations(path, self.column, unit=self.unit)
        return MeasuredTimes(values=tuple(value for _, value in rows), scale=self.scale)

    @property
    def values_s(self) -> Array:
        """The durations of the file, where its path is relative to the current folder [s]."""
        return self.located(Path()).values_s


class Packaged(_Sample):
    """Drawn from the synthetic timings that ship with the package, those of a skill.

    Attributes:
        skill: whose timings.
    """

    kind: Literal["packaged"] = "packaged"
    skill: PackagedSkill

    @property
    def values_s(self) -> Array:
        """The durations in rising order, shape (n,), read-only [s]."""
        return _packaged_values(self.skill)


def packaged_timings() -> dict[str, DurationModel]:
    """Return the synthetic LEGO timings that ship with the package, one model a skill."""
    return {skill: Packaged(skill=skill) for skill in get_args(PackagedSkill)}


@cache
def _packaged_values(skill: str) -> Array:
    path = Path(__file__).parent / "packaged" / f"{skill}.csv"
    return readonly(np.sort([value for _, value in read_durations(path, "duration_s")]))

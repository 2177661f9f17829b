"""Reader of CSV files with measured durations, given as one column of durations or two columns of time stamps."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Sequence
from datetime import datetime
from decimal import Decimal, InvalidOperation
from functools import partial
from pathlib import Path
from typing import Literal, get_args

from planning.errors import ScenarioError
from planning.files import read_file

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
_DELIMITERS = ",;\t"
# A file that is no table at all is not quoted.
_COLUMN = re.compile(r"[\w .-]{1,60}")
_SHOWN = 20  # names of columns in a message
_LONGEST = 40  # characters of such a name, and of a cell


def split_unit(column: str) -> tuple[str, str | None]:
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
    """Return the unit given by column names or ``unit``; None without one.

    Args:
        path: of the file, for messages.
        columns: of durations or of stamps.
        names: of all columns; ``_min`` together with ``_max`` is a minimum and no unit.
        unit: given apart from the names.

    Raises:
        ScenarioError: the unit is unknown, or names and ``unit`` contradict each other.
    """
    folded = {name.lower() for name in names}
    found = {} if unit is None else {unit: "the given unit"}
    for name in (columns,) if isinstance(columns, str) else columns:
        own = split_unit(name)[1]
        minimum = own == "min" and name.lower().replace("min", "max") in folded
        if own is not None and not minimum:
            found.setdefault(own, f"the name of column {name[:_LONGEST]!r}")
    if len(found) > 1 or not found.keys() <= _SECONDS.keys():
        told = " and ".join(f"{where} says {u!r}" for u, where in found.items())
        raise ScenarioError(f"{path}: {told}: which unit is it?", choices=UNITS)
    return next(iter(found), None)


def read_durations(
    path: Path,
    columns: Columns,
    labels: Sequence[str] = (),
    unit: str | None = None,
) -> list[tuple[tuple[str, ...], float]]:
    """Read durations [s] and their labels from a CSV file with a header line.

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
            # DictReader keeps cells beyond the header under the key None.
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
    """Return a reader of a CSV file with a header line, with its delimiter detected.

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
        stamp = _parse_time_of_day(text) if value is None else value
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
    """Return a finite number times a factor, None if the text is not one."""
    if comma and text.count(",") == 1 and "." not in text:
        text = text.replace(",", ".")
    try:
        value = Decimal(text)
    except InvalidOperation:
        return None
    bounded = value.is_finite() and abs(value) < Decimal("1e300")
    return value * factor if bounded else None


def _parse_time_of_day(text: str) -> datetime | None:
    """Return a time of day on a date, None if the text is not one."""
    try:
        return datetime.fromisoformat(text) if ":" in text else None
    except ValueError:
        return None

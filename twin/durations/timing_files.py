"""CSV files of measured durations: in seconds, or between two time stamps."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from datetime import datetime
from decimal import Decimal, InvalidOperation
from pathlib import Path

from planning.errors import ScenarioError
from planning.files import read_file

Columns = str | tuple[str, str]
"""Column of durations [s], or columns of the time stamps at which they start and end."""

_DELIMITERS = ",;\t"
# A file that is no table at all is not quoted.
_COLUMN = re.compile(r"[\w .-]{1,60}")
_SHOWN = 20  # names of columns in a message
_LONGEST = 40  # characters of such a name, and of a cell


def read_durations(
    path: Path, columns: Columns, labels: Sequence[str] = ()
) -> list[tuple[tuple[str, ...], float]]:
    """Read durations [s] and what labels them from a CSV file with a header line.

    Cells are separated by commas, semicolons or tabs, as the header is. Where they are not
    separated by commas, numbers may have decimal commas. Time stamps are seconds or of ISO 8601.

    Args:
        path: the file.
        columns: of the durations.
        labels: columns of labels.

    Returns:
        For each row its labels and its duration.

    Raises:
        ScenarioError: the file cannot be read, lacks a column or has no rows, or a value is
            not a finite number of at least 0; the message names file and line.
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
        comma = reader.reader.dialect.delimiter != ","
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
                _duration(place, wanted[0], cells[0], comma=comma)
                if isinstance(columns, str)
                else _span(place, columns, cells, comma=comma)
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


def _duration(place: str, column: str, text: str, *, comma: bool) -> float:
    value = _number(text, comma=comma)
    if value is None or value < 0:
        raise ScenarioError(
            f"{place}: {column} is {text[:_LONGEST]!r}, not a duration of at least 0 s"
        )
    return float(value)


def _span(
    place: str, columns: tuple[str, str], cells: Sequence[str], *, comma: bool
) -> float:
    """Return the time between two stamps [s]."""
    stamps = []
    for column, text in zip(columns, cells, strict=True):
        number = _number(text, comma=comma)
        stamp = _iso(text) if number is None else number
        if stamp is None:
            raise ScenarioError(
                f"{place}: {column} is {text[:_LONGEST]!r}, neither seconds nor a time such"
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
            f"{place}: {columns[0]} and {columns[1]} are not of one clock: both in seconds,"
            " both times without an offset, or both with one"
        )
    if seconds < 0:
        raise ScenarioError(f"{place}: {columns[1]} is before {columns[0]}")
    return seconds


def _number(text: str, *, comma: bool) -> Decimal | None:
    """Return a finite number, None where the text is none."""
    if comma and text.count(",") == 1 and "." not in text:
        text = text.replace(",", ".")
    try:
        value = Decimal(text)
    except InvalidOperation:
        return None
    return value if value.is_finite() and abs(value) < Decimal("1e300") else None


def _iso(text: str) -> datetime | None:
    """Return a time of day on a date, None where the text is none."""
    try:
        return datetime.fromisoformat(text) if ":" in text else None
    except ValueError:
        return None

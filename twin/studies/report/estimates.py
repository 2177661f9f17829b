"""Formatting of estimates and their confidence intervals as text and HTML."""

from __future__ import annotations

from twin.studies.replications.statistics import Interval
from twin.studies.report.markup import escape_text


def format_estimate(found: Interval | None, *, percent: bool = False) -> str:
    """Return an estimate as HTML, with its confidence interval below in small type."""
    if found is None:
        return "-"
    factor, unit = (100.0, " %") if percent else (1.0, "")
    value = f"<span>{_digits(factor * found.estimate)}{unit}</span>"
    bounds = escape_text(found.bounds(_digits, factor))
    return f'{value}<br><span class="interval">{bounds}</span>' if bounds else value


def _digits(value: float) -> str:
    """Return a number with its significant digits."""
    digits = 1 if abs(value) >= 9.995 else 2
    return f"{value:.{digits}f}".replace("-0.00", "0.00")


def format_in_line(found: Interval, form: str, factor: float = 1.0) -> str:
    """Return an estimate with its interval in one line."""
    words = form.format(factor * found.estimate)
    bounds = found.bounds(factor=factor)
    return f"{words} ({bounds})" if bounds else words

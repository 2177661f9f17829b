"""The last resort: an error that nobody foresaw becomes one line, and a report file."""

from __future__ import annotations

import platform
import sys
import tempfile
import traceback
from datetime import UTC, datetime
from pathlib import Path

from twin.host.versions import versions


def write_error_report(error: BaseException) -> Path | None:
    """Write what a maintainer needs to know about an error; None where nothing can be written.

    The file goes to the system's folder for temporary files and names the command, versions
    and the traceback.
    """
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S%fZ")
    path = Path(tempfile.gettempdir()) / f"assembly-twin-error-{stamp}.txt"
    lines = [
        f"command: {' '.join(sys.argv)}",
        f"system: {platform.platform()}",
        *(f"{name}: {version}" for name, version in versions().items()),
        "",
        "".join(traceback.format_exception(error)),
    ]
    try:
        path.write_text("\n".join(lines), encoding="utf-8", errors="replace")
    except OSError:
        return None
    return path


def unforeseen(error: BaseException) -> str:
    """Return what is told of an error that nobody foresaw, with the path of its report."""
    what = f"{type(error).__name__}: {error}".rstrip(": ").splitlines()[0][:200]
    path = write_error_report(error)
    where = f"the report is in {path}" if path else "no report could be written"
    return f"this should not happen, please tell us: {what} ({where})"

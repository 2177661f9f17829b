"""Error handling of commands: exit codes, and error messages without tracebacks."""

from __future__ import annotations

import errno
import functools
import json
import platform
import sys
import tempfile
import traceback
from collections.abc import Callable
from datetime import UTC, datetime
from enum import IntEnum
from pathlib import Path
from typing import Any, ParamSpec

import typer

from planning.errors import (
    ConstructionError,
    InfeasibleStepError,
    OutputError,
    RequestError,
    RobotModelError,
    ScenarioError,
    TwinError,
    escape_control_characters,
)
from twin.host.versions import versions

_INPUTS = (
    ConstructionError,
    ScenarioError,
    RobotModelError,
    OutputError,
    InfeasibleStepError,
    RequestError,
)

_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
"""System error numbers of a full disk."""

P = ParamSpec("P")


class ExitCode(IntEnum):
    """Exit codes of commands."""

    COMPLETED = 0
    """Done and whole."""

    FAILED = 1
    """The work failed, or violates a guarantee."""

    BAD_INPUT = 2
    """The input is at fault."""

    UNFORESEEN = 70
    """An error of the program."""

    INTERRUPTED = 130
    """Interrupted by the user."""


def guarded(command: Callable[P, int | None]) -> Callable[P, None]:
    """Wrap a command so that every error ends in a message and an exit code.

    Errors in the user's input, such as ScenarioError, InfeasibleStepError and ConstructionError
    (the assembly cannot be built) end with 2, any other TwinError and a full disk with 1, an interrupt
    with 130. Other exceptions are errors of the program: one line, a report file, and 70. A
    command may return its own code.
    """

    @functools.wraps(command)
    def run(*args: P.args, **kwargs: P.kwargs) -> None:
        try:
            code = command(*args, **kwargs)
        except KeyboardInterrupt:
            print_error("interrupted")
            code = ExitCode.INTERRUPTED
        except TwinError as error:
            print_error(error_message(error))
            at_fault = isinstance(error, _INPUTS) and not _is_out_of_space(error)
            code = ExitCode.BAD_INPUT if at_fault else ExitCode.FAILED
        except ModuleNotFoundError as error:
            missing = error.name or ""
            ours = missing.startswith(("twin.", "scheduling.", "planning."))
            text = f"this needs {missing}, which is not installed"
            print_error(text if ours else report_unforeseen_error(error))
            code = ExitCode.FAILED if ours else ExitCode.UNFORESEEN
        except BrokenPipeError:  # whoever read the output went away: main knows
            raise
        except Exception as error:
            full = _is_out_of_space(error)
            print_error(
                f"no more room: {error}" if full else report_unforeseen_error(error)
            )
            code = ExitCode.FAILED if full else ExitCode.UNFORESEEN
        raise typer.Exit(code or ExitCode.COMPLETED)

    return run


def _is_out_of_space(error: BaseException) -> bool:
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, OSError) and cause.errno in _FULL:
            return True
        cause = cause.__cause__
    return False


def error_message(error: TwinError) -> str:
    """Return the message of an error, with excerpts where it has any."""
    report = getattr(error, "report", None)
    return str(report()) if callable(report) else str(error)


def print_json(value: Any) -> None:
    """Print a value as indented JSON to standard output."""
    typer.echo(json.dumps(value, indent=2))


def print_error(message: str) -> None:
    """Print a message to standard error, in red on a terminal."""
    from rich.console import Console
    from rich.text import Text

    console = Console(stderr=True, soft_wrap=True, highlight=False)
    first, _, rest = escape_control_characters(message).partition("\n")
    label = Text("error: ", style="bold red") if not _has_place(first) else Text("")
    console.print(label + Text(first))
    if rest:
        console.print(Text(rest))
    sys.stderr.flush()


def _has_place(line: str) -> bool:
    """Return whether a line starts with file:line:column, which editors jump to."""
    parts = line.split(":")
    return len(parts) > 3 and parts[1].isdigit() and parts[2].isdigit()


def write_error_report(error: BaseException) -> Path | None:
    """Write an error report for maintainers; None if it cannot be written.

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


def report_unforeseen_error(error: BaseException) -> str:
    """Write a report of an unforeseen error; return the message with its path."""
    what = f"{type(error).__name__}: {error}".rstrip(": ").splitlines()[0][:200]
    path = write_error_report(error)
    where = f"the report is in {path}" if path else "no report could be written"
    return f"this should not happen, please tell us: {what} ({where})"

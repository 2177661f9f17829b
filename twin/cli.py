"""The ``twin`` command-line program.

Basic commands such as ``twin run`` are in twin/commands/; twin/registry.py lists all commands.
"""

from __future__ import annotations

import gc
import os
import sys
from typing import Annotated

import typer

from twin.host.guard import ExitCode, print_error
from twin.registry import COMMANDS

_COLLECT_AFTER = 100_000
"""New objects before garbage is collected: imports and plans make many that stay."""

app = typer.Typer(
    name="twin",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


def _print_version(wanted: bool) -> None:
    """Print the version and end, if that is wanted."""
    if wanted:
        from twin.host.versions import versions

        typer.echo(f"assembly-twin {versions()['assembly-twin']}")
        raise typer.Exit


@app.callback()
def _program(
    version: Annotated[
        bool,
        typer.Option(
            "--version",
            help="Print the version.",
            callback=_print_version,
            is_eager=True,
        ),
    ] = False,
) -> None:
    """Plan, schedule and simulate teams of robots that build things together."""


for _name, _command in COMMANDS.load_all().items():
    if isinstance(_command, typer.Typer):
        app.add_typer(_command, name=_name)
    else:
        app.command(_name)(_command)


def main() -> None:
    """Run the program; see ``twin --help``."""
    gc.set_threshold(_COLLECT_AFTER)
    try:
        app()
    except KeyboardInterrupt:
        print_error("interrupted")
        sys.exit(ExitCode.INTERRUPTED)
    except BrokenPipeError:
        # The reader went away, as `head` does. Python would complain once more at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(ExitCode.FAILED)


if __name__ == "__main__":
    main()

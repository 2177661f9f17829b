"""The ``twin`` program."""

from __future__ import annotations

import os
import sys
from typing import Annotated

import typer

from twin.commands.cluster import app as cluster_app
from twin.commands.compare import compare
from twin.commands.doctor import doctor
from twin.commands.export import export
from twin.commands.fit import fit
from twin.commands.follow import follow
from twin.commands.imports.app import app as import_app
from twin.commands.replay import replay
from twin.commands.robots import robots
from twin.commands.run import resume, run
from twin.commands.sequence import sequence
from twin.commands.start import init, scenarios
from twin.commands.study import study
from twin.commands.validate import check, schema, validate
from twin.commands.verify import verify
from twin.host.guard import FAILED, INTERRUPTED, print_error

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


Version = Annotated[
    bool,
    typer.Option(
        "--version",
        help="Print the version.",
        callback=_print_version,
        is_eager=True,
    ),
]


@app.callback()
def _program(version: Version = False) -> None:
    """Plan, schedule and simulate teams of robots that build things together."""


app.command()(init)
app.command()(scenarios)
app.command()(run)
app.command()(validate)
app.command()(check)
app.command()(sequence)
app.command()(compare)
app.command()(study)
app.add_typer(cluster_app, name="cluster")
app.command()(replay)
app.command()(fit)
app.command()(resume)
app.command()(follow)
app.command()(export)
app.add_typer(import_app, name="import")
app.command()(verify)
app.command()(robots)
app.command()(schema)
app.command()(doctor)


def main() -> None:
    """Run the program; see ``twin --help``."""
    try:
        app()
    except KeyboardInterrupt:
        print_error("interrupted")
        sys.exit(INTERRUPTED)
    except BrokenPipeError:
        # The reader went away, as `head` does. Python would complain once more at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(FAILED)


if __name__ == "__main__":
    main()

"""The ``twin`` program."""

from __future__ import annotations

import os
import sys
from typing import Annotated

import typer

from twin.commands.doctor import doctor
from twin.commands.fit import fit
from twin.commands.operate import drive, operate
from twin.commands.plan import plan
from twin.commands.run import export, follow, replay, resume, run
from twin.commands.scenario_imports import app as import_app
from twin.commands.scenarios import check, init, robots, scenarios, schema, validate
from twin.commands.sequence import sequence
from twin.commands.study import cluster, compare, explore, study
from twin.commands.verify import judge, verify
from twin.host.guard import FAILED, INTERRUPTED, print_error

app = typer.Typer(
    name="twin",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


def _print_version(wanted: bool) -> None:
    """Print the version and end, if that is wanted."""
    if wanted:
        from twin.host.guard import versions

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


for _name, _function in {
    "init": init,
    "scenarios": scenarios,
    "plan": plan,
    "run": run,
    "operate": operate,
    "drive": drive,
    "validate": validate,
    "check": check,
    "sequence": sequence,
    "compare": compare,
    "study": study,
    "explore": explore,
    "replay": replay,
    "fit": fit,
    "resume": resume,
    "follow": follow,
    "export": export,
    "verify": verify,
    "judge": judge,
    "robots": robots,
    "schema": schema,
    "doctor": doctor,
}.items():
    app.command(_name)(_function)
app.add_typer(cluster, name="cluster")
app.add_typer(import_app, name="import")


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

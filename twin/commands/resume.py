"""``twin resume``: go on with a run that was killed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from twin.commands.options import AsJson, Quiet
from twin.host.guard import COMPLETED, FAILED, guarded, print_json

Folder = Annotated[Path, typer.Argument(help="Folder of the run.", metavar="LOGDIR")]
Base = Annotated[
    Path | None,
    typer.Option(
        help="Where relative paths of the scenario start; default: where they did.",
        metavar="DIR",
    ),
]


@guarded
def resume(
    folder: Folder, base: Base = None, as_json: AsJson = False, quiet: Quiet = False
) -> int:
    """Go on with a simulated run from its event log, after its process was killed.

    The run is computed again from the start, compared with the log event by event, and brought
    to its end: the files are those of a run that was never killed.
    """
    from twin.host.progress import StageDisplay
    from twin.run.folder import SUMMARY
    from twin.trial.trial import resume_run

    silent = quiet or as_json
    with StageDisplay(enabled=not silent) as progress:
        done = resume_run(folder, base=base, progress=progress)
    summary = (
        json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
        if done.trial is None
        else dict(done.trial.summary)
    )
    if as_json:
        print_json({"folder": str(folder), **summary})
    elif not quiet:
        from twin.run.folder import RECORDING
        from twin.run.summary import print_summary

        if done.trial is None:
            typer.echo(f"{folder}: the run has come to its end already")
        else:
            typer.echo(
                f"{folder}: {done.agreed} events of the log happened again,"
                f" {done.added} were missing"
            )
        print_summary(summary, folder, recording=(folder / RECORDING).exists())
    passed = done.trial is None or done.trial.passed
    return COMPLETED if passed else FAILED

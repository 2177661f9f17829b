"""Command ``twin view``: shows a cell and its runs in the browser, and changes its file."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Annotated

import typer

from twin.host.guard import guarded


@guarded
def view(
    path: Annotated[
        Path,
        typer.Argument(
            metavar="PATH",
            help="Scenario file, the name of one that twin scenarios lists, or the folder of a run, plan, study or exploration.",
        ),
    ],
    port: Annotated[
        int,
        typer.Option(
            min=1024,
            max=65535,
            help="Port of the page; the next free one if it is taken.",
        ),
    ] = 8130,
    browser: Annotated[
        bool, typer.Option("--open/--no-open", help="Open the page in the browser.")
    ] = True,
    read_only: Annotated[
        bool, typer.Option("--read-only", help="Show only: no changes and no commands.")
    ] = False,
) -> None:
    """Show a cell in 3-D in the browser: play its run, arrange it, check it, and run commands on it."""
    import webbrowser

    from twin.view.api import cell_page

    page = cell_page(path, port=port, read_only=read_only)
    typer.echo(page.server.address)
    typer.echo("Ctrl-C ends the page.")
    if browser:
        webbrowser.open(page.server.address)
    try:
        wait_for_interrupt()
    except KeyboardInterrupt:
        typer.echo("The page is closed.")
    finally:
        page.close()


def wait_for_interrupt() -> None:
    """Wait until somebody presses Ctrl-C."""
    threading.Event().wait()

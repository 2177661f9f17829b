"""``twin cluster``: certificates, and a scheduler and workers that only their holders reach."""

from __future__ import annotations

from pathlib import Path

import typer

from planning.errors import RequestError
from planning.parallel import usable_cores
from twin.cluster.certificates import (
    DEFAULT_PORT,
    certificates_in,
    encrypted,
    make_certificates,
)
from twin.commands.command import command

app = typer.Typer(
    no_args_is_help=True, help="Let other machines help with studies, over TLS."
)


def make(
    folder: Path,
    *,
    days: int = 90,
) -> None:
    """Make the certificates of a cluster: whoever has them may use it.

    Args:
        folder: folder to make; copy it to members.
        days: valid for so long.
    """
    make_certificates(folder, days)
    typer.echo(f"{folder}: valid for {days} days; key.pem is secret")


def serve(
    *,
    certificates: Path,
    host: str = "127.0.0.1",
    port: int = DEFAULT_PORT,
    workers: int | None = None,
) -> None:
    """Run a scheduler and workers on this machine until Ctrl-C.

    Args:
        certificates: folder that twin cluster certificates has made.
        host: address of this machine to listen on, and on no other.
        port: of the scheduler; 0 for any free one.
        workers: processes on this machine. Default: one a core.
    """
    held = certificates_in(certificates)
    _require_distributed()
    from twin.cluster.serving import serve_cluster

    count = usable_cores() if workers is None else workers
    serve_cluster(held, host, port, count, typer.echo)


def help_out(
    address: str,
    *,
    certificates: Path,
    host: str = "127.0.0.1",
    workers: int | None = None,
) -> None:
    """Run workers on this machine for the scheduler of another, until Ctrl-C.

    Args:
        address: of the scheduler: tls://host:port.
        certificates: folder that twin cluster certificates has made.
        host: address of this machine to listen on, and on no other.
        workers: processes on this machine. Default: one a core.
    """
    if not encrypted(address):
        raise RequestError(f"{address}: give the address as tls://host:port")
    held = certificates_in(certificates)
    _require_distributed()
    from twin.cluster.serving import serve_workers

    count = usable_cores() if workers is None else max(1, workers)
    serve_workers(held, address, host, count, typer.echo)


def _require_distributed() -> None:
    from twin.cluster.client import distributed

    distributed()


app.command("certificates")(
    command(
        f"{__name__}:make",
        folder={"metavar": "DIR"},
        days={"min": 1, "max": 3650},
    )
)
app.command("up")(
    command(
        f"{__name__}:serve",
        certificates={"metavar": "DIR"},
        port={"min": 0, "max": 65535, "default": DEFAULT_PORT},
        workers={"min": 0},
    )
)
app.command("join")(
    command(
        f"{__name__}:help_out",
        certificates={"metavar": "DIR"},
        workers={"min": 0},
    )
)

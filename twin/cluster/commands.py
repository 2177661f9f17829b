"""``twin cluster``: create certificates, and run a scheduler and workers that require them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from planning.errors import RequestError
from planning.parallel import usable_cores
from twin.cluster.address import DEFAULT_PORT, Cluster, encrypted
from twin.cluster.certificates import certificates_in, make_certificates
from twin.host.guard import guarded

Certificates = Annotated[
    Path,
    typer.Option(metavar="DIR", help="Folder created by twin cluster certificates."),
]
Host = Annotated[
    str, typer.Option(help="Address of this machine to listen on, and on no other.")
]
Workers = Annotated[
    int | None,
    typer.Option(min=0, help="Processes on this machine. Default: one per core."),
]

cluster = typer.Typer(
    no_args_is_help=True, help="Use other machines for studies, over TLS."
)


@cluster.command("certificates")
@guarded
def make(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="DIR",
            help="Folder to create; copy it to the machines of the cluster.",
        ),
    ],
    days: Annotated[int, typer.Option(min=1, max=3650, help="Validity [days].")] = 90,
) -> None:
    """Create the certificates of a cluster; their holders may use it."""
    make_certificates(folder, days)
    typer.echo(f"{folder}: valid for {days} days; key.pem is secret")


@cluster.command("up")
@guarded
def serve(
    certificates: Certificates,
    host: Host = "127.0.0.1",
    port: Annotated[
        int,
        typer.Option(
            min=0, max=65535, help="Port of the scheduler; 0 for any free one."
        ),
    ] = DEFAULT_PORT,
    workers: Workers = None,
) -> None:
    """Run a scheduler and workers on this machine until Ctrl-C."""
    held = certificates_in(certificates)
    _require_distributed()
    from twin.cluster.serving import serve_cluster

    count = usable_cores() if workers is None else workers
    serve_cluster(held, host, port, count, typer.echo)


@cluster.command("join")
@guarded
def join(
    address: Annotated[
        str,
        typer.Argument(
            metavar="ADDRESS", help="Address of the scheduler: tls://host:port."
        ),
    ],
    certificates: Certificates,
    host: Host = "127.0.0.1",
    workers: Workers = None,
) -> None:
    """Run workers on this machine for the scheduler of another, until Ctrl-C."""
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


def given_cluster(
    scheduler: str | None, certificates: Path | None, insecure: bool
) -> Cluster | None:
    """Return the cluster given by command options, None without a scheduler.

    Raises:
        RequestError: they do not go together.
    """
    if scheduler is None:
        if certificates is not None or insecure:
            raise RequestError("--certificates and --insecure go with --scheduler")
        return None
    held = None if certificates is None else certificates_in(certificates)
    return Cluster(scheduler, held, insecure)

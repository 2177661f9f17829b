"""Programs that tests of clusters start, and ports for them."""

import os
import socket
import subprocess
import sys
from pathlib import Path

from twin.cluster.address import Cluster
from twin.cluster.certificates import make_certificates

ROOT = Path(__file__).parents[3]


def free_port(host: str = "127.0.0.1") -> int:
    with socket.socket() as probe:
        probe.bind((host, 0))
        return int(probe.getsockname()[1])


def start(*arguments: str | Path, folder: Path) -> subprocess.Popen[str]:
    """Start the twin's program in a folder; what it says can be read."""
    return subprocess.Popen(
        [sys.executable, "-m", "twin.cli", *map(str, arguments)],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def up(folder: Path, workers: int = 1) -> tuple[subprocess.Popen[str], Cluster]:
    """Start a cluster with certificates of its own in a folder; return its process, and how to reach it."""
    certificates = make_certificates(folder / "certs", 1)
    process = start(
        *("cluster", "up", "--certificates", "certs", "--port", "0"),
        *("--workers", str(workers)),
        folder=folder,
    )
    assert process.stdout is not None
    address = process.stdout.readline().split()[0]
    return process, Cluster(address, certificates)

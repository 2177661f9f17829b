"""A cluster started as the guide says lets nobody in: who listens where, and who is answered."""

import re
import shlex
import signal
import socket
import ssl
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.twin.cluster.processes import ROOT, free_port, start
from tests.twin.studies.study_toys import toy_workload
from twin.cluster.address import Cluster
from twin.cluster.certificates import Certificates, certificates_in, make_certificates
from twin.cluster.client import ClusterError
from twin.studies.folder import write_replications
from twin.studies.replications.executors import open_executor, parallelism
from twin.studies.replications.experiment import Experiment
from twin.studies.replications.runner import run_replications

pytest.importorskip("distributed")
psutil = pytest.importorskip("psutil")

GUIDE = (ROOT / "docs/guides/cluster.md").read_text(encoding="utf-8")
PLACES = {"10.0.0.1": "127.0.0.2", "10.0.0.2": "127.0.0.3"}
"""Machines of the guide, and addresses that stand for them: all of the loopback interface."""

WITHIN_S = 60.0
TLS_ALERT = b"\x15"
SOME = Experiment(("asynchronous",), replications=1200)


def guide_command(start: str, port: int, *more: str) -> list[str]:
    """Return a command of the guide, on loopback, with another port."""
    (line,) = re.findall(rf"^\$ ({start} .*)$", GUIDE, re.MULTILINE)
    for place, here in PLACES.items():
        line = line.replace(place, here)
    program, *arguments = shlex.split(line.replace(":8786", f":{port}"))
    assert program == "twin"
    return [*arguments, *more]


@contextmanager
def serving(command: list[str], folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Run a command until its first line is there; it must end well at SIGTERM."""
    process = start(*command, folder=folder)
    try:
        assert process.stdout is not None
        assert "Ctrl-C" in process.stdout.readline()
        yield process
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
            assert process.wait(WITHIN_S) == 0
    finally:
        process.kill()
        process.communicate()


class Started(NamedTuple):
    """The cluster of the guide."""

    address: str
    certificates: Certificates
    processes: dict[str, subprocess.Popen[str]]


@pytest.fixture(scope="module")
def started(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Started]:
    folder = tmp_path_factory.mktemp("cluster")
    port = free_port(PLACES["10.0.0.1"])
    made = start(*guide_command("twin cluster certificates", port), folder=folder)
    _, errors = made.communicate()
    assert made.returncode == 0, errors
    with ExitStack() as stack:
        up = guide_command("twin cluster up", port, "--port", str(port))
        join = guide_command("twin cluster join", port)
        processes = {
            host: stack.enter_context(serving([*command, "--workers", "1"], folder))
            for host, command in zip(PLACES.values(), (up, join), strict=True)
        }
        yield Started(
            f"tls://{PLACES['10.0.0.1']}:{port}",
            certificates_in(folder / "certs"),
            processes,
        )


def sockets(process: subprocess.Popen[str]) -> list[tuple[str, int]]:
    """Return where a process and all that it has started wait for others, as the system says."""
    parent = psutil.Process(process.pid)
    return [
        (str(found.laddr.ip), int(found.laddr.port))
        for member in (parent, *parent.children(recursive=True))
        for found in member.net_connections("inet")
        if found.status in (psutil.CONN_LISTEN, psutil.CONN_NONE)
    ]


def test_nothing_listens_but_on_the_address_that_was_named(started: Started) -> None:
    counts = []
    for host, process in started.processes.items():
        found = sockets(process)
        assert {ip for ip, _ in found} == {host}
        counts.append(len(found))
    # Scheduler, nanny and worker; nanny and worker: no pages, nothing else.
    assert counts == [3, 2]


def greeting(where: tuple[str, int], context: ssl.SSLContext | None) -> bytes:
    """Return the first bytes that a server says; servers of Dask speak first."""
    with socket.create_connection(where, timeout=5) as plain:
        try:
            if context is None:
                plain.sendall(b"GET / HTTP/1.0\r\n\r\n")
                return plain.recv(100)
            with context.wrap_socket(plain) as wrapped:
                return wrapped.recv(100)
        except (ssl.SSLError, ConnectionError):
            return b""


def context(held: Certificates | None) -> ssl.SSLContext:
    trusting = ssl.create_default_context()
    trusting.check_hostname = False
    trusting.verify_mode = ssl.CERT_NONE
    if held is not None:
        trusting.load_cert_chain(held.certificate, held.key)
    return trusting


def test_only_who_has_the_certificates_is_answered(
    started: Started, tmp_path: Path
) -> None:
    strangers = make_certificates(tmp_path / "strangers", 1)
    for process in started.processes.values():
        for where in sockets(process):
            assert greeting(where, context(started.certificates)) != b""
            assert greeting(where, context(None)) == b""
            assert greeting(where, context(strangers)) == b""
            # Who speaks in the clear is told nothing but that TLS is wanted, if that.
            assert greeting(where, None)[:1] in (b"", TLS_ALERT)


def test_clients_without_the_certificates_are_told_so(
    started: Started, tmp_path: Path
) -> None:
    strangers = make_certificates(tmp_path / "strangers", 1)
    for cluster in (
        Cluster(started.address.replace("tls://", "tcp://")),
        Cluster(started.address, strangers),
    ):
        with (
            pytest.raises(ClusterError, match="no scheduler answered"),
            open_executor(cluster=cluster, answer_within_s=2),
        ):
            pass


@pytest.mark.nightly
def test_results_are_those_of_one_process(started: Started, tmp_path: Path) -> None:
    cluster = Cluster(started.address, started.certificates)
    with open_executor(cluster=cluster) as executor:
        assert parallelism(executor) == 2
    tables = []
    for name, chosen in (("cluster", cluster), ("one", None)):
        folder = tmp_path / name
        run_replications(
            SOME,
            [toy_workload()],
            folder,
            lambda chosen=chosen: open_executor(0, chosen),  # type: ignore[misc]
        )
        write_replications(path := folder.with_suffix(".parquet"), SOME, folder)
        tables.append(path.read_bytes())
    assert tables[0] == tables[1]


@pytest.mark.nightly
def test_workers_whose_scheduler_dies_end(tmp_path: Path) -> None:
    make_certificates(tmp_path / "certs", 1)
    port = free_port(PLACES["10.0.0.1"])
    up = guide_command("twin cluster up", port, "--port", str(port), "--workers", "0")
    join = guide_command("twin cluster join", port, "--workers", "1")
    with serving(up, tmp_path) as scheduler, serving(join, tmp_path) as helper:
        begin = time.monotonic()
        scheduler.kill()
        assert helper.wait(WITHIN_S) == 1
        assert time.monotonic() - begin < WITHIN_S

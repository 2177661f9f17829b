"""Studies on a Dask cluster: the same results, even when a worker is killed in the middle."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.twin.cluster.processes import ROOT, free_port
from tests.twin.study.study_toys import toy_workload
from twin.cluster.certificates import Cluster
from twin.cluster.client import ClusterError
from twin.study.replications import runner
from twin.study.replications.runner import run_replications
from twin.study.replications.statistics import Experiment
from twin.study.replications.workload import open_executor, parallelism
from twin.study.tables import write_replications

distributed = pytest.importorskip("distributed")

ONE = Experiment(("asynchronous",), replications=120)
WITHIN_S = 30.0


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "BULK_BLOCK", 8)


def _table(folder: Path) -> bytes:
    path = folder.with_suffix(".parquet")
    write_replications(path, ONE, folder)
    return path.read_bytes()


def _in_process(folder: Path) -> bytes:
    run_replications(ONE, [toy_workload()], folder, lambda: open_executor(workers=0))
    return _table(folder)


def test_a_local_cluster_gives_what_one_process_gives(tmp_path: Path) -> None:
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None
    ) as cluster:
        address = cluster.scheduler_address
        with open_executor(cluster=Cluster(address)) as executor:
            assert parallelism(executor) == 2
        run_replications(
            ONE,
            [toy_workload()],
            tmp_path / "cluster",
            lambda: open_executor(cluster=Cluster(address)),
        )
    assert _table(tmp_path / "cluster") == _in_process(tmp_path / "one")


@contextmanager
def _process(*arguments: str, cwd: Path) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(
        [sys.executable, "-m", *arguments],
        cwd=cwd,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def _when_there(address: str, workers: int) -> None:
    deadline = time.monotonic() + WITHIN_S
    while time.monotonic() < deadline:
        try:
            with open_executor(cluster=Cluster(address), answer_within_s=5) as executor:
                if parallelism(executor) == workers:
                    return
        except ClusterError:
            pass
        time.sleep(0.1)
    raise TimeoutError(f"no {workers} workers at {address}")


class _Killing(Executor):
    """Kills a process after some submissions."""

    def __init__(self, executor: Executor, victim: subprocess.Popen[bytes]) -> None:
        self.executor, self.victim, self.left = executor, victim, 5
        self.threads = executor.threads  # type: ignore[attr-defined]

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kw: Any) -> Future[Any]:
        self.left -= 1
        if self.left == 0:
            self.victim.kill()
            self.victim.wait()
        return self.executor.submit(fn, *args, **kw)


def test_a_killed_worker_of_a_cluster_loses_nothing(tmp_path: Path) -> None:
    port = free_port()
    address = f"tcp://127.0.0.1:{port}"
    scheduler = (
        *("distributed.cli.dask_scheduler", "--host", "127.0.0.1"),
        *("--port", str(port), "--no-dashboard", "--no-show"),
    )
    worker = (
        *("distributed.cli.dask_worker", address, "--nworkers", "1"),
        *("--nthreads", "1", "--no-dashboard", "--no-nanny"),
        *("--host", "127.0.0.1", "--local-directory", str(tmp_path)),
    )
    with (
        _process(*scheduler, cwd=ROOT),
        _process(*worker, cwd=ROOT) as first,
        _process(*worker, cwd=ROOT),
    ):
        _when_there(address, 2)

        @contextmanager
        def killing() -> Iterator[Executor]:
            with open_executor(cluster=Cluster(address)) as executor:
                yield _Killing(executor, first)

        run_replications(ONE, [toy_workload()], tmp_path / "cluster", killing)
        assert first.poll() is not None
    assert _table(tmp_path / "cluster") == _in_process(tmp_path / "one")


def test_a_scheduler_that_is_not_there_is_named() -> None:
    address = f"tcp://127.0.0.1:{free_port()}"
    started = time.monotonic()
    with (
        pytest.raises(ClusterError, match=f"no scheduler answered at {address}"),
        open_executor(cluster=Cluster(address), answer_within_s=0.5),
    ):
        pass
    assert time.monotonic() - started < 10


def test_a_scheduler_without_workers_is_named() -> None:
    with (
        distributed.LocalCluster(
            n_workers=0, processes=False, dashboard_address=None
        ) as cluster,
        pytest.raises(ClusterError, match="has no workers"),
        open_executor(cluster=Cluster(cluster.scheduler_address)),
    ):
        pass

"""Clusters that go away in the middle of a study: one line, and everything can go on."""

import asyncio
import os
import signal
import time
from collections.abc import Awaitable, Callable, Generator, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.twin.cluster.processes import ROOT, start, up
from tests.twin.program import invoke
from tests.twin.studies.study_toys import toy_workload
from twin.cluster.address import Cluster
from twin.cluster.client import ClusterError, ClusterExecutor, ClusterLostError
from twin.studies.folder import write_replications
from twin.studies.replications import runner
from twin.studies.replications.executors import open_executor
from twin.studies.replications.experiment import Experiment
from twin.studies.replications.runner import run_replications

distributed = pytest.importorskip("distributed")
psutil = pytest.importorskip("psutil")

SCENARIO = ROOT / "scenarios/multi_arm/rearrangement.yaml"
TABLES = ("replications.parquet", "tasks.parquet", "edges.parquet", "summary.json")
WITHIN_S = 300.0
SOME = Experiment(("asynchronous",), replications=120)


@pytest.mark.nightly
def test_a_study_whose_scheduler_is_killed_goes_on(tmp_path: Path) -> None:
    size = ("-n", "40000", "--policy", "asynchronous", "--shortcuts", "0", "-q")
    whole, lost = tmp_path / "whole", tmp_path / "lost"
    invoke("study", SCENARIO, *size, "--workers", "0", "--out", whole, code=0)
    scheduler, cluster = up(tmp_path)
    assert cluster.certificates is not None
    study = start(
        *("study", SCENARIO, *size, "--out", lost, "--scheduler", cluster.address),
        *("--certificates", cluster.certificates.key.parent),
        folder=tmp_path,
    )
    deadline = time.monotonic() + WITHIN_S
    while len(list(lost.glob("blocks/[0-9]*.npz"))) < 3:
        assert study.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.01)
    scheduler.send_signal(signal.SIGKILL)
    told, errors = study.communicate(timeout=WITHIN_S)
    scheduler.communicate()
    assert (study.returncode, told) == (1, "")
    (line,) = errors.splitlines()
    assert line.startswith(f"error: the scheduler at {cluster.address} went away")
    assert f"--resume {lost}" in line
    assert 3 <= len(list(lost.glob("blocks/[0-9]*.npz"))) < 80
    invoke("study", "--resume", lost, "--workers", "0", "-q", code=0)
    for name in TABLES:
        assert (lost / name).read_bytes() == (whole / name).read_bytes(), name


class _Killing(Executor):
    """Kills a worker of a cluster after some submissions."""

    def __init__(self, executor: ClusterExecutor, scheduler: int) -> None:
        self.executor, self.scheduler, self.left = executor, scheduler, 5
        self.threads = executor.threads

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kw: Any) -> Future[Any]:
        self.left -= 1
        if self.left == 0:
            started = psutil.Process(self.scheduler).children(recursive=True)
            worker = next(c for c in started if "spawn_main" in " ".join(c.cmdline()))
            worker.kill()
            worker.wait()
        return self.executor.submit(fn, *args, **kw)


@pytest.mark.nightly
def test_a_killed_worker_of_a_cluster_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(runner, "BULK_BLOCK", 8)
    scheduler, cluster = up(tmp_path, workers=2)
    killers = []

    @contextmanager
    def killing() -> Iterator[Executor]:
        with open_executor(cluster=cluster) as executor:
            assert isinstance(executor, ClusterExecutor)
            killers.append(_Killing(executor, scheduler.pid))
            yield killers[-1]

    tables = []
    for name, opened in (("cluster", killing), ("one", lambda: open_executor(0))):
        run_replications(SOME, [toy_workload()], tmp_path / name, opened)
        write_replications(path := tmp_path / f"{name}.parquet", SOME, tmp_path / name)
        tables.append(path.read_bytes())
    scheduler.terminate()
    scheduler.communicate(timeout=WITHIN_S)
    assert killers[0].left <= 0
    assert tables[0] == tables[1]


def test_a_scheduler_without_workers_is_named() -> None:
    with (
        distributed.LocalCluster(
            n_workers=0, processes=False, dashboard_address=None
        ) as cluster,
        pytest.raises(ClusterError, match="has no workers"),
        open_executor(cluster=Cluster(cluster.scheduler_address)),
    ):
        pass


def _die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.nightly
def test_work_that_kills_every_worker_is_givenup(tmp_path: Path) -> None:
    scheduler, cluster = up(tmp_path)
    with (
        pytest.raises(ClusterLostError, match=r"workers .* died again and again"),
        open_executor(cluster=cluster) as executor,
    ):
        executor.submit(_die).result(WITHIN_S)
    scheduler.terminate()
    scheduler.communicate(timeout=WITHIN_S)
    assert scheduler.returncode == 0


class _Gone:
    """A call whose scheduler goes away before its result is fetched."""

    def __await__(self) -> Generator[None, None, int]:
        yield
        raise asyncio.CancelledError


class _Client:
    """A client that submits to nobody."""

    def __init__(self) -> None:
        self.loop = self

    def submit(self, *_: Any, **__: Any) -> _Gone:
        return _Gone()

    def add_callback(self, fn: Callable[..., Awaitable[None]], *args: Any) -> None:
        asyncio.run(fn(*args))  # type: ignore[arg-type]


def test_a_result_that_cannot_be_fetched_ends_its_call() -> None:
    future = ClusterExecutor(_Client()).submit(int)
    assert future.done()
    assert isinstance(future.exception(), asyncio.CancelledError)

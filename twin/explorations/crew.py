"""Worker processes that evaluate cell designs. A crash or timeout affects only one design.

On a cluster, each evaluation runs in a process separate from the Dask worker, so a crash does not stop the worker.
"""

from __future__ import annotations

import multiprocessing
import pickle
import signal
import socket
import threading
import time
import zlib
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future
from concurrent.futures import wait as wait_for_calls
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any, Protocol

import numpy as np

from planning.errors import TwinError
from twin.cluster.client import ClusterError
from twin.explorations.rungs import (
    CHECK,
    Evaluation,
    ExplorationSetting,
    RungClimb,
    refused_evaluation,
)
from twin.reading.checks import find_problems
from twin.scenario.variations import Variant

_CRASHES = 3
"""Workers that may die before they have begun anything: then the machine is at fault, not a design."""

_START_S = 600.0
"""Time limit for the start of a process [s]."""


_OWN = threading.local()
"""State of each thread of a worker: its crew, and what that evaluates."""


@dataclass(frozen=True)
class DesignTask:
    """A design to evaluate.

    Attributes:
        number: number by which its result is identified.
        variant: its changes to the scenario.
        longest_turns_s: makespan of a plan without shortcuts above which the design is rejected as behind [s].
        planner_seed: replaces the planner seed of the scenario; the seed of the draws stays the same.
    """

    number: int
    variant: Variant
    longest_turns_s: float = np.inf
    planner_seed: int | None = None


class Evaluators(Protocol):
    """Evaluators of designs in parallel: processes of this machine, or a cluster."""

    @property
    def idle(self) -> int:
        """Number of idle evaluators."""

    @property
    def busy(self) -> int:
        """Number of designs in evaluation."""

    def submit(self, task: DesignTask) -> None:
        """Submit a design to an idle evaluator; there must be one."""

    def finished(self) -> Iterator[tuple[DesignTask, Evaluation]]:
        """Wait for at least one design, and yield those that are finished, by number."""


class Crew:
    """Worker processes, each with one design at a time.

    Args:
        setting: of the exploration.
        workers: how many processes.
        limit_s: timeout of a design, after which its worker is ended [s].
    """

    def __init__(
        self, setting: ExplorationSetting, workers: int, limit_s: float
    ) -> None:
        self._setting, self._limit_s = setting, limit_s
        # Spawned, not forked: threads of compiled libraries do not survive a fork.
        self._context = multiprocessing.get_context("spawn")
        self._workers: list[_DesignWorker | None] = [None] * workers
        self._stillborn = 0

    def __enter__(self) -> Crew:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End all processes immediately."""
        for worker in self._workers:
            if worker is not None:
                worker.end()

    @property
    def idle(self) -> int:
        """Number of idle evaluators."""
        return sum(w is None or w.task is None for w in self._workers)

    @property
    def busy(self) -> int:
        """Number of designs in evaluation."""
        return len(self._workers) - self.idle

    def submit(self, task: DesignTask) -> None:
        """Submit a design to an idle worker; there must be one."""
        place = next(
            k for k, w in enumerate(self._workers) if w is None or w.task is None
        )
        worker = self._workers[place]
        if worker is None or not worker.process.is_alive():
            worker = _DesignWorker(self._context, self._setting)
            self._workers[place] = worker
        worker.begin(task)

    def finished(self) -> Iterator[tuple[DesignTask, Evaluation]]:
        """Wait for at least one design, and yield those that are finished, by number.

        Raises:
            TwinError: processes end again and again before they begin.
        """
        found: list[tuple[DesignTask, Evaluation]] = []
        while not found and self.busy:
            busy = [w for w in self._workers if w is not None and w.task is not None]
            left = min(w.left_s(self._limit_s) for w in busy)
            wait([w.pipe for w in busy], timeout=max(0.0, left))
            for worker in busy:
                task = worker.task
                assert task is not None
                if (done := self._poll_worker(worker)) is not None:
                    found.append((task, done))
        yield from sorted(found, key=lambda item: item[0].number)

    def _poll_worker(self, worker: _DesignWorker) -> Evaluation | None:
        """Return the result of a worker, or its failure; None while it works."""
        try:
            while worker.pipe.poll():
                said = worker.pipe.recv()
                if isinstance(said, Evaluation):
                    worker.task = None
                    return said
                worker.report_rung(said)
        except (EOFError, OSError):
            return self._dead(worker)
        if worker.left_s(self._limit_s) <= 0.0:
            rung = worker.rung or CHECK
            self._drop(worker)
            return refused_evaluation(rung, f"not done within {self._limit_s:g} s", 0.9)
        return None

    def _dead(self, worker: _DesignWorker) -> Evaluation:
        worker.process.join(5.0)
        code, rung = worker.process.exitcode, worker.rung
        self._drop(worker)
        if not rung:
            self._stillborn += 1
            if self._stillborn >= _CRASHES:
                raise TwinError(
                    f"{_CRASHES} processes ended before they began (exit code {code}); what was done is"
                    " kept, continue with --resume"
                )
        how = f"exit code {code}"
        if code is not None and code < 0:
            with suppress(ValueError):
                how = signal.Signals(-code).name
        return refused_evaluation(rung or CHECK, f"its process died ({how})", 0.9)

    def _drop(self, worker: _DesignWorker) -> None:
        worker.end()
        self._workers[self._workers.index(worker)] = None


class _DesignWorker:
    """A worker process and its design."""

    def __init__(self, context: Any, setting: ExplorationSetting) -> None:
        self.pipe, own = context.Pipe()
        self.process: SpawnProcess = context.Process(
            target=_work, args=(own, setting), daemon=True
        )
        self.process.start()
        own.close()
        self.task: DesignTask | None = None
        self.rung, self._ready, self._since = "", False, time.monotonic()

    def begin(self, task: DesignTask) -> None:
        self.task, self.rung, self._since = task, "", time.monotonic()
        with suppress(OSError):  # it is dead: that is seen when it is looked at
            self.pipe.send(task)

    def report_rung(self, rung: str) -> None:
        if not self._ready:  # importing is no part of a design
            self._ready, self._since = True, time.monotonic()
        self.rung = rung

    def left_s(self, limit_s: float) -> float:
        limit = limit_s if self._ready else _START_S
        return limit - (time.monotonic() - self._since)

    def end(self) -> None:
        self.process.kill()
        self.process.join(5.0)
        self.pipe.close()


def _work(pipe: Connection, setting: ExplorationSetting) -> None:
    """Evaluate designs until the parent process ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(EOFError, OSError):
        while True:
            task: DesignTask = pipe.recv()
            limits = task.longest_turns_s, task.planner_seed
            climb = RungClimb(setting, task.variant, *limits, began=pipe.send)
            pipe.send(climb.evaluate())


class ClusterCrew:
    """Workers of a cluster, each with one design at a time.

    Args:
        setting: of the exploration; files that its scenario names are read where the workers are, so
            they must be there in the same folder.
        executor: of the cluster.
        workers: number of parallel calls.
        limit_s: timeout of a design [s].
    """

    def __init__(
        self,
        setting: ExplorationSetting,
        executor: Executor,
        workers: int,
        limit_s: float,
    ) -> None:
        self._packed_setting = zlib.compress(pickle.dumps(setting))
        self._executor, self._workers, self._limit_s = executor, workers, limit_s
        self._calls: dict[Future[Evaluation], DesignTask] = {}

    @property
    def idle(self) -> int:
        """Number of idle evaluators."""
        return self._workers - self.busy

    @property
    def busy(self) -> int:
        """Number of designs in evaluation."""
        return len(self._calls)

    def submit(self, task: DesignTask) -> None:
        """Send a design to the cluster."""
        call = self._executor.submit(
            evaluate_on_worker, self._packed_setting, self._limit_s, task
        )
        self._calls[call] = task

    def finished(self) -> Iterator[tuple[DesignTask, Evaluation]]:
        """Wait for at least one design, and yield those that are finished, by number.

        Raises:
            ClusterError: workers lack files that the scenario names, or may start no processes.
        """
        done, _ = wait_for_calls(self._calls, return_when=FIRST_COMPLETED)
        found = [(self._calls.pop(call), call.result()) for call in done]
        yield from sorted(found, key=lambda item: item[0].number)


def evaluate_on_worker(
    packed_setting: bytes, limit_s: float, task: DesignTask
) -> Evaluation:
    """Evaluate a design; the function that workers of a cluster call.

    Args:
        packed_setting: the setting of the exploration, packed.
        limit_s: timeout of a design [s].
        task: the design.

    Raises:
        ClusterError: files that the scenario names are not here, or this process may start no others.
    """
    if getattr(_OWN, "packed_setting", None) != (packed_setting, limit_s):
        if (before := getattr(_OWN, "crew", None)) is not None:
            before.close()
        _OWN.crew = _crew(pickle.loads(zlib.decompress(packed_setting)), limit_s)
        _OWN.packed_setting = packed_setting, limit_s
    crew: Crew = _OWN.crew
    crew.submit(task)
    ((_, found),) = crew.finished()
    return found


def _crew(setting: ExplorationSetting, limit_s: float) -> Crew:
    if multiprocessing.current_process().daemon:
        raise ClusterError(
            "workers of this cluster may start no processes, which designs need: start them with twin"
            " cluster up or join, or with DASK_DISTRIBUTED__WORKER__DAEMON=False"
        )
    for _, message in find_problems(setting.scenario, setting.folder):
        raise ClusterError(
            f"the worker on {socket.gethostname()} has not what the scenario names: {message}; files"
            f" must be in {setting.folder} on every machine"
        )
    return Crew(setting, 1, limit_s)


def evaluate_in_parallel(
    tasks: Sequence[DesignTask], crew: Evaluators
) -> Iterator[tuple[DesignTask, Evaluation]]:
    """Yield the evaluations of designs as they finish."""
    waiting = list(reversed(tasks))
    while waiting or crew.busy:
        while waiting and crew.idle:
            crew.submit(waiting.pop())
        yield from crew.finished()

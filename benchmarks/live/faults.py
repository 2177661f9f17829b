"""Faults of a live session: dispatchers and drivers that are killed, connections and messages that fail.

    python -m benchmarks.live.faults --runs 100 --jobs 8

The dispatcher is a process of its own, its drivers are simulated arms that talk to it by gRPC. In each run
something else fails, at a moment that is drawn. Afterwards both logs are looked at: nothing may have been cleared
twice, no robot may have begun what it was not cleared for, and the audit must find nothing; a run ends
completed, or with the cause in its log.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import random
import resource
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from planning.errors import RequestError
from twin.drivers.driver import ClearedNode
from twin.drivers.simulated_arm import SimulatedArm
from twin.live.driver_end import DriverEnd
from twin.live.service import drive_remotely
from twin.live.wire_format import Command, Report
from twin.trial.loaded_scenario import load

FAULTS = (
    "dispatcher killed",
    "driver killed",
    "connection cut",
    "messages late",
    "messages doubled",
    "messages lost",
    "clocks apart",
    "disk full",
)
_HOUR_S = 3600.0


class WatchedArm(SimulatedArm):
    """An arm that notes which nodes it was given, and whether it ever went beyond them."""

    def __init__(
        self,
        given: list[int],
        clock: Callable[[], float],
        pace: float,
        stands: Any = None,
    ) -> None:
        super().__init__(clock, pace=pace, stands=stands)
        self.given, self.beyond = given, False

    def take(self, nodes: list[ClearedNode]) -> None:
        """Take further nodes."""
        self.given += [node.node for node in nodes]
        super().take(nodes)

    def state(self) -> Any:
        """Return how far it is."""
        found = super().state()
        self.beyond |= found.begun > max(self.given, default=-1) + 1
        return found


class BadEnd(DriverEnd):
    """The end of a session at a driver, to which messages come badly."""

    def __init__(self, *rest: Any, rng: random.Random, fault: str, **more: Any) -> None:
        super().__init__(*rest, **more)
        self._rng, self._fault = rng, fault
        self._late: list[tuple[float, Command]] = []
        self._last: Report | None = None

    def receive(self, command: Command) -> None:
        """Take a command, late, twice, or not at all."""
        if self._fault == "messages lost" and self._rng.random() < 0.5:
            return
        if self._fault == "messages late":
            self._late.append((time.monotonic() + self._rng.uniform(0, 2.0), command))
            now = time.monotonic()
            here = [c for t, c in self._late if t <= now]
            self._late = [item for item in self._late if item[0] > now]
            for late in here:
                super().receive(late)
            return
        super().receive(command)
        if self._fault == "messages doubled":
            super().receive(command)

    def report(self) -> Report:
        """Return what is told, or what was told before."""
        twice = self._fault == "messages doubled" and self._rng.random() < 0.3
        if twice and self._last is not None:
            return self._last
        self._last = super().report()
        return self._last


@dataclass
class DrivenRobot:
    """A robot of the cell, and whoever drives it by now."""

    robot: str
    address: str
    rng: random.Random
    fault: str
    pace: float
    given: list[int] = field(default_factory=list)
    beyond: bool = False
    starts: int = 0

    def start(self, stands: Any = None) -> None:
        """Start its driver, which finds the robot where it stands."""
        self.starts += 1
        apart = self.rng.choice([-_HOUR_S, _HOUR_S]) * (self.fault == "clocks apart")

        def clock() -> float:
            return time.monotonic() + apart

        self.arm = WatchedArm(self.given, clock, self.pace, stands)
        self.end = BadEnd(
            self.arm,
            self.robot,
            time.time_ns(),
            clock,
            rng=self.rng,
            fault=self.fault,
        )
        self.connect()

    def connect(self) -> None:
        """Let the driver ask for its cell."""
        stop = self.stop = threading.Event()
        self.thread = threading.Thread(
            target=_ask, args=(self.end, self.address, stop.is_set), daemon=True
        )
        self.thread.start()

    def cut(self) -> None:
        """Let it ask no more."""
        self.stop.set()
        self.thread.join(10.0)

    def kill(self) -> None:
        """End its driver; the robot stands, and a new one begins."""
        self.cut()
        self.beyond |= self.arm.beyond
        self.start(np.array(self.arm.state().q))


def _ask(end: DriverEnd, address: str, over: Callable[[], bool]) -> None:
    try:
        drive_remotely(end, address, over=over, every_s=0.01, patience_s=90.0)
    except RequestError as error:
        sys.stderr.write(f"{error}\n")


def _small_files() -> None:
    """Let the process write no large file, as on a disk that is full."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (120_000, 120_000))


def events_of(out: Path) -> list[dict[str, Any]]:
    """Return the whole lines of a log."""
    log = out / "events.jsonl"
    text = log.read_text() if log.exists() else ""
    return [json.loads(line) for line in text.splitlines() if line.endswith("}")]


def run(
    scenario: str, fault: str, seed: int, pace: float, spread_s: float, folder: Path
) -> dict[str, Any]:
    """Execute a scenario once with a fault; return what came of it."""
    rng = random.Random(seed)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    robots = [robot.name for robot in load(scenario).sections.cell.robots]
    kinds = ", ".join(f"{name}: {{kind: grpc}}" for name in robots)
    file, out = folder / "drivers.yaml", folder / "run"
    file.write_text(
        f"pace: {pace}\nlisten: {address}\nout_s: 80\nrobots: {{{kinds}}}\n"
    )
    driven = [DrivenRobot(name, address, rng, fault, pace) for name in robots]
    for own in driven:
        own.start()

    def begin(*words: object) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "twin.cli", *map(str, words), "--quiet"]
        limit = _small_files if fault == "disk full" else None
        return subprocess.Popen(
            command, stderr=subprocess.PIPE, text=True, preexec_fn=limit
        )

    files = ("--drivers", file, "--out", out, "--no-recording")
    dispatcher = begin("operate", scenario, *files)
    _wait(lambda: len(events_of(out)) > 50 or dispatcher.poll() is not None)
    for _ in range(rng.randint(1, 3)):
        time.sleep(rng.uniform(0.1, spread_s / pace))
        one = rng.choice(driven)
        if fault == "dispatcher killed" and dispatcher.poll() is None:
            dispatcher.kill()
            dispatcher.communicate()
            dispatcher = begin("resume", out)
            count = len(events_of(out))
            _wait(
                partial(_more, out, count, dispatcher),
            )
        elif fault == "driver killed":
            one.kill()
        elif fault == "connection cut":
            one.cut()
            time.sleep(rng.choice([0.1, 1.0, 5.0, 20.0, 60.0]))
            one.connect()
    try:
        told = dispatcher.communicate(timeout=300 + 600 / pace)[1]
    except subprocess.TimeoutExpired:
        dispatcher.kill()
        told = "did not end"
    for own in driven:
        own.cut()
        own.beyond |= own.arm.beyond
    events = events_of(out)
    released = Counter(
        (e["robot"], e["node"]) for e in events if e["kind"] == "released"
    )
    summary = out / "summary.json"
    figures = json.loads(summary.read_text()) if summary.exists() else {}
    violations = figures.get("audit", {}).get("violations", [])
    return {
        "fault": fault,
        "seed": seed,
        "outcome": figures.get("outcome", _cause(told)),
        "cleared twice": sum(n - 1 for n in released.values()),
        "beyond": sum(bool(own.beyond) for own in driven),
        "violations": [v["kind"] for v in violations],
    }


def _cause(told: str) -> str:
    """Return what a dispatcher says it ended by, without what libraries tell."""
    lines = [line.strip() for line in told.splitlines() if line.strip()]
    own = [line for line in lines if line.startswith("error")]
    return (own or lines or ["nothing"])[-1]


def _more(out: Path, count: int, process: subprocess.Popen[str]) -> bool:
    return len(events_of(out)) > count or process.poll() is not None


def _wait(until: Callable[[], bool], seconds: float = 90.0) -> None:
    deadline = time.monotonic() + seconds
    while not until() and time.monotonic() < deadline:
        time.sleep(0.05)


def main(arguments: Sequence[str] | None = None) -> int:
    """Execute some runs, and print what came of each."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--runs", type=int, default=len(FAULTS))
    parser.add_argument("--fault", choices=FAULTS, help="this one in every run")
    parser.add_argument("--scenario", default="scenarios/lego/cliff.yaml")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--pace", type=float, default=1.0)
    parser.add_argument(
        "--spread", type=float, default=45.0, help="run's time between faults [s]"
    )
    parser.add_argument("--jobs", type=int, default=1, help="runs at a time")
    options = parser.parse_args(arguments)
    wrong = 0
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(options.jobs, context, max_tasks_per_child=1) as pool:
        faults = (options.fault,) if options.fault else FAULTS
        given = faults, options.scenario, options.seed, options.pace, options.spread
        for found in pool.map(partial(_one, *given), range(options.runs)):
            bad = found["cleared twice"] or found["beyond"] or found["violations"]
            wrong += bool(bad)
            sys.stdout.write(json.dumps(found) + "\n")
            sys.stdout.flush()
    sys.stdout.write(f"{options.runs} runs, {wrong} wrong\n")
    return int(wrong > 0)


def _one(
    faults: Sequence[str],
    scenario: str,
    seed: int,
    pace: float,
    spread_s: float,
    k: int,
) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        fault = faults[k % len(faults)]
        return run(scenario, fault, seed + k, pace, spread_s, Path(folder))


if __name__ == "__main__":
    sys.exit(main())

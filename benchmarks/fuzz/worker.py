"""Commands in a guarded child process: how each ended, how long it took, how much memory it had."""

import contextlib
import io
import multiprocessing
import resource
import time
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection

LIMIT_S = 10.0
MEMORY_MIB = 2048

Command = Sequence[str]
Case = Callable[[int], Sequence[Command]]
"""Writes the mutated files of a case and returns the commands that are to read them."""


@dataclass(frozen=True)
class Ending:
    """What became of one case.

    Attributes:
        case: its number.
        command: the last command that ran.
        code: exit code; -1 where the process hung or died.
        said: the last lines that were printed, or the traceback.
        seconds: processor time that the slowest command took [s].
        memory_mib: largest resident memory of the process so far [MiB].
    """

    case: int
    command: tuple[str, ...]
    code: int
    said: str
    seconds: float
    memory_mib: int

    @property
    def bad(self) -> str:
        """What is wrong with it; empty when it ended as it should."""
        if self.code == -1:
            return self.said
        if self.code not in (0, 1, 2):
            return f"exit code {self.code}"
        if self.memory_mib > MEMORY_MIB:
            return f"{self.memory_mib} MiB"
        return f"{self.seconds:.1f} s" if self.seconds > LIMIT_S else ""


class Worker:
    """A child process that is started anew when a case hangs, dies or has grown it too much."""

    def __init__(self, case: Case) -> None:
        """Run cases that ``case`` prepares."""
        self._case = case
        self._process: multiprocessing.process.BaseProcess | None = None

    def run(self, case: int) -> Ending:
        """Run one case."""
        if self._process is None or not self._process.is_alive():
            self._start()
        self._pipe.send(case)
        # By the clock: other work on the machine may take most of its time.
        patience = LIMIT_S * 12
        if self._pipe.poll(patience):
            try:
                ending: Ending = self._pipe.recv()
            except EOFError:
                self.stop()
                return Ending(case, (), -1, "the process died", 0.0, 0)
            if ending.memory_mib > MEMORY_MIB // 2:
                self.stop()
            return ending
        self.stop()
        return Ending(case, (), -1, f"no end after {patience:g} s", patience, 0)

    def stop(self) -> None:
        """End the child process."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._process = None

    def _start(self) -> None:
        context = multiprocessing.get_context("fork")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(theirs, self._case), daemon=True
        )
        self._process.start()
        theirs.close()


def _serve(pipe: Connection, prepare: Case) -> None:
    resource.setrlimit(resource.RLIMIT_DATA, (6 << 30, 6 << 30))
    while True:
        case = pipe.recv()
        ending = Ending(case, (), 0, "", 0.0, 0)
        for command in prepare(case):
            ending = _run(case, tuple(command), ending.seconds)
            if ending.bad:
                break
        pipe.send(ending)


def _run(case: int, command: tuple[str, ...], slowest: float) -> Ending:
    from twin.cli import app

    said = io.StringIO()
    start = time.process_time()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            code = app(list(command), standalone_mode=False) or 0
    except SystemExit as error:
        code = error.code if isinstance(error.code, int) else 1
    except BaseException:  # every kind of end is what is measured here
        said.write(traceback.format_exc())
        code = 70
    seconds = max(slowest, time.process_time() - start)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    return Ending(case, command, code, said.getvalue()[-4000:], seconds, memory)

"""Commands on a disk that is full: what they say, and what is there afterwards.

    python -m benchmarks.full_disks [--disks N] [--seed S]

In turn ``twin run`` with all recorders, ``twin compare`` and ``twin study``, half of them into a folder with
earlier results. A write fails at a random byte: every other time because a file must not grow beyond a limit,
else because a file system in memory is full (which only root can mount; without it all are limits). A command
that ends with 0 must have written all that it writes undisturbed; one that does not must leave the earlier
results whole, or what can be gone on with when there is room.
"""

from __future__ import annotations

import argparse
import random
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from benchmarks.kills import SCENARIO

# What is the same in every run of a command, byte for byte.
_RUN = (
    "plan.json",
    "plan.npz",
    "events.jsonl",
    "objects.parquet",
    "trajectory.parquet",
)
_STUDY = ("replications.parquet", "tasks.parquet", "edges.parquet")
_WHOLE = {
    "run": (*_RUN, "summary.json", "gantt.png", "run.rrd", "manifest.json"),
    "compare": ("manifest.json", "compare.json", "compare.png"),
    "study": (*_STUDY, "summary.json", "report.html", "manifest.json"),
}
_SAME = {"run": _RUN, "compare": (), "study": _STUDY}

_LIMITED = """
import resource, sys
limit = int(sys.argv.pop(1))
import twin.trial.trial, twin.recorders.motion_tables
from twin.cli import main
if limit >= 0:
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
sys.exit(main())
"""


@dataclass(frozen=True)
class Ending:
    """How a command ended, and what it printed to standard error."""

    code: int
    said: str


def _twin(*arguments: object, limit: int = -1) -> Ending:
    words = [str(a) for a in arguments]
    command = [sys.executable, "-B", "-c", _LIMITED, str(limit), *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return Ending(done.returncode, done.stderr)


def _command(what: str, plan: Path, out: Path, seed: int) -> tuple[object, ...]:
    if what == "compare":
        options: tuple[object, ...] = ("--seeds", seed, "--shortcuts", 0)
    else:
        options = ("--plan", plan, "--seed", seed)
    if what == "study":
        options = (*options, "-n", 2000, "--workers", 0)
    return (what, SCENARIO, *options, "--out", out, "-q")


def _size(folder: Path) -> int:
    return sum(p.stat().st_size for p in folder.rglob("*") if p.is_file())


def _whole(what: str, folder: Path, like: Path) -> bool:
    if not all((folder / name).is_file() for name in _WHOLE[what]):
        return False
    return all(
        (folder / name).read_bytes() == (like / name).read_bytes()
        for name in _SAME[what]
    )


def _hidden(folder: Path) -> list[str]:
    return [p.name for p in folder.iterdir() if p.name.startswith(".")]


@contextmanager
def _small_disk(place: Path, size: int) -> Iterator[bool]:
    """Mount a file system of so many bytes; tells whether that was possible."""
    place.mkdir(exist_ok=True)
    command = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(place)]
    try:
        done = subprocess.run(command, capture_output=True, check=False)
        mounted = done.returncode == 0
    except OSError:
        mounted = False
    try:
        yield mounted
    finally:
        if mounted:
            subprocess.run(["umount", "-l", str(place)], check=True)


class FullDisks:
    """Commands that are given too little room.

    Args:
        place: an empty folder.
    """

    def __init__(self, place: Path) -> None:
        self._place, self._plan = place, place / "plan"
        quick = ("--no-audit", "--no-recording", "-q")
        self._done("run", SCENARIO, "--out", self._plan, *quick)
        for what in _WHOLE:
            for age, seed in (("old", 1), ("new", 2)):
                out = place / f"{what}-{age}"
                self._done(*_command(what, self._plan, out, seed))

    def _done(self, *arguments: object) -> None:
        ending = _twin(*arguments)
        if ending.code != 0:
            raise SystemExit(f"{arguments[0]}: exit code {ending.code}: {ending.said}")

    def filled(self, what: str, *, replacing: bool, mount: bool, share: float) -> str:
        """Run a command with some share of the room that it needs; say what came of it."""
        new, old = self._place / f"{what}-new", self._place / f"{what}-old"
        # A study never goes into a folder with another one.
        replacing = replacing and what != "study"
        kept = _size(old) if replacing else 0
        disk = self._place / "disk"
        room = int(kept + share * 1.3 * _size(new)) + 4096
        with _small_disk(disk, room) if mount else _nothing() as mounted:
            folder = (disk if mounted else self._place) / "filled"
            shutil.rmtree(folder, ignore_errors=True)
            if replacing:
                shutil.copytree(old, folder)
            largest = max(p.stat().st_size for p in new.rglob("*") if p.is_file())
            limit = -1 if mounted else int(share * 1.1 * largest)
            ending = _twin(*_command(what, self._plan, folder, 2), limit=limit)
            if mounted:  # now there is room
                options = f"remount,size={1 << 30}"
                subprocess.run(["mount", "-o", options, str(disk)], check=True)
            return self._judged(what, ending, folder, old if replacing else None, new)

    def _judged(
        self, what: str, ending: Ending, folder: Path, old: Path | None, new: Path
    ) -> str:
        if ending.code not in (0, 1, 2) or "Traceback" in ending.said:
            return f"EXIT CODE {ending.code}: {ending.said[-300:]}"
        if ending.code == 0:
            return "whole" if _whole(what, folder, new) else "EXIT CODE 0, NOT WHOLE"
        if not ending.said.strip():
            return "NOTHING WAS SAID"
        if old is not None:
            if _hidden(folder):
                return f"LEFT OVER: {_hidden(folder)}"
            return "old results" if _whole(what, folder, old) else "LOST"
        if not (folder / "manifest.json").is_file() or what == "compare":
            return "nothing was there"
        if what == "run" and not (folder / "plan.json").is_file():
            return "no plan yet"
        again = ("resume", folder) if what == "run" else (what, "--resume", folder)
        resumed = _twin(*again, "-q")
        if resumed.code != 0:
            return f"NOT RESUMED: {resumed.said[-300:]}"
        return "gone on with" if _whole(what, folder, new) else "RESUMED, NOT WHOLE"


@contextmanager
def _nothing() -> Iterator[bool]:
    yield False


def main(arguments: list[str] | None = None) -> int:
    """Fill disks, look, and print what was found; 1 when anything was lost."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.full_disks")
    parser.add_argument("--disks", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    rng = random.Random(options.seed)
    found: Counter[tuple[str, str]] = Counter()
    with tempfile.TemporaryDirectory() as name:
        disks = FullDisks(Path(name))
        for k in range(options.disks):
            what = list(_WHOLE)[k % 3]
            outcome = disks.filled(
                what, replacing=k // 3 % 2 == 1, mount=k % 2 == 0, share=rng.random()
            )
            found[what, outcome] += 1
    for (what, outcome), count in sorted(found.items()):
        sys.stdout.write(f"{what}: {count} times {outcome}\n")
    return 1 if any(outcome[:4].isupper() for _, outcome in found) else 0


if __name__ == "__main__":
    sys.exit(main())

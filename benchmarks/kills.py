"""Commands killed at random moments: what they leave, and what comes of going on.

    python -m benchmarks.kills [--kills N] [--seed S]

A third each of: ``twin run`` into a folder with results of an earlier run, after which either the old or the
new results must be there whole; ``twin compare`` into such a folder, the same; ``twin study``, which is gone on
with until it is done, and must come to what a study that was never killed comes to. SIGKILL comes at a random
moment of what the command takes undisturbed.
"""

from __future__ import annotations

import argparse
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from twin.run.folder import locked, recover

SCENARIO = "scenarios/multi_arm/multi_goal.yaml"
_QUICK = ("--no-audit", "--no-recording", "-q")
_STUDY = ("-n", "3000", "--workers", "0", "--audit-sample", "0", "-q")
_COMPARED = ("plan.npz", "events.jsonl", "objects.parquet", "trajectory.parquet")
_TABLES = ("replications.parquet", "tasks.parquet", "edges.parquet")


def _twin(*arguments: object) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "twin.cli", *(str(a) for a in arguments)]
    return subprocess.Popen(command, stderr=subprocess.DEVNULL)


def _done(*arguments: object) -> float:
    """Run a command to its end; return how long it took [s]."""
    start = time.monotonic()
    code = _twin(*arguments).wait()
    if code != 0:
        raise SystemExit(f"{arguments[0]}: exit code {code}")
    return time.monotonic() - start


def _contents(folder: Path, names: tuple[str, ...]) -> tuple[bytes, ...]:
    return tuple(
        (folder / name).read_bytes() for name in names if (folder / name).exists()
    )


class Replaced:
    """Results that a command replaces: the old or the new must be there whole."""

    def __init__(
        self,
        place: Path,
        command: Callable[[Path, int], tuple[object, ...]],
        names: tuple[str, ...],
    ) -> None:
        """Make old and new results once, undisturbed."""
        self._place, self._command, self._names = place, command, names
        self._old, self._new = place / "old", place / "new"
        _done(*command(self._old, 1))
        self._takes_s = _done(*command(self._new, 2))

    def killed(self, rng: random.Random) -> str:
        """Kill the command once; return what is there afterwards."""
        folder = self._place / "killed"
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(self._old, folder)
        process = _twin(*self._command(folder, 2))
        time.sleep(rng.uniform(0.0, 1.1 * self._takes_s))
        process.send_signal(signal.SIGKILL)
        process.wait()
        with locked(folder):
            recover(folder)
        left = [p.name for p in folder.iterdir() if p.name.startswith(".")]
        there = _contents(folder, self._names)
        if left:
            return f"LEFT OVER {left}"
        if there == _contents(self._old, self._names):
            return "old results"
        return "new results" if there == _contents(self._new, self._names) else "LOST"


class GoneOn:
    """A study that is killed and gone on with until it is done."""

    def __init__(self, place: Path) -> None:
        """Make the study once, undisturbed."""
        self._place, self._whole = place, place / "whole"
        self._takes_s = _done("study", SCENARIO, *_STUDY, "--out", self._whole)

    def killed(self, rng: random.Random) -> str:
        """Kill the study, go on with it, and compare."""
        folder = self._place / "killed"
        shutil.rmtree(folder, ignore_errors=True)
        process = _twin("study", SCENARIO, *_STUDY, "--out", folder)
        time.sleep(rng.uniform(0.0, 1.1 * self._takes_s))
        process.send_signal(signal.SIGKILL)
        process.wait()
        if not (folder / "manifest.json").exists():
            return "not begun"
        _done("study", "--resume", folder, "--workers", "0", "-q")
        same = _contents(folder, _TABLES) == _contents(self._whole, _TABLES)
        return "gone on with" if same else "DIFFERENT"


def main(arguments: list[str] | None = None) -> int:
    """Kill, look, and print what was found; 1 when anything was lost."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.kills")
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    rng = random.Random(options.seed)
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        plan = place / "plan"
        _done("run", SCENARIO, "--out", plan, *_QUICK)

        def run(out: Path, seed: int) -> tuple[object, ...]:
            return (
                "run",
                SCENARIO,
                "--plan",
                plan,
                "--seed",
                seed,
                "--stalls",
                2,
                "--out",
                out,
                *_QUICK,
            )

        def compare(out: Path, seed: int) -> tuple[object, ...]:
            return (
                "compare",
                SCENARIO,
                "--seeds",
                seed,
                "--shortcuts",
                0,
                "--out",
                out,
                "-q",
            )

        cases = {
            "run": Replaced(place / "run", run, _COMPARED),
            "compare": Replaced(place / "compare", compare, ("manifest.json",)),
            "study": GoneOn(place / "study"),
        }
        found: Counter[tuple[str, str]] = Counter()
        for k in range(options.kills):
            what = list(cases)[k % len(cases)]
            found[what, cases[what].killed(rng)] += 1
    for (what, outcome), count in sorted(found.items()):
        sys.stdout.write(f"{what}: {count} times {outcome}\n")
    return (
        1 if any(outcome.isupper() or "LEFT" in outcome for _, outcome in found) else 0
    )


if __name__ == "__main__":
    sys.exit(main())

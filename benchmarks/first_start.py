"""Cost of a first run, which compiles and caches kernels, against runs that find them there.

    python -m benchmarks.first_start [SCENARIO] [--warm N] [--json FILE]

Runs a scenario (the cliff by default) as ``twin run`` does, once with an empty kernel cache in a folder
that is thrown away afterwards, then with what that left. Prints processor seconds of the whole process,
seconds by the wall clock, the largest resident memory, and how many kernels were compiled; warm runs are
given by their median. The difference of the processor seconds is what compiling costs. Nothing that runs
beside it changes processor seconds much; wall times need a quiet machine.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median

from benchmarks.machine import date_line, machine_line

CLIFF = Path("scenarios/lego/cliff.yaml")

_PROGRAM = """
import atexit, json, resource, sys, time
start, kernels = time.perf_counter(), []

def report():
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    figures = {
        "cpu_s": sum(u.ru_utime + u.ru_stime for u in used),
        "wall_s": time.perf_counter() - start,
        "memory_mib": used[0].ru_maxrss // 1024,
        "kernels": len(kernels),
    }
    print(json.dumps(figures))

atexit.register(report)
from planning.kernels import watch_compilation
from twin.cli import main
with watch_compilation(lambda: kernels.append(None), lambda: None):
    main()
"""


@dataclass(frozen=True)
class Start:
    """One run of the program.

    Attributes:
        cpu_s: processor seconds of all its threads and children.
        wall_s: from its first line to the last [s].
        memory_mib: largest resident memory [MiB].
        kernels: how many it compiled.
    """

    cpu_s: float
    wall_s: float
    memory_mib: int
    kernels: int


def measure_starts(scenario: Path, warm: int) -> tuple[Start, list[Start]]:
    """Return a run with an empty kernel cache, and runs with what it left there."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        runs = [_run(scenario, place, k) for k in range(1 + warm)]
    return runs[0], runs[1:]


def _run(scenario: Path, place: Path, number: int) -> Start:
    out = place / f"run-{number}"
    done = subprocess.run(
        [sys.executable, "-c", _PROGRAM, "run", scenario, "--quiet", "--out", out],
        env={**os.environ, "NUMBA_CACHE_DIR": str(place / "cache")},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return Start(**json.loads(done.stdout.splitlines()[-1]))


def main() -> int:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenario", type=Path, nargs="?", default=CLIFF)
    parser.add_argument("--warm", type=int, default=3, help="how many warm runs")
    parser.add_argument("--json", type=Path, help="file to write the figures to")
    options = parser.parse_args()
    cold, warm = measure_starts(options.scenario, options.warm)
    usual = Start(
        median(run.cpu_s for run in warm),
        median(run.wall_s for run in warm),
        max(run.memory_mib for run in warm),
        max(run.kernels for run in warm),
    )
    sys.stdout.write(_table(options.scenario.stem, cold, usual))
    if options.json is not None:
        figures = {
            "scenario": options.scenario.stem,
            "date": date_line(),
            "machine": machine_line(),
            "cold": asdict(cold),
            "warm": [asdict(run) for run in warm],
            "compiling_cpu_s": cold.cpu_s - usual.cpu_s,
        }
        options.json.write_text(json.dumps(figures, indent=1) + "\n")
    return 0


def _table(name: str, cold: Start, warm: Start) -> str:
    lines = [
        f"First start: {name}; {date_line()}, {machine_line()}",
        "",
        "| | processor [s] | wall [s] | memory [MiB] | kernels compiled |",
        "|---|---:|---:|---:|---:|",
    ]
    for words, run in (("cold", cold), ("warm", warm)):
        lines.append(
            f"| {words} | {run.cpu_s:.1f} | {run.wall_s:.1f} | {run.memory_mib} "
            f"| {run.kernels} |"
        )
    lines += ["", f"Compiling: {cold.cpu_s - warm.cpu_s:.1f} processor seconds.", ""]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())

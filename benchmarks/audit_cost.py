"""What the audit costs, and what it finds, in every scenario that comes with the program.

    python -m benchmarks.audit_cost --runs DIR [--before CHECKOUT] [names...]

Scenarios whose run is not in DIR yet are planned and run there first; that takes half an hour. Every
run is audited in a process of its own, which has imported and compiled everything before, and
counts its processor time, user and system. With ``--before`` the audit of another checkout, such as
``git worktree add /tmp/before 947b7e8``, measures the same runs.
Writes benchmarks/results/audit.md.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

from benchmarks.machine import date_line, load_line, machine_line

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results" / "audit.md"

# Runs in both checkouts, so it names nothing that only one of them has.
_CHILD = """
import json, resource, sys
from pathlib import Path
from twin.audit.audit import audit_run

folder, told = Path(sys.argv[1]), {}
try:
    from twin.audit import wanted
    from twin.planning.kind import assembly_kind
    from twin.scenario.manifest import read_manifest
    scenario = read_manifest(folder, "run")[0]
    told["wanted"] = assembly_kind(scenario.assembly).wanted(scenario.cell)
except ImportError:
    pass
def seconds():
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime
best = None
for _ in range(3):
    start = seconds()
    report = audit_run(folder, **told)
    took = seconds() - start
    best = took if best is None else min(best, took)
    if took > 20.0:
        break
print(json.dumps({
    "cpu_s": best,
    "configurations": report.configurations,
    "least_m": report.min_distance_m,
    "bound_m": getattr(report, "min_distance_bound_m", None),
    "violations": len(report.violations),
}))
"""


def measure(checkout: Path, folder: Path) -> dict[str, Any]:
    """Return what the audit of a checkout says of a run, and its processor seconds."""
    done = subprocess.run(
        [sys.executable, "-c", _CHILD, str(folder)],
        cwd=checkout,
        env={**os.environ, "PYTHONPATH": str(checkout)},
        capture_output=True,
        text=True,
        check=True,
    )
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def run_once(scenario: Path, folder: Path) -> None:
    """Plan and run a scenario, unless that was done before."""
    if (folder / "summary.json").exists():
        return
    command = [sys.executable, "-m", "twin.cli", "run", str(scenario)]
    options = ["--out", str(folder), "--no-audit", "--no-recording", "-q"]
    subprocess.run([*command, *options], cwd=ROOT, check=True)


def row(name: str, now: dict[str, Any], before: dict[str, Any] | None) -> str:
    """Return a line of the table."""
    millimetres = [
        "-" if m is None or m > 1e6 else f"{1e3 * m:.3f}"
        for m in (now["least_m"], now["bound_m"])
    ]
    cells = [
        name,
        str(now["configurations"]),
        "" if before is None else f"{before['cpu_s']:.2f}",
        f"{now['cpu_s']:.2f}",
        *millimetres,
        str(now["violations"]),
    ]
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Measure, print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "names", nargs="*", help="stems of scenario files; default: all"
    )
    parser.add_argument("--runs", type=Path, required=True)
    parser.add_argument("--before", type=Path)
    arguments = parser.parse_args()
    runs: Path = arguments.runs.resolve()
    scenarios = sorted((ROOT / "scenarios").glob("*/*.yaml"), key=lambda p: p.stem)
    rows, loads = [], []
    for scenario in scenarios:
        name = scenario.stem
        if arguments.names and name not in arguments.names:
            continue
        run_once(scenario, runs / name)
        load = os.getloadavg()[0]
        before = None
        if arguments.before is not None:
            before = measure(arguments.before.resolve(), runs / name)
        now = measure(ROOT, runs / name)
        loads.append((load, os.getloadavg()[0]))
        rows.append(row(name, now, before))
        sys.stdout.write(f"{rows[-1]}\n")
        sys.stdout.flush()
    head = [
        "# What the audit costs and finds",
        "",
        f"{date_line()}, {machine_line()}, {load_line(loads)}. Processor time of one process,"
        " user and system, the best of up to three audits after everything is imported and"
        " compiled. *Before*: the audit of commit 947b7e8, which looked at samples alone and"
        " checked contacts, jumps, joint limits, joint speeds and the order of edges; so some"
        " of its least distances were too large. *Now* every moment is accounted for, and what"
        " hangs, grips, places and supports are checked too.",
        "",
        "    python -m benchmarks.audit_cost --runs DIR --before CHECKOUT",
        "",
        "| scenario | configurations | CPU before [s] | CPU now [s] | least distance of robots"
        " [mm] | at no moment nearer than [mm] | violations |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    RESULTS.write_text("\n".join([*head, *rows, ""]), encoding="utf-8")


if __name__ == "__main__":
    main()

"""Mutated scenarios, plans, logs, blocks, robot descriptions, tables, tasks and brick models.

    python -m benchmarks.fuzz [TARGET ...] [--cases N] [--first K] [--seed S] [--json FILE] [--show]

Every case is a file with random damage that commands then read, in a child process. A case is bad when
a command ends with another code than 0, 1 or 2 (70 is the last resort for what nobody foresaw), takes more
than 10 s of processor time, has not ended after two minutes, or brings its process above 2 GB. A case is named by target, seed and number, so it can be
repeated alone: ``python -m benchmarks.fuzz plans --first 812 --cases 1 --show``.
"""

import argparse
import json
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

from rich.progress import Progress

from benchmarks.fuzz.targets import TARGETS
from benchmarks.fuzz.worker import Worker
from benchmarks.machine import date_line, machine_line


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def fuzz(
    name: str, *, cases: int, first: int = 0, seed: int = 0, show: bool = False
) -> dict[str, Any]:
    """Run some cases of a target; return what became of them."""
    target, _ = TARGETS[name]
    codes: Counter[int] = Counter()
    bad: list[dict[str, Any]] = []
    slowest, memory = 0.0, 0
    with tempfile.TemporaryDirectory() as place, Progress(disable=show) as progress:
        worker = Worker(target(Path(place), seed))
        bar = progress.add_task(name, total=cases)
        for case in range(first, first + cases):
            ending = worker.run(case)
            codes[ending.code] += 1
            slowest, memory = (
                max(slowest, ending.seconds),
                max(memory, ending.memory_mib),
            )
            if show:
                _say(f"{case}: {' '.join(ending.command)}\n{ending.said}")
            if ending.bad:
                last = (ending.said.strip().splitlines() or [""])[-1]
                bad.append(
                    {
                        "case": case,
                        "why": ending.bad,
                        "command": ending.command[:1],
                        "said": last[:300],
                    }
                )
            progress.update(bar, advance=1, description=f"{name} ({len(bad)} bad)")
        worker.stop()
    ends = {str(code): count for code, count in sorted(codes.items())}
    return {"target": name, "seed": seed, "first": first, "cases": cases, "exit_codes": ends,
            "slowest_s": round(slowest, 2), "memory_mib": memory, "bad": bad}  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    """Run the targets and print a line each; 1 when a case was bad."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fuzz")
    parser.add_argument(
        "target", nargs="*", help=f"of {', '.join(TARGETS)}; default: all"
    )
    parser.add_argument(
        "--cases", type=int, help="of each target; default: those of a full run"
    )
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, help="file for the figures")
    parser.add_argument(
        "--show", action="store_true", help="print what every command says"
    )
    options = parser.parse_args(arguments)
    names = options.target or list(TARGETS)
    for name in names:
        if name not in TARGETS:
            parser.error(f"no target {name!r} (valid: {', '.join(TARGETS)})")
    found = []
    for name in names:
        cases = TARGETS[name][1] if options.cases is None else options.cases
        result = fuzz(
            name, cases=cases, first=options.first, seed=options.seed, show=options.show
        )
        found.append(result)
        _say(f"{name}: {cases} cases, exit codes {result['exit_codes']}, slowest {result['slowest_s']} s,"
              f" {result['memory_mib']} MiB, {len(result['bad'])} bad")  # fmt: skip
        for one in result["bad"][:20]:
            _say(f"  {one['case']}: {one['why']}: {one['said']}")
    if options.json is not None:
        about = {"machine": machine_line(), "date": date_line(), "results": found}
        options.json.write_text(json.dumps(about, indent=1) + "\n")
    return 1 if any(result["bad"] for result in found) else 0


if __name__ == "__main__":
    sys.exit(main())

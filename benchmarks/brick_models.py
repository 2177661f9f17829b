"""Brick models of others, from file to audited run: sequenced, refused or not decided, and built.

Each model is imported into the cell that the program chooses, sequenced as it is and with temporary
bricks, planned, executed and audited, then executed again from the same plan with random stalls.

    python -m benchmarks.brick_models FOLDER --results benchmarks/results
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks.machine import date_line, machine_line

_PATTERNS = {"*.txt": "bricks", "*.ldr": "ldraw", "*.mpd": "ldraw"}
_STALLS = 5


def main() -> None:
    """Read the command line, try the models, write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="folder with the models")
    parser.add_argument("--only", nargs="*", default=[], help="names of models")
    parser.add_argument("--stalled", type=int, default=3, help="stalled runs of each")
    parser.add_argument("--results", type=Path, help="folder for the table")
    args = parser.parse_args()
    rows = []
    for file, reader in _models(args.folder, args.only):
        with tempfile.TemporaryDirectory() as scratch:
            rows.append(_try(file, reader, Path(scratch), args.stalled))
        sys.stdout.write(_line(rows[-1]) + "\n")
        if args.results is not None:
            _write(args.results, rows)


def _models(folder: Path, only: list[str]) -> Iterator[tuple[Path, str]]:
    for pattern, reader in _PATTERNS.items():
        for file in sorted(folder.glob(pattern)):
            if not only or file.stem in only:
                yield file, reader


def _try(file: Path, reader: str, scratch: Path, stalled: int) -> dict[str, Any]:
    scenario, run = scratch / "model.yaml", scratch / "run"
    row: dict[str, Any] = {"model": file.stem}
    code, text, _ = _twin("import", reader, str(file), "-o", str(scenario))
    if code:
        return {**row, "as it is": text}
    plain = scratch / "plain.yaml"
    plain.write_text(
        scenario.read_text(encoding="utf-8").replace(
            "scaffold: true", "scaffold: false"
        ),
        encoding="utf-8",
    )
    code, text, row["as_it_is_cpu_s"] = _twin("sequence", str(plain))
    row["as it is"] = "sequenced" if code == 0 else _reason(text)
    code, text, row["sequence_cpu_s"] = _twin("sequence", str(scenario), "--json")
    if code:
        return {**row, "with scaffolding": _reason(text)}
    steps = json.loads(text)
    row["bricks"] = sum(not step.get("temporary") for step in steps)
    row["temporary"] = len(steps) - row["bricks"]
    row["held"] = sum("support" in step for step in steps)
    code, text, row["run_cpu_s"] = _twin("run", str(scenario), "--out", str(run), "-q")
    if not (run / "summary.json").exists():
        return {**row, "outcome": _reason(text)}
    summary = json.loads((run / "summary.json").read_text(encoding="utf-8"))
    row["outcome"] = summary["outcome"]
    row["makespan_s"] = summary["makespan_s"]
    row["violations"] = len(summary["audit"]["violations"])
    row["stalled"] = 0
    for seed in range(1, stalled + 1):
        out = scratch / f"stalled{seed}"
        code, _, _ = _twin(
            "run",
            str(scenario),
            *("--plan", str(run), "--stalls", str(_STALLS), "--seed", str(seed)),
            *("--out", str(out), "-q", "--no-recording"),
        )
        row["stalled"] += code == 0
    row["stalled_of"] = stalled
    return row


def _twin(*arguments: str) -> tuple[int, str, float]:
    """Run a command; return its exit code, what it printed, and its processor time [s]."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(
        [sys.executable, "-m", "twin.cli", *arguments],
        capture_output=True,
        text=True,
        check=False,
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    text = done.stdout if done.returncode == 0 else done.stderr
    return done.returncode, text, round(spent, 1)


def _reason(text: str) -> str:
    """Return the verdict of a refusal: its first line, without the path of the file."""
    lines = [line for line in text.splitlines() if line.strip()]
    first = lines[0].split(".yaml: ", 1)[-1] if lines else "no message"
    count = sum(line.startswith("  '") for line in lines)
    if first.startswith("not decided"):
        return "not decided"
    if first.startswith("no order of assembly exists"):
        return f"refused: {count} brick{'s' * (count > 1)} named"
    return first


def _line(row: dict[str, Any]) -> str:
    def text(key: str) -> str:
        return str(row.get(key, "-"))

    built = text("outcome")
    if "makespan_s" in row:
        built += f", {row['violations']} violations"
        built += f"; stalled {row['stalled']} of {row['stalled_of']} clean"
    cells = [
        row["model"],
        text("bricks"),
        f"{text('as it is')} ({text('as_it_is_cpu_s')} s)",
        f"{text('temporary')} temporary, {text('held')} held ({text('sequence_cpu_s')} s)"
        if "bricks" in row
        else text("with scaffolding"),
        f"{built} ({text('run_cpu_s')} s)",
        f"{row['makespan_s']:.1f}" if "makespan_s" in row else "-",
    ]
    return "| " + " | ".join(cells) + " |"


def _write(folder: Path, rows: list[dict[str, Any]]) -> None:
    machine = f"{machine_line()}; {date_line()}"
    document = {"machine": machine, "rows": rows}
    (folder / "brick-models.json").write_text(json.dumps(document, indent=1) + "\n")
    head = (
        "| model | bricks | as it is (CPU s) | with scaffolding (CPU s) | run and audit (CPU s) | "
        "makespan s |\n|---|---|---|---|---|---|"
    )
    words = (
        "# Brick models of others\n\nEach model in the chosen cell: sequenced as it is, and with "
        f"temporary bricks; built by a run, audited; then with {_STALLS} random stalls a robot "
        f"from the same plan. Processor seconds of whole commands.\n\n{machine}\n\n{head}\n"
    )
    table = "\n".join(map(_line, rows))
    (folder / "brick-models.md").write_text(f"{words}{table}\n", encoding="utf-8")


if __name__ == "__main__":
    main()

"""Fingerprints of what the program makes of the shipped scenarios, to hold a change to.

    python -m benchmarks.house [--only cliff tower] [--write FILE] [--against benchmarks/results/house.json]

Plans and executes scenarios (all that are shipped by default, three of them with the audit, two with a
study) and prints a hash of each result: arrays of the plan, events, tables, summaries, the schema. What
depends on the day or the clock is left out, and decimals behind the ninth, in which processors differ. With ``--against`` every difference from an earlier
``--write`` is named, and the exit code is 1 where there is one.
"""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Iterator
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq

import twin
from twin.scenario.schema import scenario_schema

SCENARIOS = Path(__file__).parents[1] / "scenarios"
AUDITED = ("cliff", "gearbox", "tower")
STUDIED = ("cliff", "taskboard")
TIMED = frozenset(
    {"planning_s", "wall_s", "cpu_s", "versions", "folder", "files", "plan"}
)
"""Keys of summaries whose values are of the day or of the clock."""


def digest(content: bytes) -> str:
    """Return the first digits of a hash."""
    return sha256(content).hexdigest()[:16]


def fingerprints(file: Path, folder: Path) -> dict[str, str]:
    """Plan and execute a scenario and return the hash of each of its results."""
    name = file.stem
    done = twin.run(
        twin.load(file), out=folder / name, recording=False, audit=name in AUDITED
    )
    found = dict(_of_run(folder / name))
    if name in STUDIED:
        twin.study(done.plan, replications=50, audited=3, out=folder / f"{name}-study")
        found["study"] = _of_json(folder / f"{name}-study" / "summary.json")
        table = folder / f"{name}-study" / "replications.parquet"
        found["replications"] = _of_table(table)
    return found


def _of_run(folder: Path) -> Iterator[tuple[str, str]]:
    with np.load(folder / "plan.npz", allow_pickle=False) as arrays:
        parts = [
            f"{key} {arrays[key].dtype} {arrays[key].shape}".encode()
            + np.ascontiguousarray(_rounded(arrays[key])).tobytes()
            for key in sorted(arrays.files)
        ]
    yield "plan", digest(b"".join(parts))
    yield "events", digest((folder / "events.jsonl").read_bytes())
    for table in ("trajectory", "objects"):
        yield table, _of_table(folder / f"{table}.parquet")
    yield "summary", _of_json(folder / "summary.json")


def _rounded(array: Any) -> Any:
    # Adding nothing makes -0.0 a 0.0.
    return np.round(array, 9) + 0.0 if array.dtype.kind == "f" else array


def _of_table(file: Path) -> str:
    table = pq.read_table(file)
    rows = {n: _without_times(table[n].to_pylist()) for n in table.column_names}
    return digest(json.dumps(rows).encode())


def _of_json(file: Path) -> str:
    content = _without_times(json.loads(file.read_text(encoding="utf-8")))
    return digest(json.dumps(content, sort_keys=True).encode())


def _without_times(content: Any) -> Any:
    if isinstance(content, dict):
        return {k: _without_times(v) for k, v in content.items() if k not in TIMED}
    if isinstance(content, list):
        return [_without_times(value) for value in content]
    if isinstance(content, float):
        return round(content, 9) + 0.0
    return content


def schema_fingerprint() -> str:
    """Return the hash of what ``twin schema`` prints."""
    return digest(json.dumps(scenario_schema(), indent=2).encode())


def main() -> int:
    """Print, write or compare fingerprints."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", metavar="NAME", help="scenarios")
    parser.add_argument("--write", type=Path, help="file for the fingerprints")
    parser.add_argument("--against", type=Path, help="file of earlier fingerprints")
    options = parser.parse_args()
    files = sorted(SCENARIOS.glob("*/*.yaml"), key=lambda file: file.stem)
    if options.only:
        files = [file for file in files if file.stem in options.only]
    found: dict[str, dict[str, str]] = {"schema": {"schema": schema_fingerprint()}}
    known = json.loads(options.against.read_text()) if options.against else {}
    changed = 0
    with tempfile.TemporaryDirectory() as place:
        for name, file in [("schema", None), *((f.stem, f) for f in files)]:
            begin = time.process_time()
            if file is not None:
                found[name] = fingerprints(file, Path(place))
            before = known.get(name, {})
            wrong = sorted(
                key
                for key in before.keys() | found[name].keys()
                if options.against and before.get(key) != found[name].get(key)
            )
            changed += len(wrong)
            words = f"CHANGED: {', '.join(wrong)}" if wrong else "same"
            took = time.process_time() - begin
            text = words if options.against else json.dumps(found[name])
            sys.stdout.write(f"{name} ({took:.1f} CPU s): {text}\n")
            sys.stdout.flush()
    if options.write:
        options.write.write_text(json.dumps(found, indent=1) + "\n")
    return 1 if changed else 0


if __name__ == "__main__":
    sys.exit(main())

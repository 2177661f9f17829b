"""Runs of a small cell in which nothing moves for a while, with all that is made of a run; told: what that took.

    python -m tests.twin.long_standstill FOLDER SECONDS

A program of its own, whose peak of memory is that of nothing else.
"""

import json
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import yaml

import twin
from tests.peak_memory import peak_kb
from tests.twin.program import invoke
from twin.registry import EXPORTS
from twin.trial.run_plan import run_plan_to_folder

CELL: dict[str, Any] = yaml.safe_load("""\
version: 1
name: standstill
seed: 1
cell:
  robots:
    - {name: arm, model: panda, base: {xyz_m: [-0.5, 0, 0]}}
    - {name: other, model: panda, base: {xyz_m: [0.7, 0, 0], rpy_deg: [0, 0, 180]}}
  fixtures:
    - {name: table, size_m: [1.8, 1.3, 0.04], pose: {xyz_m: [0, 0, -0.02]}}
    - name: vise
      size_m: [0.1, 0.1, 0.04]
      pose: {xyz_m: [0, 0.2, 0.02]}
      frames: {nest: {xyz_m: [0, 0, 0.02]}}
assembly:
  kind: assembly
  machines: {mill: {}}
  processes:
    milling: {duration: {kind: fixed, value_s: 5}, machine: mill}
    probing: {duration: {kind: fixed, value_s: 4}}
  parts:
    - name: blank
      size_m: [0.03, 0.03, 0.03]
      start: {xyz_m: [-0.3, -0.25, 0.015]}
      goal: {xyz_m: [0.3, -0.25, 0.015]}
      frames: {top: {xyz_m: [0, 0, 0.015]}}
  steps:
    - {place: blank, at: {fixture: vise, frame: nest, pose: {xyz_m: [0, 0, 0.015]}}, robots: [arm]}
    - {process: milling, at: {part: blank}, name: milled}
    - {process: probing, at: {part: blank, frame: top}, after: [milled], name: probed, robots: [arm]}
    - {place: blank, robots: [other], after: [probed]}
  grips: {opening_m: 0.04, positions: 1}
planning: {speed_rad_s: 1.0, shortcut_candidates: 0}
""")


def standing(seconds: float) -> dict[str, dict[str, Any]]:
    """Return what makes a cell stand for some time, by what it is."""
    repaired = {"mttr_s": seconds, "clock": "busy"}
    return {
        "emergency stop": {
            # One while it moves, one while it probes.
            "emergency_stops": [
                {"robot": "other", "at_s": 2.3, "duration_s": seconds},
                {"robot": "arm", "at_s": 30.0, "duration_s": seconds},
            ]
        },
        "breakdown": {"breakdowns": {"mtbf_s": 8, **repaired}},
        "machine": {"machines": {"mill": {"breakdowns": {"mtbf_s": 1, **repaired}}}},
    }


def told(folder: Path, kind: str, seconds: float, plan: Any) -> dict[str, Any]:
    """Run, follow and export; return how much of everything there is."""
    case = plan.scenario.varied(standing(seconds)[kind])
    folder.mkdir(parents=True)
    run = run_plan_to_folder(replace(plan, scenario=case), folder)
    done = invoke("follow", str(folder), str(folder / "events.jsonl"), "--once")
    formats = [
        word
        for name in EXPORTS.names()
        for word in ("--format", name)
        if name != "ldraw"
    ]
    exported = invoke("export", str(folder), *formats)
    assert exported.exit_code == 0, exported.output
    sizes = {}
    for path in sorted((folder / "exports").rglob("*")):
        sizes[path.name] = path.stat().st_size
    return {
        "outcome": run.outcome,
        "makespan_s": run.summary["makespan_s"],
        "violations": len(run.summary["audit"]["violations"]),
        "configurations": run.summary["audit"]["configurations"],
        "rows": pq.read_metadata(folder / "trajectory.parquet").num_rows,
        "events": len((folder / "events.jsonl").read_text().splitlines()),
        "recording": (folder / "run.rrd").stat().st_size,
        "followed": len(done.output.splitlines()),
        "exit": done.exit_code,
        **sizes,
    }


def main() -> None:
    """Run all kinds of standstills of some length."""
    folder, seconds = Path(sys.argv[1]), float(sys.argv[2])
    folder.mkdir(parents=True)
    (folder / "cell.yaml").write_text(yaml.safe_dump(CELL))
    plan = twin.plan(folder / "cell.yaml")
    begin = time.process_time()
    counts = {}
    for kind in standing(1.0):
        counts[kind] = told(folder / kind.replace(" ", "-"), kind, seconds, plan)
        counts[kind]["peak_kb"] = peak_kb()
    seconds_taken = time.process_time() - begin
    sys.stdout.write(json.dumps({"cpu_s": seconds_taken, "counts": counts}))


if __name__ == "__main__":
    main()

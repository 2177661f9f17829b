"""What sidesteps are worth: makespans with and without, of plans in turns and in slots.

    python -m benchmarks.sidesteps scenarios/lego/cliff.yaml FILE ... [--seeds 2]

Each scenario is planned with skills that follow their reference paths; its plan one task after
another and its plan in slots are shortened without sidesteps and with them. Writes
benchmarks/results/sidesteps.md; what was measured is kept in benchmarks/.measured/.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from hashlib import sha256
from pathlib import Path

import numpy as np

from benchmarks.machine import date_line, load_line, machine_line
from benchmarks.store import Row, RowStore
from scheduling.graph.dispatcher import earliest_times
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.comparison.comparison import plan_to_compare, shortcut_budget
from twin.host.progress import StageWatch
from twin.run.policies import SHORTENED, SLOTS_SHORTENED
from twin.scenario.manifest import load_scenario
from twin.scenario.sections.scenario import follow_references
from twin.trial.planning import CoordinatedPlans

ROOT = Path(__file__).parents[1]
PLANS = {"turns": SHORTENED, "slots": SLOTS_SHORTENED}


def main() -> int:
    """Measure what is not in the store, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenarios", nargs="+", type=Path, help="scenario files")
    parser.add_argument("--seeds", type=int, default=2, metavar="N")
    options = parser.parse_args()
    store = RowStore(ROOT / "benchmarks" / ".measured" / "sidesteps", ROOT)
    measured = {}
    for file in options.scenarios:
        own = sha256(file.read_bytes()).hexdigest()[:8]
        rows = []
        for seed in range(options.seeds):
            key = f"{file.stem}-{own}-{seed}"
            row = store.load(key) or store.save(key, measure(file, seed))
            sys.stderr.write(f"{key}: {row['ends_s']}\n")
            rows.append(row)
        measured[f"{file.parent.name}/{file.stem}"] = rows
    target = ROOT / "benchmarks" / "results" / "sidesteps.md"
    target.write_text("\n".join(table(measured, options.seeds)) + "\n", "utf-8")
    return 0


def measure(file: Path, seed: int) -> Row:
    """Return makespans and processor seconds of shortcuts, without sidesteps and with them."""
    before = os.getloadavg()[0]
    scenario = follow_references(load_scenario(file)).model_copy(update={"seed": seed})
    turns = plan_to_compare(scenario, file.parent, StageWatch())
    most = shortcut_budget(scenario)
    ends: dict[str, list[float]] = {}
    spent: dict[str, list[float]] = {}
    for name, plan in PLANS.items():
        for sidesteps in (0, most):
            update = {"sidestep_candidates": sidesteps}
            planning = scenario.planning.model_copy(update=update)
            plans = CoordinatedPlans(
                turns,
                scenario.model_copy(update={"planning": planning}),
                lambda: StageWatch(clock=time.process_time),
                candidates=most,
            )
            ends.setdefault(name, []).append(makespan(plans[plan]))
            spent.setdefault(name, []).append(plans.seconds(plan)["shortcut"])
    loads = (before, os.getloadavg()[0])
    return {"ends_s": ends, "shortcut_s": spent, "load": loads}


def makespan(tpg: TemporalPlanGraph) -> float:
    """Return when a plan ends at nominal durations [s]."""
    return float(earliest_times(tpg).makespan)


def table(measured: dict[str, list[Row]], seeds: int) -> list[str]:
    """Return the report, as lines of Markdown."""
    rows = [row for own in measured.values() for row in own]
    commits = ", ".join(sorted({row["commit"] for row in rows}))
    loads = load_line([tuple(row["load"]) for row in rows])
    out = [
        "# Sidesteps",
        "",
        f"{date_line()}, {machine_line()}, commit {commits}; {loads}. Made by"
        f" `python -m benchmarks.sidesteps FILE ... --seeds {seeds}`.",
        "",
        "Makespans at nominal durations, skills on their reference paths, means over the seeds; seconds are of the",
        "processor, of shortcuts and of both. At most as many sidesteps as shortcuts, and they end when they stop paying.",
        "Folders of other names than those of `scenarios` hold tasks as published. Default: no sidesteps but for `goals`.",
        "",
        "A plan in turns can end later than one in slots for two reasons, and each has a remedy that comes with",
        "sidesteps. Where the makespan hangs on a wait, a shortcut helps only if it is shorter; a sidestep need not be. And",
        "the order of tasks that is best by way of HOME may be worse past it; so the planned order is shortened, too.",
        "",
        "| scenario | plan | shortcuts [s] | and sidesteps [s] | sooner | least | most | shortcuts [CPU s] | both [CPU s] |",
        "|---|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for name, own in measured.items():
        for plan in PLANS:
            ends = np.array([row["ends_s"][plan] for row in own])
            spent = np.mean([row["shortcut_s"][plan] for row in own], axis=0)
            saved = 100 * (1 - ends[:, 1] / ends[:, 0])
            head = f"{name}, {len(own)} seed{'s' * (len(own) > 1)}"
            out.append(
                f"| {head if plan == 'turns' else ''} | {plan} | {ends[:, 0].mean():.2f} "
                f"| {ends[:, 1].mean():.2f} | **{saved.mean():.2f} %** | {saved.min():.2f} % "
                f"| {saved.max():.2f} % | {spent[0]:.1f} | {spent[1]:.1f} |"
            )
    return out


if __name__ == "__main__":
    sys.exit(main())

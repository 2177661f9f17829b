"""Plans of four published tasks beside the figures that VAMP-MR publishes for them.

    python -m benchmarks.peers [--data ROOT] [--seeds N] [--only TASK ...] [--curve S ...] [--before FILE]

ROOT is a copy of what the authors of APEX-MR publish (docs/guides/apex-mr.md), by default where
ASSEMBLY_TWIN_APEX_DATA says. Skills take as long as their reference paths, and the joints of a robot
together travel 1 rad/s, as there. Each task is planned with a limited time for shortcuts
(``planning.shortcut_s``), with which planning takes about as long as VAMP-MR's total, and with none
(0.0, the default: as long as they pay). Times are of the processor, with kernels compiled and loaded.
Every plan is executed and audited (``--no-audit``). Writes peers.md and peers.json to
benchmarks/results, with ``--only`` to logs/peers. ``--curve`` plans with further times for shortcuts
and draws makespans over processor seconds, peers.png; ``--before`` adds the curves of another
peers.json. What was measured is kept, so that an interrupted run continues.
"""

import argparse
import gc
import json
import os
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from benchmarks.apex_mr import import_published
from benchmarks.machine import date_line, forget_answers, load_line, machine_line
from benchmarks.store import Row, RowStore
from scheduling.graph.plan_files import save_plan
from twin.audits.run_auditor import audit_execution
from twin.host.atomic_files import save_png, write_json
from twin.reading.scenario_file import load_scenario
from twin.recorders.run_tables import write_motion
from twin.scenario.sections.scenario import Scenario
from twin.studies.compare import follow_references
from twin.trial.planning import plan_scenario
from twin.trial.simulation import execute

ROOT = Path(__file__).parents[1]
DATA = os.environ.get("ASSEMBLY_TWIN_APEX_DATA", ROOT.parent / "shared/data/apex-mr")


class Peer(NamedTuple):
    """Size, planning time and makespan of a task [s] (project page, Table 2), and our time for shortcuts [s]."""

    bricks: int
    total_s: float
    makespan_s: float
    shortcut_s: float


PEERS = {
    "cliff": Peer(11, 3.39, 159.0, 1.0),
    "vessel": Peer(36, 8.38, 340.0, 1.0),
    "rss": Peer(47, 31.2, 542.0, 5.0),
    "big_chair": Peer(258, 59.3, 2146.0, 5.0),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and write the files; 1 if an audit found a violation."""
    options = _options(arguments)
    kept = ROOT / "benchmarks" / ".measured" / "peers"
    store, rows, warm = RowStore(kept, ROOT), list[Row](), False
    for task in options.only:
        file = import_published(options.data, task, store)
        scenario = follow_references(load_scenario(file))
        own = sha256(file.read_bytes()).hexdigest()[:8]
        times = dict.fromkeys((PEERS[task].shortcut_s, 0.0, *options.curve))
        for shortcut_s in times:
            for seed in range(scenario.seed, scenario.seed + options.seeds):
                key = f"{task}-{own}-{shortcut_s:g}-{seed}-{options.audit}"
                row = store.load(key)
                if row is None:
                    if not warm:  # the first plan loads all kernels
                        warm = bool(measure(scenario, seed, 0.1, audit=False))
                    found = measure(scenario, seed, shortcut_s, audit=options.audit)
                    row = store.save(key, {"task": task, **found})
                rows.append(row)
                sys.stderr.write(f"{key}: {row['makespan_s']:.1f} s\n")
    options.out.mkdir(parents=True, exist_ok=True)
    write_json(options.out / "peers.json", {"machine": machine_line(), "rows": rows})
    report = table(rows)
    if options.curve:
        text = options.before.read_text() if options.before else '{"rows": []}'
        draw_curves(options.out / "peers.png", rows, json.loads(text)["rows"])
        report += ["", "![Makespan over processor seconds of planning](peers.png)"]
    (options.out / "peers.md").write_text("\n".join(report) + "\n", encoding="utf-8")
    return 1 if any(row["violations"] for row in rows) else 0


def measure(scenario: Scenario, seed: int, shortcut_s: float, *, audit: bool) -> Row:
    """Plan and execute a scenario once, with a seed and a time for shortcuts [s]."""
    section = scenario.planning.model_copy(update={"shortcut_s": shortcut_s})
    scenario = scenario.model_copy(update={"seed": seed, "planning": section})
    gc.collect()
    forget_answers()
    load, begin = os.getloadavg()[0], time.process_time()
    plan = plan_scenario(scenario, clock=time.process_time)
    cpu_s = time.process_time() - begin
    run, violations = execute(scenario, plan.tpg, Path()), None
    if audit:
        with tempfile.TemporaryDirectory() as folder:
            save_plan(plan.tpg, Path(folder))
            write_motion(Path(folder), plan.tpg, run)
            asked = scenario, Path(folder)
            found = audit_execution(*asked, ordered=True, finished=True)
        violations = [str(violation) for violation in found.violations]
    return {
        "shortcut_s": shortcut_s,
        "seed": seed,
        "cpu_s": cpu_s,
        "makespan_s": run.makespan_s,
        "violations": violations,
        "load": (load, os.getloadavg()[0]),
    }


def table(rows: Sequence[Row]) -> list[str]:
    """Return the report, as lines of Markdown."""
    commits = ", ".join(sorted({row["commit"] for row in rows}))
    seeds = ", ".join(map(str, sorted({row["seed"] for row in rows})))
    lines = [
        f"""# Beside VAMP-MR

{date_line()}, {machine_line()}, commit {commits}; {load_line([row["load"] for row in rows])}; seeds {seeds}.
Made by `python -m benchmarks.peers`, which says what is measured. Published figures are means of 4 seeds,
totals by the clock on another machine, with tools that are 12.4 mm longer. Ours are mean ± sample standard
deviation, in processor seconds of the whole planning.

| task | bricks | VAMP-MR: total [s] | makespan [s] | ours, limited: CPU [s] | makespan [s] | of VAMP-MR's | ours,\
 default: CPU [s] | makespan [s] | of VAMP-MR's | violations |
|---|{"---:|" * 10}"""
    ]
    for task in dict.fromkeys(row["task"] for row in rows):
        peer, found = PEERS[task], list[list[str] | None]()
        cells = [task, f"{peer.bricks}", f"{peer.total_s:g}", f"{peer.makespan_s:g}"]
        for shortcut_s in (peer.shortcut_s, 0.0):
            own = _rows_of(rows, task, shortcut_s)
            spans = [row["makespan_s"] for row in own]
            cells += [_spread([row["cpu_s"] for row in own]), _spread(spans)]
            cells.append(f"{np.mean(spans) / peer.makespan_s:.0%}")
            found += [row["violations"] for row in own]
        audited = [len(one) for one in found if one is not None]
        cells.append(str(sum(audited)) if audited else "not audited")
        lines.append(f"| {' | '.join(cells)} |")
    return lines


def _rows_of(rows: Iterable[Row], task: str, shortcut_s: float) -> list[Row]:
    return [r for r in rows if (r["task"], r["shortcut_s"]) == (task, shortcut_s)]


def _spread(values: Sequence[float]) -> str:
    spread = f" ± {np.std(values, ddof=1):.1f}" if len(values) > 1 else ""
    return f"{np.mean(values):.1f}{spread}"


def draw_curves(path: Path, rows: Sequence[Row], before: Sequence[Row]) -> None:
    """Draw makespans over processor seconds, means over seeds, a panel for each task."""
    tasks = list(dict.fromkeys(row["task"] for row in rows))
    figure = Figure(figsize=(4.0 * len(tasks), 3.4), layout="constrained")
    for k, task in enumerate(tasks):
        axes = figure.add_subplot(1, len(tasks), k + 1)
        for label, some in (("before", before), ("now", rows)):
            times = {row["shortcut_s"] for row in some if row["task"] == task}
            means = [
                np.mean([(r["cpu_s"], r["makespan_s"]) for r in own], axis=0).tolist()
                for own in (_rows_of(some, task, shortcut_s) for shortcut_s in times)
            ]
            axes.plot(*np.array(sorted(means)).reshape(-1, 2).T, "o-", label=label)
        axes.plot(*PEERS[task][1:3], "k*", label="VAMP-MR, by the clock")
        axes.set(title=task, xlabel="planning [CPU s]", ylabel="makespan [s]")
        axes.set_xscale("log")
        axes.legend()
    save_png(figure, path)


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.peers", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--data", type=Path, metavar="ROOT", default=DATA)
    parser.add_argument("--only", nargs="+", choices=PEERS, default=())
    parser.add_argument("--seeds", type=int, default=4, metavar="N")
    parser.add_argument("--audit", action=argparse.BooleanOptionalAction, default=True)
    parser.add_argument("--curve", nargs="+", type=float, metavar="S", default=())
    parser.add_argument("--before", type=Path, metavar="FILE")
    given = parser.parse_args(arguments)
    folder = "logs/peers" if given.only else "benchmarks/results"
    given.out = ROOT / folder
    given.only = [task for task in PEERS if not given.only or task in given.only]
    return given


if __name__ == "__main__":
    sys.exit(main())

"""What it costs that skills fail: planned anew while the others go on, or after everybody has stopped.

    python -m benchmarks.operate [--seeds N] [--rates 0 0.05 out] [--only NAME] [--verified N] [--table]

Every attempt at any skill fails with a probability, and a fifth of those lose the object; attempts are made
three times. Compared are, for the same draws: *ours*; *stop*: everybody ends the task at hand, waits for the
plan, and goes HOME before going on, whatever it had been cleared for; *knew*: a plan from the beginning on without the objects that were to be
lost, executed with attempts that fail and never for good. ``cliff with spares`` is the shipped cliff with
twelve more bricks, ``magazine with spares`` the shipped one with six more pins; of the products of
``machine tending`` each that is lost is one less, and a tower of which a beam is lost has no top. A construction
that stops does not bring its steps to an end first. With the rate ``out`` attempts fail as at 1 %, and one robot,
drawn as the time is, stops for good; a plan that knew of that is not looked for. Every run is audited, and the first
of each row are verified, and once more with five stalls of each robot. The table goes to benchmarks/results/operate.md;
rows that are measured are kept. With ``--table`` it is that of all rows there are, whatever version measured them.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.machine import date_line, machine_line
from benchmarks.store import RowStore
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.plan_files import save_plan
from scheduling.graph.rollout import earliest_times
from scheduling.invariant import check_invariant
from scheduling.verification.verify import verify_plan
from twin.audits.run_auditor import audit_execution
from twin.durations.nanoseconds import NANOSECONDS
from twin.operations.operation import Operation, operate
from twin.operations.replicated.hindsight import Hindsight
from twin.recorders.run_tables import write_motion
from twin.trial.loaded_scenario import LoadedScenario, load
from twin.trial.plan_result import PlanResult
from twin.trial.planning import plan_scenario, with_failures
from twin.trial.simulation import scenario_execution

ROOT = Path(__file__).parents[1]
CASES = (
    *("cliff with spares", "lego/cliff", "lego/faucet", "lego/vessel", "lego/chair"),
    *("magazine with spares", "assembly/gearbox", "assembly/taskboard"),
    *("assembly/truss", "machine tending, 8 products", "assembly/kitting"),
    *("construction/tower", "construction/wall"),
)
OUT = "out"
RATES: tuple[float | str, ...] = (0.0, 0.01, 0.05, 0.1, 0.2, OUT)
_SPARE = (
    ("2x6", (14, 42)),
    ("2x6", (32, 42)),
    ("2x2", (14, 36)),
    ("2x2", (32, 36)),
    *(("2x4", at) for at in ((2, 6), (6, 6), (2, 12), (6, 12))),
    *(("2x4", at) for at in ((44, 6), (40, 6), (44, 12), (40, 12))),
)

_MORE_PINS = (
    ("[0.56, 0.16, 0.02]", "[0.56, 0.24, 0.02]"),
    ("count: 12", "count: 18"),
    (
        "[-0.225, -0.34, 0.05], grid: {counts: [6, 2]",
        "[-0.225, -0.38, 0.05], grid: {counts: [6, 3]",
    ),
)

Row = dict[str, Any]

_IN_FILES = str.maketrans("/, ", "---")


def scenario_of(name: str, folder: Path) -> LoadedScenario:
    """Return a case; what is made of a shipped one is written into a folder."""
    if name.startswith("machine tending"):
        case = load(ROOT / "scenarios" / "assembly" / "machine_tending.yaml")
        return case.varied({"assembly.products.count": 8})
    if name.startswith("magazine"):
        text = (ROOT / "scenarios" / "assembly" / "magazine.yaml").read_text("utf-8")
        for old, new in _MORE_PINS:
            text = text.replace(old, new, 1)
        file = folder / "magazine.yaml"
        file.write_text(text, "utf-8")
        return load(file)
    if name != "cliff with spares":
        return load(ROOT / "scenarios" / f"{name}.yaml")
    text = (ROOT / "scenarios" / "lego" / "cliff.yaml").read_text(encoding="utf-8")
    more = "".join(
        f"    - {{name: spare_{k}, brick: {brick}, at: [{x}, {y}, 1]}}\n"
        for k, (brick, (x, y)) in enumerate(_SPARE)
    )
    file = folder / "spares.yaml"
    file.write_text(text.replace("  steps:\n", f"{more}\n  steps:\n", 1), "utf-8")
    return load(file)


def measure(plan: PlanResult, rate: float | str, seed: int, *, verified: bool) -> Row:
    """Operate once in each way with the same draws."""
    case = with_failures(plan.scenario, plan.tpg, 0.01 if rate == OUT else float(rate))
    changed: dict[str, Any] = {}
    if rate == OUT:
        draw, names = np.random.default_rng(seed), plan.motions.motion_plan.cell.robots
        at_s = draw.uniform(0.0, 0.8) * earliest_times(plan.tpg).makespan
        robot = names[int(draw.integers(len(names)))].name
        changed["outages"] = [{"robot": robot, "at_s": round(float(at_s), 3)}]
    case = case.varied(changed) if changed else case
    sections, model = (
        case.sections,
        scenario_execution(case.sections, case.folder),
    )
    begin = time.process_time()
    ours = operate(sections, plan.motions, plan.tpg, model, seed=seed)
    row: Row = {"cpu_s": time.process_time() - begin, "ours": _told(ours)}
    # Nodes of which all wait for what they must, whichever version they are of.
    check_invariant(DerivedTpg(ours.tpg))
    row["in_order"] = _in_order(ours)
    row["audit"] = audited(ours, case)
    if verified:
        stalls = {"count_per_robot": 5, "duration_s": [1.0, 20.0]}
        slow = case.varied({"stalls": stalls})
        late = scenario_execution(slow.sections, slow.folder)
        stalled = operate(slow.sections, plan.motions, plan.tpg, late, seed=seed)
        row["audit"] += audited(stalled, slow)
        row["problems"] = sum(
            len(verify_plan(done.tpg).problems) for done in (ours, stalled)
        )
    if ours.versions:
        stop = operate(sections, plan.motions, plan.tpg, model, seed=seed, halting=True)
        row["stop"] = _told(stop)
    else:
        row["stop"] = row["ours"]
    knew = Hindsight(sections, plan.motions, plan.tpg, model).makespan_ns(ours)
    row["knew_s"] = None if knew is None else knew / NANOSECONDS
    return row


def audited(done: Operation, case: LoadedScenario) -> list[str]:
    """Return what the audit finds in what was executed, in words."""
    with tempfile.TemporaryDirectory() as scratch:
        save_plan(done.tpg, Path(scratch))
        write_motion(Path(scratch), done.tpg, done.record)
        about = case.sections, Path(scratch)
        found = audit_execution(*about, ordered=True, finished=done.finished)
    return [str(violation) for violation in found.violations]


def _told(done: Operation) -> Row:
    return {
        "makespan_s": done.record.makespan_s,
        "completed": done.record.outcome == "completed",
        "versions": len(done.versions),
        "planning_s": list(done.planning_s),
        "given_up": {str(k): v for k, v in done.given_up.items()},
    }


def _in_order(done: Operation) -> bool:
    start, end = done.record.start_ns, done.record.end_ns
    executed = all((own >= 0).all() for own in (*start, *end))
    return executed and all(
        end[k][u] <= start[i][v] for k, u, i, v in done.tpg.edges.tolist()
    )


def table(rows: dict[tuple[str, float | str], list[Row]], seeds: int) -> list[str]:
    """Return the report, as lines of Markdown."""
    commits = ", ".join(sorted({row["commit"] for own in rows.values() for row in own}))
    out = [
        "# When skills fail",
        "",
        f"{date_line()}, {machine_line()}, commit {commits}. Made by `python -m benchmarks.operate --seeds"
        f" {seeds}`; what is compared, and with which draws, is said there. Of failures for good, per run;"
        " makespans are means over the runs that all three complete; planning is in processor seconds from"
        " a failure to the plan that takes over, with other work on the machine. Each try at a skill of a step has"
        " the same luck in all three. In the cliff each layer waits for the one below, so that nobody has anything to"
        " do meanwhile, and ours takes as long as stop. Gearbox, taskboard and truss have no spare parts; a product of"
        " machine tending whose blank is lost is scrapped, and a tower that has lost a beam is one level lower."
        " With *out* makespans are means over the runs in which ours and stop leave the same steps undone. *Wrong*"
        " are runs that do not keep their order, in which the audit finds anything, or which verify does not prove.",
        "",
        "| case | rate | completed | failures for good | ours [s] | stop [s] | knew [s] | planning, median |"
        " planning, p95 | wrong |",
        "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for (name, rate), own in rows.items():
        if not own:
            continue
        whole = [
            row
            for row in own
            if (row["knew_s"] is not None or rate == OUT)
            and row["ours"]["given_up"].keys() == row["stop"]["given_up"].keys()
            and (row["ours"]["completed"] or rate == OUT)
        ]
        seconds = [s for row in own for s in row["ours"]["planning_s"]]
        wrong = sum(
            not row["in_order"] or bool(row.get("problems")) or bool(row["audit"])
            for row in own
        )
        cells = [
            name,
            rate if isinstance(rate, str) else f"{100 * rate:g} %",
            f"{sum(row['ours']['completed'] for row in own)} of {len(own)}",
            f"{np.mean([row['ours']['versions'] for row in own]):.2f}",
            *(
                f"{np.mean(values):.1f}" if values else "-"
                for values in (
                    [row["ours"]["makespan_s"] for row in whole],
                    [row["stop"]["makespan_s"] for row in whole],
                    [row["knew_s"] for row in whole if row["knew_s"] is not None],
                )
            ),
            f"{np.median(seconds):.2f}" if seconds else "-",
            f"{np.percentile(seconds, 95):.2f}" if seconds else "-",
            str(wrong),
        ]
        out.append(f"| {' | '.join(cells)} |")
    return out


def _rate(text: str) -> float | str:
    return OUT if text == OUT else float(text)


def main() -> int:
    """Measure what is not in the store, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20, metavar="N")
    parser.add_argument("--rates", type=_rate, nargs="+", default=RATES)
    parser.add_argument("--only", nargs="+", choices=CASES, default=CASES)
    parser.add_argument("--verified", type=int, default=2, metavar="N")
    parser.add_argument("--table", action="store_true")
    options = parser.parse_args()
    kept = ROOT / "benchmarks" / ".measured" / "operate"
    store = RowStore(kept, ROOT, any_version=options.table)
    measured: dict[tuple[str, float | str], list[Row]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name in options.only:
            case = scenario_of(name, Path(folder))
            text = "\n".join(case.document.lines).encode()
            plan: PlanResult | None = None
            for rate in options.rates:
                rows = measured.setdefault((name, rate), [])
                for seed in range(options.seeds):
                    key = f"{name.translate(_IN_FILES)}-{sha256(text).hexdigest()[:8]}-{rate}-{seed}"
                    row = store.load(key)
                    if row is None and options.table:
                        continue
                    if row is None:
                        plan = plan or plan_scenario(case, keep=True)
                        sure = seed < options.verified
                        row = store.save(key, measure(plan, rate, seed, verified=sure))
                    sys.stderr.write(f"{key}: {row['ours']['makespan_s']:.1f} s\n")
                    rows.append(row)
    target = ROOT / "benchmarks" / "results" / "operate.md"
    target.write_text("\n".join(table(measured, options.seeds)) + "\n", "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())

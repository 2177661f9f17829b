"""Key figures of a run: the content of ``summary.json``, and the table printed in the terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from planning.errors import escape_control_characters
from planning.tasks.task import TaskKind
from scheduling.graph.actuations import actuation_nodes
from scheduling.graph.rollout import earliest_times
from scheduling.graph.task_edges import dependency_edges
from scheduling.graph.temporal_plan_graph import TASK_DEPENDENCY, TemporalPlanGraph
from scheduling.slowed_motions import slowed_motions
from twin.durations.nanoseconds import NANOSECONDS
from twin.registry import HOOKS
from twin.runs.execution_record import ExecutionRecord
from twin.runs.header import RunHeader
from twin.runs.policies import ASYNCHRONOUS, SEQUENTIAL, policy_name
from twin.runs.tracking import tracking_errors
from twin.runs.windows import window_rows, window_summary

_NO_AUDIT = {"key": "--no-audit", "check": "Whether what was executed is audited."}

_UNKNOWN = RunHeader()
"""Header of a run whose planning is unknown."""

_MOST_VIOLATIONS = 10
"""Largest number of violations that are printed."""

_MILLIMETRES = {"contact": "deep", "jump": "far"}
"""Word after the length of a violation, by kind; for other kinds no length is printed."""

_STAGES = {
    "sequence": "which brick when",
    "assignment": "who does what",
    "motion": "motions",
    "assignment_search": "shorter assignment",
    "synchronous": "who moves at once",
    "tpg": "what waits for what",
    "shortcut": "shortcuts",
    "products": "all products",
}


def summarize_run(
    tpg: TemporalPlanGraph,
    run: ExecutionRecord,
    scenario: str,
    header: RunHeader = _UNKNOWN,
    audit: Mapping[str, Any] | None = None,
    due_s: Sequence[float] = (),
    start_up: int | None = None,
) -> dict[str, Any]:
    """Return the figures of a run, with the keys of ``summary.json``.

    Args:
        tpg: the executed plan.
        run: its execution.
        scenario: name of the scenario.
        header: header of the run. If it has no makespan of sequential execution, that is computed
            from the same nodes with the same durations, one robot at a time.
        audit: findings of the audit, None if there was none.
        due_s: when each product is due, where there are several [s].
        start_up: products at the beginning that do not count for throughput and takt.
    """
    robots = [k for k in range(len(tpg.chains)) if k not in tpg.machine_chains()]
    completed = run.outcome == "completed"
    sequential_s = header.makespan_sequential_s if completed else None
    if sequential_s is None:
        busy = [run.duration_ns[k].sum() + run.stood_ns[k].sum() for k in robots]
        sequential_s = int(sum(busy)) / NANOSECONDS

    idle = tpg.idle_robots()

    def seconds(of: Callable[[int], int]) -> dict[str, float]:
        return {tpg.chains[k].robot: of(k) / NANOSECONDS for k in robots}

    further: dict[str, Any] = {
        "fits": list(header.fits),
        "idle": {name: header.idle.get(name, {"reason": "unknown"}) for name in idle},
        "actuations": _actuations(tpg, run),
        "machines": _machines(tpg, run),
        "slowed": slowed_motions(tpg),
        "tracking": {
            name: own._asdict()
            for name, own in tracking_errors(tpg, run.measured).items()
        },
        "windows": window_summary(tpg, run),
        "assignment_search": header.assignment_search,
    }
    if "line" in HOOKS:
        further["line"] = HOOKS.load("line")(tpg, run, due_s, start_up)
    return {
        "scenario": scenario,
        "seed": run.seed,
        "policy": policy_name(header.plan, run.policy),
        "plan": header.plan,
        "outcome": run.outcome,
        "makespan_s": run.makespan_s,
        "makespan_sequential_s": sequential_s,
        "lower_bound_s": lower_bound_s(tpg, run),
        "wait_s": seconds(run.wait_ns) | dict.fromkeys(idle, run.makespan_s),
        "stall_s": seconds(run.standing_ns),
        "stopped_s": seconds(lambda k: run.stopped_ns(k, run.makespan_ns)),
        "failure": run.failure or None,
        "raised_skills": run.raised_skills,
        "nodes": sum(len(chain) for chain in tpg.chains),
        "type2_edges": len(tpg.edges),
        "planning_s": dict(header.planning_s),
        "audit": None if audit is None else dict(audit),
        "warnings": list(header.warnings),
        "checks_off": [*header.checks_off, *([] if header.audit else [_NO_AUDIT])],
        **{key: value for key, value in further.items() if value},
        "makespan_asynchronous_s": header.makespan_asynchronous_s
        if completed
        else None,
        "makespan_bound_s": header.makespan_bound_s,
    }


def _actuations(tpg: TemporalPlanGraph, run: ExecutionRecord) -> dict[str, Any]:
    """Return the counts and durations of tool actuations, by action.

    An actuation without a time of its own is counted in ``within_skills``: its skill includes the time.
    """
    found: dict[str, dict[str, float]] = {}
    for k, nodes in enumerate(actuation_nodes(tpg)):
        for node, item in nodes.items():
            if run.end_ns[k][node] < 0:
                continue
            lasts = int(run.duration_ns[k][node])
            own = found.setdefault(item.act, {"times": 0, "within_skills": 0, "s": 0.0})
            own["times" if lasts else "within_skills"] += 1
            own["s"] += lasts / NANOSECONDS
    return found


def _machines(
    tpg: TemporalPlanGraph, run: ExecutionRecord
) -> dict[str, dict[str, float]]:
    """Return the busy time and downtime of each processing machine, without changeovers [s]."""
    found = {}
    changes = np.array([task.kind == TaskKind.CHANGEOVER for task in tpg.tasks])
    for k in tpg.working_machines():
        done = (run.end_ns[k] >= 0) & ~changes[tpg.chains[k].task]
        busy = int((run.end_ns[k] - run.start_ns[k])[done].sum())
        down = busy - int(run.duration_ns[k][done].sum())
        found[tpg.chains[k].robot] = {
            "busy_s": busy / NANOSECONDS,
            "down_s": down / NANOSECONDS,
            "utilisation": busy / max(run.makespan_ns, 1),
        }
    return found


def lower_bound_s(tpg: TemporalPlanGraph, run: ExecutionRecord) -> float:
    """Return a lower bound of the makespan over all coordinations of these paths [s].

    It is the longest path through the robots' chains and the task dependencies, without conflicts
    between robots.
    """
    edges = dependency_edges(tpg)
    cause = np.full(len(edges), TASK_DEPENDENCY, dtype=np.uint8)
    free = replace(tpg, edges=edges, cause=cause)
    busy = [d + s for d, s in zip(run.duration_ns, run.stood_ns, strict=True)]
    ends = [e[-1] for e in earliest_times(free, busy).end if len(e)]
    return float(np.max(ends, initial=0)) / NANOSECONDS


def print_summary(
    summary: Mapping[str, Any], folder: Path, *, recording: bool, compiled: bool = False
) -> None:
    """Print the summary of a run to standard output.

    Args:
        summary: the content of ``summary.json``.
        folder: folder of the run.
        recording: whether there is a recording to replay.
        compiled: whether kernels were compiled in the planning stages.
    """
    console = Console(highlight=False, markup=False, emoji=False)
    table = Table(
        show_header=False, title=f"{summary['scenario']}", title_justify="left"
    )
    table.add_column(style="bold")
    table.add_column(justify="right")
    table.add_column(style="dim")

    def show_line(what: str, style: str, words: str) -> None:
        text = Text(f"{escape_control_characters(what)}: ").append(
            escape_control_characters(words)
        )
        text.stylize(style, 0, len(what))
        console.print(text, soft_wrap=True)

    for row in summary_rows(summary, compiled=compiled):
        table.add_row(*map(escape_control_characters, row))
    console.print(table)
    audit = summary["audit"]
    for entry in (audit or {}).get("violations", [])[:_MOST_VIOLATIONS]:
        millimetres = _MILLIMETRES.get(entry["kind"])
        length = (
            f"{1000 * entry['depth_m']:.2f} mm {millimetres}, " if millimetres else ""
        )
        what = f"{entry['kind']}: {entry['first']} - {entry['second']}"
        words = (
            f"from {entry['t_start']:.3f} s to {entry['t_end']:.3f} s {entry['detail']}"
        )
        show_line(what, "red", length + words)
    for fit in summary.get("fits", ()):
        show_line(f"step {fit['step']}", "", fit["words"])
    for own in summary.get("checks_off", ()):
        show_line("check off", "yellow", f"{own['key']}: {own['check']}")
    for warning in summary.get("warnings", ()):
        show_line("warning", "yellow", warning)
    if summary.get("failure"):
        show_line("failed", "red", summary["failure"])
    console.print(f"results: {folder}", soft_wrap=True)
    if recording:
        console.print(f"replay:  twin replay {folder}", soft_wrap=True)


def _operation_rows(
    operation: Mapping[str, Any] | None,
) -> list[tuple[str, str, str]]:
    """Return table rows on replanning and abandoned steps."""
    if operation is None:
        return []
    versions = operation["versions"]
    causes = "; ".join(version["cause"] for version in versions[:3])
    more = f"; {len(versions) - 3} more" if len(versions) > 3 else ""
    rows = [("replanned", f"{len(versions)} times", causes + more)]
    if window := operation.get("window"):
        size = f"{window['steps']} steps"
        when = f"the next ones when {window['least']} or fewer are not begun"
        rows.append(("planned at a time", size, f"{when}; execution.window"))
    if scrapped := operation.get("scrapped"):
        which = ", ".join(map(str, scrapped[:10])) + (", ..." if scrapped[10:] else "")
        rows.append(("products scrapped", str(len(scrapped)), which))
    for key, words in (("given_up", "given up"), ("dropped", "dropped")):
        undone = list(operation.get(key, {}).items())
        rows += [(f"step {step}", words, why) for step, why in undone[:5]]
        if (left := len(undone) - 5) > 0:
            rows.append(("further steps", str(left), words))
    return rows


def summary_rows(
    summary: Mapping[str, Any], *, compiled: bool = False
) -> list[tuple[str, str, str]]:
    """Return the table's rows: name, value, remark."""
    rows = [("outcome", str(summary["outcome"]), f"seed {summary['seed']}")]
    makespan = float(summary["makespan_s"])
    if summary["outcome"] == "completed":
        rows += _makespan_rows(summary, makespan)
    else:
        rows.append(("ended after", f"{makespan:.2f} s", ""))
    rows += _line_rows(summary.get("line"))
    for robot, seconds in summary["wait_s"].items():
        share = f"{100 * seconds / makespan:.1f} % of the time" if makespan > 0 else ""
        rows.append((f"wait of {robot}", f"{seconds:.2f} s", share))
    for name, own in summary.get("machines", {}).items():
        down = f", down for {own['down_s']:.2f} s" if own["down_s"] else ""
        share = f"{100 * own['utilisation']:.1f} % of the time{down}"
        rows.append((f"{name} with a part", f"{own['busy_s']:.2f} s", share))
    for act, own in summary.get("actuations", {}).items():
        within = f"{own['within_skills']} more in the times of whole skills"
        rows.append(
            (
                f"tools {act}",
                f"{own['s']:.2f} s",
                f"{own['times']} times"
                + (f", {within}" if own["within_skills"] else ""),
            )
        )
    rows += window_rows(summary.get("windows", ()))
    rows += _slowed_rows(summary.get("slowed", {}))
    rows += [
        (
            f"{robot} off its path",
            f"{1000 * own['joint']:.2f} mrad or mm",
            f"at most, by a joint; its tool by {1000 * own['tool_m']:.2f} mm",
        )
        for robot, own in summary.get("tracking", {}).items()
    ]
    if summary.get("raised_skills"):
        rows.append(
            ("raised skills", str(summary["raised_skills"]), "to their joints' limits")
        )
    rows += _operation_rows(summary.get("operation"))
    rows.append(("nodes", str(summary["nodes"]), ""))
    rows.append(("type-2 edges", str(summary["type2_edges"]), ""))
    for stage, seconds in summary["planning_s"].items():
        label = f"planning: {_STAGES.get(stage, stage)}"
        remark = "with compiling" if compiled else ""
        rows.append((label, f"{seconds:.2f} s", remark))
    rows.append(_audit_row(summary["audit"]))
    if warnings := summary.get("warnings"):
        rows.append(("warnings", str(len(warnings)), "below"))
    return rows


def _slowed_rows(found: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    rows = []
    for robot, own in found.items():
        for cause, by in own["by"].items():
            moves, slower = (
                counts["stretches"] + counts["skills"] for counts in (own, by)
            )
            rows.append(
                (
                    f"{robot} slowed by {cause}",
                    f"{100 * slower / max(moves, 1):.0f} % of motions",
                    f"most in task {by['task']} ({by['label']}): {by['longest']:.2f} times as long",
                )
            )
    return rows


def _line_rows(line: Mapping[str, Any] | None) -> list[tuple[str, str, str]]:
    if line is None:
        return []
    rows = [("products", str(line["products"]), "")]
    if line["takt_s"] is not None:
        rate, takt = line["throughput_per_h"], line["takt_s"]
        after = f"after the first {line['start_up']}" if line["start_up"] else ""
        rows.append(("throughput", f"{rate:.1f} an hour", after))
        between = f"{takt['least']:.2f} to {takt['greatest']:.2f} s"
        rows.append(("takt", f"{takt['mean']:.2f} s", between))
        wip = f"{line['work_in_progress']:.2f}"
        rows.append(("work in progress", wip, "products begun and not complete"))
    cycle = line["cycle_time_s"]
    most = f"at most {cycle['greatest']:.2f} s"
    rows.append(("cycle time of a product", f"{cycle['mean']:.2f} s", most))
    if due := line["due"]:
        worst = f"lateness at most {due['greatest_lateness_s']:+.2f} s"
        rows.append(("late products", str(due["late"]), worst))
    return rows


def _makespan_rows(
    summary: Mapping[str, Any], makespan: float
) -> list[tuple[str, str, str]]:
    sequential = float(summary["makespan_sequential_s"])
    rows = [
        (f"makespan, {SEQUENTIAL}", f"{sequential:.2f} s", "one robot works at a time")
    ]
    plain = {SEQUENTIAL: sequential}
    together = summary.get("makespan_asynchronous_s")
    if together is not None:
        plain[ASYNCHRONOUS] = float(together)
        label = f"makespan, {ASYNCHRONOUS}"
        rows.append((label, f"{together:.2f} s", "the same motions, no shortcuts"))
    if summary["policy"] not in plain:
        label = f"makespan, {summary['policy']}"
        best = sorted(plain, key=lambda name: plain[name])
        below = ", ".join(_compared(makespan, plain[name], name) for name in best)
        rows.append((label, f"{makespan:.2f} s", below))
    bound = float(summary["lower_bound_s"])
    rows.append(("lower bound of these paths", f"{bound:.2f} s", ""))
    least = summary.get("makespan_bound_s")
    if least:
        shorter = 100 * max(0.0, 1 - least / makespan)
        words = f"at most {shorter:.1f} % shorter plans exist with these grips"
        rows.append(("lower bound, any choice", f"{least:.2f} s", words))
    if search := summary.get("assignment_search"):
        rows.append(_search_row(search))
    return rows


def _search_row(search: Mapping[str, Any]) -> tuple[str, str, str]:
    compared = _compared(
        search["predicted_s"], search["predicted_start_s"], "integer program"
    )
    verdict = "taken" if search["taken"] else "not taken"
    if search["rated_s"] is not None and search["rated_start_s"] is not None:
        rated = _compared(search["rated_s"], search["rated_start_s"], "it")
        verdict = f"with motions {rated}: {verdict}"
    predicted = f"{search['predicted_s']:.2f} s"
    return ("predicted, searched assignment", predicted, f"{compared}; {verdict}")


def _compared(makespan: float, other: float, name: str) -> str:
    share = 100 * (1 - makespan / other) if other > 0 else 0.0
    return f"{abs(share):.1f} % {'below' if share >= 0 else 'above'} {name}"


def _audit_row(audit: Mapping[str, Any] | None) -> tuple[str, str, str]:
    if audit is None:
        return ("audit", "none", "")
    count = len(audit["violations"])
    least = audit["min_distance_m"]
    remark = f"{audit['configurations']} configurations"
    if least is not None:
        remark += f", robots and loads at least {1000 * least:.1f} mm apart"
    if engine := audit.get("engine"):
        remark += f", measured with {engine}"
    if helpers := audit.get("helpers"):
        remark += f", {len(helpers)} temporary objects stay"
    kinds = Counter(entry["kind"] for entry in audit["violations"])
    by_kind = ", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items()))
    verdict = "clean" if count == 0 else f"{count} violations ({by_kind})"
    return ("audit", verdict, remark)

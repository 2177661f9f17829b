"""Time windows between steps, in a plan and in a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from planning.tasks.task import TimeWindow
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.graph.windows import window_gaps, window_nodes
from twin.durations.nanoseconds import NANOSECONDS
from twin.runs.execution_record import ExecutionRecord


def window_summary(
    tpg: TemporalPlanGraph, run: ExecutionRecord
) -> list[dict[str, Any]]:
    """Return the time windows of a run for ``summary.json``; with None for times of windows that were not reached."""
    if not tpg.windows:
        return []
    start, end = np.concatenate(run.start_ns), np.concatenate(run.end_ns)
    gaps, nodes = window_gaps(tpg, start, end), window_nodes(tpg)
    found = []
    for window, gap, (_, done, due) in zip(tpg.windows, gaps, nodes, strict=True):
        happened = (done == TimeWindow.EARLIER or end[done] >= 0) and start[due] >= 0
        passed = float(gap) / NANOSECONDS if happened else None
        slack = None
        if passed is not None and window.most is not None:
            slack = window.most - passed
        found.append(
            {
                "window": window.words,
                "at_least_s": window.least,
                "within_s": window.most,
                "passed_s": passed,
                "slack_s": slack,
                "broken": None if slack is None else slack < 0.0,
            }
        )
    return found


def window_rows(windows: Sequence[Mapping[str, Any]]) -> list[tuple[str, str, str]]:
    """Return rows of the printed summary: name, value, remark."""
    rows = []
    for own in windows:
        bounds = []
        if own["at_least_s"]:
            bounds.append(f"at least {own['at_least_s']:g} s")
        if own["within_s"] is not None:
            bounds.append(f"within {own['within_s']:g} s")
        said = " and ".join(bounds)
        if own["broken"]:
            said = f"BROKEN by {-own['slack_s']:.2f} s: {said}"
        passed = "-" if own["passed_s"] is None else f"{own['passed_s']:.2f} s"
        rows.append((str(own["window"]), passed, said))
    return rows


def broken_words(window: TimeWindow, passed_ns: int) -> str:
    """Return a sentence on the excess of a window; empty where it was kept."""
    if window.most is None:
        return ""
    late = passed_ns / NANOSECONDS - window.most
    if late <= 0.0:
        return ""
    return f"{window.words}: {passed_ns / NANOSECONDS:.3f} s, {late:.3f} s more than {window.most:g} s"

"""The figures of a comparison over its seeds: ``compare.json``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from twin.comparison.comparison import COMPARED, SEQUENTIAL, Measurement, Rows

STAGES = ("sequence", "assignment", "motion", "synchronous", "tpg", "shortcut")
"""Stages of planning in the order they are gone through."""

TOTAL = "total"
"""Name of the sum of all stages."""

Figure = dict[str, Any]
"""Keys mean, std and per_seed."""


def comparison_figures(rows: Rows) -> dict[str, dict[str, Any]]:
    """Return the figures of every policy, with the keys of ``compare.json``.

    Each figure is {mean, std, per_seed}, std being the sample standard deviation, null with
    one seed. Relative figures are those of a seed over the sequential plan's of the same seed.
    """
    first = [row[SEQUENTIAL] for row in rows.values()]
    return {
        name: {
            **_policy_figures([row[name] for row in rows.values()], first),
            "seeds": list(rows),
        }
        for name in COMPARED
    }


def figure(values: Sequence[float | None]) -> Figure | None:
    """Return mean and spread of values a seed, None where one is missing."""
    known = [value for value in values if value is not None]
    if not known or len(known) < len(values):
        return None
    return {
        "mean": float(np.mean(known)),
        "std": float(np.std(known, ddof=1)) if len(known) > 1 else None,
        "per_seed": [float(value) for value in known],
    }


def _policy_figures(
    own: Sequence[Measurement], first: Sequence[Measurement]
) -> dict[str, Any]:
    def each(value: Callable[[Measurement], float | None]) -> Figure | None:
        return figure([value(m) for m in own])

    def relative(value: Callable[[Measurement], float]) -> Figure | None:
        pairs = [(value(m), value(f)) for m, f in zip(own, first, strict=True)]
        return figure([a / b if b > 0 else None for a, b in pairs])

    return {
        "makespan_s": each(lambda m: m.makespan_s),
        "wait_s": each(lambda m: m.wait_s),
        "planning_s": _planning([m.planning_s for m in own]),
        "relative_makespan": relative(lambda m: m.makespan_s),
        "relative_wait": relative(lambda m: m.wait_s),
        "straight_line_s": each(lambda m: m.straight_line_s),
        "critical_path_s": each(lambda m: m.critical_path_s),
        "straight_line_ratio": each(lambda m: m.straight_line_ratio),
        "nodes": each(lambda m: m.nodes),
        "type2_edges": each(lambda m: m.type2_edges),
    }


def _planning(rows: Sequence[Mapping[str, float]]) -> dict[str, Figure | None]:
    stages = [s for s in STAGES if any(s in row for row in rows)]
    out = {s: figure([row.get(s, 0.0) for row in rows]) for s in stages}
    return {**out, TOTAL: figure([sum(row.values()) for row in rows])}

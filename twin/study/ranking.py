"""Ranking of layouts by their mean makespan, with differences from paired replications."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from planning.transforms import Array
from twin.scenario.variations import is_of_execution, layout_of
from twin.study.layouts import distinct
from twin.study.replications.experiment import Experiment
from twin.study.replications.statistics import mean_interval


def rank_layouts(
    experiment: Experiment, samples: Sequence[Array]
) -> list[dict[str, Any]]:
    """Return the layouts of every policy, the quickest first; empty where there is only one.

    Layouts are compared within one policy and the same values of what is varied besides. The
    difference of each to the quickest one is taken replication by replication. Its interval is
    wider than that of a single comparison, so that all of them hold at once (Bonferroni).

    Args:
        experiment: what was run.
        samples: makespans of each cell, NaN where it did not complete [s].
    """
    if len(distinct(experiment.variants)) < 2:
        return []
    groups: dict[str, list[int]] = {}
    for cell, (policy, variant) in enumerate(experiment.cells):
        rest = {k: v for k, v in variant.items() if is_of_execution(k)}
        groups.setdefault(json.dumps([policy, rest]), []).append(cell)
    # Groups of one policy follow each other, in the order of the policies.
    order = sorted(
        groups.values(),
        key=lambda cells: experiment.policies.index(experiment.cells[cells[0]][0]),
    )
    return [row for cells in order for row in _ranked(experiment, samples, cells)]


def _ranked(
    experiment: Experiment, samples: Sequence[Array], cells: Sequence[int]
) -> Iterator[dict[str, Any]]:
    """Yield the rows of the cells that are compared with each other."""
    confidence = experiment.precision.confidence
    done = [cell for cell in cells if np.isfinite(samples[cell]).any()]
    done.sort(key=lambda cell: float(np.nanmean(samples[cell])))
    several = 1.0 - (1.0 - confidence) / max(len(done) - 1, 1)
    for place, cell in enumerate(done):
        policy, variant = experiment.cells[cell]
        behind = None
        both = np.isfinite(samples[cell]) & np.isfinite(samples[done[0]])
        if place and both.any():
            difference = samples[cell][both] - samples[done[0]][both]
            mirrored = experiment.antithetic and bool(both.all()) and len(both) > 1
            behind = mean_interval(
                difference, confidence=several, antithetic=mirrored
            ).content()
        yield {
            "rank": place + 1,
            "policy": policy,
            "variant": dict(variant),
            "layout": dict(layout_of(variant)),
            "cell": cell,
            "mean_s": float(np.nanmean(samples[cell])),
            "behind_s": behind,
        }

"""Layouts of a study: variants that differ in what a plan depends on, each with its own plans.

Ranking of layouts by their mean makespan, with differences from paired replications.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from planning.errors import RequestError, TwinError
from planning.transforms import Array
from twin.check.check import check_scenario
from twin.host.progress import Report
from twin.scenario.checks import find_problems
from twin.scenario.document.validation import parsed
from twin.scenario.sections.scenario import Scenario, resolved
from twin.scenario.variations import Variant, is_of_execution, layout_of, varied
from twin.study.folder import Refused, StudyRequest
from twin.study.plans import Plans, plan_for_study, plan_key
from twin.study.replications.statistics import Experiment, mean_interval

LAYOUTS = "layouts planned"
"""Name of the stage for progress displays."""


@dataclass(frozen=True)
class PlannedStudy:
    """A study whose layouts are planned.

    Attributes:
        request: with the variants that can be planned, and the layouts that cannot.
        plans: of all layouts, by plan_key.
    """

    request: StudyRequest
    plans: Plans


def distinct(variants: Sequence[Variant]) -> list[Variant]:
    """Return the layouts of some variants, each once, in order of their first."""
    found = {json.dumps(layout_of(v)): layout_of(v) for v in variants}
    return list(found.values())


def plan_layouts(request: StudyRequest, progress: Report) -> PlannedStudy:
    """Plan every layout of a study; those that have no plan are left out, with the reason.

    Where nothing is varied that a plan depends on there is one layout, and it must have a plan.

    Raises:
        TwinError: the only layout cannot be planned.
        RequestError: there are several, and none can.
    """
    experiment = request.experiment
    wanted = distinct(experiment.variants)
    if not any(wanted):
        plans = _plans_of(request, {}, progress)
        return PlannedStudy(request, {plan_key({}, k): p for k, p in plans.items()})
    found: dict[str, Plans] = {}
    refused = []
    for number, layout in enumerate(wanted):
        progress(LAYOUTS, number, len(wanted))
        try:
            found[json.dumps(layout)] = _plans_of(request, layout, progress)
        except TwinError as error:
            refused.append(Refused(layout, " ".join(str(error).split())))
    progress(LAYOUTS, len(wanted), len(wanted))
    if not found:
        said = "; ".join(f"{words(item.layout)}: {item.reason}" for item in refused)
        raise RequestError(f"no layout can be planned: {said}")
    kept = tuple(v for v in experiment.variants if json.dumps(layout_of(v)) in found)
    plans = {
        plan_key(layout, name): plan
        for layout in distinct(kept)
        for name, plan in found[json.dumps(layout)].items()
    }
    experiment = replace(experiment, variants=kept)
    return PlannedStudy(
        replace(request, experiment=experiment, refused=tuple(refused)), plans
    )


def words(layout: Variant) -> str:
    """Return the values of a layout in one line."""
    return ", ".join(f"{key} = {value}" for key, value in layout.items())


def _plans_of(request: StudyRequest, layout: Variant, progress: Report) -> Plans:
    """Plan one layout for every policy; what the check of its cell finds is an error."""
    scenario = varied(request.scenario, layout)
    if layout:
        for message in _errors(scenario, request.base):
            raise RequestError(message)
    return plan_for_study(
        scenario,
        request.base,
        request.experiment.policies,
        candidates=request.candidates,
        progress=progress,
    )


def _errors(scenario: Scenario, base: Path) -> Iterator[str]:
    """Yield what makes every plan of a layout impossible or false."""
    # Its places are those of no file: only the messages are told.
    text = json.dumps(resolved(scenario))
    document = parsed(base / f"{scenario.name}.yaml", text)
    for problem in find_problems(scenario, document):
        yield problem.message
        return
    report = check_scenario(scenario, document, base)
    if report.errors:
        yield "; ".join(item.message for item in report.errors)


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

"""Layouts of a study: variants that differ in what a plan depends on, each with its own plans."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from planning.errors import RequestError, TwinError
from twin.check.check import check_scenario
from twin.host.progress import Report
from twin.scenario.checks import find_problems
from twin.scenario.document.validation import parsed
from twin.scenario.sections.scenario import Scenario, resolved
from twin.scenario.variations import Variant, layout_of, varied
from twin.study.folder import Refused, StudyRequest
from twin.study.plans import Plans, plan_for_study, plan_key

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

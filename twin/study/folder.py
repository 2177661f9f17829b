"""Folder of a study: names of its files, and its request as a manifest."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from planning.cell.workcell import Workcell
from planning.errors import OutputError, RequestError
from twin.scenario.manifest import (
    MANIFEST,
    read_manifest,
    unchanged_base,
    write_manifest,
)
from twin.scenario.sections.scenario import Scenario
from twin.scenario.variations import Variant
from twin.study.replications.statistics import Experiment

PLANS, BLOCKS, AUDITS, PREVENTED = "plans", "blocks", "audits", "prevented"
REPLICATIONS, TASKS, EDGES = (
    "replications.parquet",
    "tasks.parquet",
    "edges.parquet",
)
PRODUCTS = "products.parquet"
SUMMARY, REPORT = "summary.json", "report.html"


@dataclass(frozen=True)
class Refused:
    """A layout that cannot be planned.

    Attributes:
        layout: values of the keys that a plan depends on.
        reason: why not.
    """

    layout: Variant
    reason: str


@dataclass(frozen=True)
class StudyRequest:
    """Request of a study: all of its options.

    Attributes:
        scenario: what is studied.
        base: where relative paths of the scenario start.
        experiment: policies, varied inputs, replications.
        candidates: shortcuts tried, where a policy takes them.
        deadline_s: ask how likely the run is over by then [s], None not to.
        sobol_points: of the sample for Sobol indices, 0 for none.
        plan: folder of the run whose plan is studied; empty where it was planned for the study.
        refused: layouts that were asked for and cannot be planned.
        operated: whether what fails is planned anew.

    Raises:
        RequestError: the deadline is no positive time, or the points are no power of 2.
    """

    scenario: Scenario
    base: Path
    experiment: Experiment
    candidates: int
    deadline_s: float | None = None
    sobol_points: int = 0
    plan: str = ""
    refused: tuple[Refused, ...] = ()
    operated: bool = False

    def __post_init__(self) -> None:
        deadline_s = self.deadline_s
        if deadline_s is not None and not 0 < deadline_s < math.inf:
            raise RequestError(
                f"a deadline must be more than 0 s, not {deadline_s:g} s"
            )
        if self.sobol_points:
            check_points(self.sobol_points)


def check_points(points: int) -> None:
    """Refuse a number of points that is no power of 2 greater than 1, with a RequestError."""
    if points < 2 or points & (points - 1):
        raise RequestError(
            f"Sobol indices need a power of 2 of points, not {points}",
            choices=("64", "128", "256", "512"),
        )


def write_request(
    folder: Path, request: StudyRequest, cell: Workcell, plans: Mapping[str, str]
) -> None:
    """Write ``manifest.json``: what is needed to understand, go on with and repeat the study."""
    study = {
        "experiment": asdict(request.experiment),
        "shortcut_candidates": request.candidates,
        "deadline_s": request.deadline_s,
        "sobol_points": request.sobol_points,
        "plan": request.plan,
        "refused": [asdict(item) for item in request.refused],
        "plans_sha256": dict(plans),
        **({"operated": True} if request.operated else {}),
    }
    write_manifest(folder, request.scenario, cell, request.base, study=study)


def read_request(folder: Path) -> StudyRequest:
    """Return the request of a study.

    Raises:
        OutputError: the folder is not one of a study, or its manifest is damaged.
        RequestError: a file that the scenario names, or a version, has changed since.
    """
    scenario, manifest = read_manifest(folder, "folder of a study")
    try:
        study = manifest["study"]
        base = unchanged_base(folder, manifest, scenario)
        return StudyRequest(
            scenario,
            base,
            TypeAdapter(Experiment).validate_python(study["experiment"]),
            int(study["shortcut_candidates"]),
            study["deadline_s"],
            int(study["sobol_points"]),
            str(study.get("plan", "")),
            TypeAdapter(tuple[Refused, ...]).validate_python(study.get("refused", ())),
            bool(study.get("operated", False)),
        )
    except (ValueError, KeyError, TypeError, ValidationError) as error:
        path = folder / MANIFEST
        raise OutputError(f"{path}: is no manifest of a study: {error}") from error


def require_same_plans(folder: Path, hashes: Mapping[str, str]) -> None:
    """Refuse plans that are not those with which a study began.

    Raises:
        OutputError: a plan has changed; the message names it.
    """
    _, manifest = read_manifest(folder, "folder of a study")
    before = manifest["study"].get("plans_sha256", {})
    for name, digest in hashes.items():
        if before.get(name) != digest:
            raise OutputError(
                f"{folder / PLANS}: the plan {name!r} is not the one that the study began with"
            )


def require_same_study(folder: Path, scenario: Scenario) -> None:
    """Refuse a folder that holds a study of another scenario.

    Raises:
        RequestError: it does.
        OutputError: it holds none.
    """
    there = read_request(folder).scenario
    if there != scenario:
        raise RequestError(
            f"{folder} holds a study of scenario {there.name!r} as it was then, not of this"
            f" {scenario.name!r}; give another folder, or leave the scenario away to go on"
            " with that one"
        )


def require_no_study(folder: Path | None, scenario: Scenario) -> None:
    """Refuse a folder that holds a study already.

    Raises:
        RequestError: it does; says how to go on with it.
        OutputError: it holds something else.
    """
    if folder is not None and (folder / MANIFEST).exists():
        require_same_study(folder, scenario)
        raise RequestError(
            f"{folder} holds a study already: go on with it by --resume {folder}, or give"
            " another folder"
        )

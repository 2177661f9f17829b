"""The folder of a study: what it was asked, and what it has so far."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from planning.cell.workcell import Workcell
from planning.errors import OutputError, RequestError
from twin.host.atomic import write_json
from twin.run.folder import MANIFEST, manifest
from twin.scenario.sections.scenario import Scenario, fingerprint, resolved
from twin.study.replications.experiment import Experiment
from twin.study.replications.statistics import Precision

PLANS, BLOCKS, AUDITS = "plans", "blocks", "audits"
REPLICATIONS, TASKS, EDGES = (
    "replications.parquet",
    "tasks.parquet",
    "edges.parquet",
)
SUMMARY, REPORT = "summary.json", "report.html"


@dataclass(frozen=True)
class StudyRequest:
    """All that a study was asked.

    Attributes:
        scenario: what is studied.
        base: where relative paths of the scenario start.
        experiment: policies, varied inputs, replications.
        candidates: shortcuts tried, where a policy takes them.
        deadline_s: ask how likely the run is over by then [s], None not to.
        sobol_points: of the sample for Sobol indices, 0 for none.
    """

    scenario: Scenario
    base: Path
    experiment: Experiment
    candidates: int
    deadline_s: float | None = None
    sobol_points: int = 0


def write_request(folder: Path, request: StudyRequest, cell: Workcell) -> None:
    """Write ``manifest.json``: what is needed to understand, go on with and repeat the study."""
    about = manifest(resolved(request.scenario), cell, seed=request.scenario.seed)
    experiment = asdict(request.experiment)
    study = {
        "base": str(request.base.resolve()),
        "experiment": experiment,
        "shortcut_candidates": request.candidates,
        "deadline_s": request.deadline_s,
        "sobol_points": request.sobol_points,
    }
    write_json(folder / MANIFEST, {**about, "study": study})


def read_request(folder: Path) -> StudyRequest:
    """Return what a study was asked.

    Raises:
        OutputError: the folder is not one of a study, or its manifest is damaged.
    """
    path = folder / MANIFEST
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        study = document["study"]
        return StudyRequest(
            Scenario.model_validate_json(json.dumps(document["scenario"])),
            Path(study["base"]),
            _experiment(study["experiment"]),
            int(study["shortcut_candidates"]),
            study["deadline_s"],
            int(study["sobol_points"]),
        )
    except FileNotFoundError as error:
        raise OutputError(f"{folder}: is no folder of a study: {error}") from error
    except (OSError, ValueError, KeyError, TypeError, ValidationError) as error:
        raise OutputError(f"{path}: is no manifest of a study: {error}") from error


def same_study(folder: Path, scenario: Scenario) -> None:
    """Refuse a folder that holds a study of another scenario.

    Raises:
        RequestError: it does.
        OutputError: it holds none.
    """
    there = read_request(folder).scenario
    if fingerprint(there) != fingerprint(scenario):
        raise RequestError(
            f"{folder} holds a study of scenario {there.name!r} as it was then, not of this"
            f" {scenario.name!r}; give another folder, or leave the scenario away to go on"
            " with that one"
        )


def _experiment(values: dict[str, Any]) -> Experiment:
    return Experiment(
        policies=tuple(values["policies"]),
        variants=tuple(values["variants"]),
        replications=values["replications"],
        precision=Precision(**values["precision"]),
        antithetic=values["antithetic"],
        audited=values["audited"],
    )

"""Folder of an exploration: names of its files, and its request as a manifest.

A scenario of one's own, begun with a design that an exploration has found.
"""

from __future__ import annotations

import json
import logging
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from planning.errors import OutputError, RequestError, ScenarioError
from planning.files import (
    LARGEST,
    NPZ_ERRORS,
    read_file,
    read_npz,
    read_object,
    replacing,
    require_own_files,
)
from planning.transforms import Array
from twin.explore.dimensions import dimensions_of, variant_of
from twin.explore.journal import JOURNAL
from twin.explore.rungs import Setting
from twin.explore.section import ExploreSection
from twin.host.guard import versions_of
from twin.planning.build_workcell import build_workcell
from twin.scenario.manifest import (
    MANIFEST,
    read_manifest,
    unchanged_base,
    write_manifest,
)
from twin.scenario.sections.scenario import Scenario
from twin.scenario.shipped import write_beginning
from twin.scenario.variations import varied
from twin.trial.loaded_scenario import LoadedScenario

SUMMARY, REPORT, SAMPLES = "summary.json", "report.html", "samples"

_log = logging.getLogger(__name__)

_ENTRY = "exploration"
_CHOOSING = ("optuna", "cmaes")
"""Packages that choose designs."""


@dataclass(frozen=True)
class ExploreRequest(Setting):
    """What is explored: the setting of all designs.

    Attributes:
        singles: how many single changes are asked for; 0 for a search.
    """

    singles: int = 0


def write_request(folder: Path, request: ExploreRequest) -> None:
    """Write ``manifest.json``: what is needed to understand, go on with and repeat the exploration."""
    cell = build_workcell(request.scenario, request.folder)
    entry = {
        "section": request.section.model_dump(mode="json"),
        "single_changes": request.singles,
        "packages": versions_of(_CHOOSING),
    }
    write_manifest(folder, request.scenario, cell, request.folder, **{_ENTRY: entry})


def read_request(folder: Path) -> ExploreRequest:
    """Return the request of an exploration.

    Raises:
        OutputError: the folder is not one of an exploration, or its manifest is damaged.
        RequestError: a file that the scenario names, or a version, has changed since.
    """
    scenario, manifest = read_manifest(folder, "folder of an exploration")
    path = folder / MANIFEST
    if _ENTRY not in manifest:
        raise OutputError(
            f"{path}: no folder of an exploration: it is of something else"
        )
    try:
        entry = manifest[_ENTRY]
        base = unchanged_base(folder, manifest, scenario)
        if entry["packages"] != (now := versions_of(_CHOOSING)):
            raise RequestError(
                f"{path}: begun with other versions: {entry['packages']}, now {now}"
            )
        section = ExploreSection.model_validate_json(json.dumps(entry["section"]))
        singles = int(entry["single_changes"])
        return ExploreRequest(scenario, base, section, singles)
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        raise OutputError(
            f"{path}: is no manifest of an exploration: {error!r}"
        ) from error


def require_free(folder: Path | None) -> None:
    """Refuse a folder that holds an exploration or other results already.

    Raises:
        RequestError: it does; says how to go on with it.
    """
    if folder is None:
        return
    if (folder / JOURNAL).exists():
        raise RequestError(
            f"{folder} holds an exploration already: go on with it by --resume {folder}, or give"
            " another folder"
        )
    if (folder / MANIFEST).exists():
        raise RequestError(f"{folder} holds other results: give another folder")


def read_sample(path: Path) -> Array:
    """Return the makespans that ``write_sample`` wrote; none where there is no such file, or a damaged one.

    Returns:
        NaN where a replication did not complete, shape (n,) [s].
    """
    if not os.path.lexists(path):
        return np.empty(0)
    try:
        (values,) = read_npz(read_file(path), kinds="f", most=LARGEST).values()
        if (
            values.ndim != 1
            or values.dtype != np.float64
            or np.any((values < 0.0) | np.isinf(values))
        ):
            raise ValueError("these are no makespans")
    except NPZ_ERRORS as error:
        _log.warning("%s: cannot be read, is computed anew: %s", path, error)
        return np.empty(0)
    return values


def write_sample(path: Path, makespans_s: Array) -> None:
    """Write makespans of replications to a file.

    Raises:
        OutputError: it cannot be written.
    """
    try:
        path.parent.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"{path.parent}: cannot be made: {error}") from error
    with replacing(path) as temporary:
        np.savez_compressed(temporary, makespans_s=makespans_s)


_DESIGN = re.compile(r"^([^#]*)(?:#(\d+))?$")


def begin_design(target: Path, source: str) -> Path:
    """Write the scenario of a design to a place of one's own, with the files that it names beside it.

    Nothing is overwritten. What the scenario leaves to its defaults stays left out; comments are lost.

    Args:
        target: a YAML file, or a folder.
        source: folder of an exploration, and the rank of the design: ``explored#3``; the best without.

    Returns:
        The file of the scenario.

    Raises:
        OutputError: the folder is not one of an exploration, or the file is there already.
        RequestError: there is no design of this rank.
    """
    match = _DESIGN.match(source)
    if match is None:
        raise RequestError(
            f"{source}: a design is called by folder and rank, such as explored#3"
        )
    folder, rank = Path(match[1]), int(match[2] or 1)
    path = folder / SUMMARY
    require_own_files(folder, (SUMMARY,))
    best = read_object(path, "summary of an exploration").get("best")
    try:
        found = {int(row["rank"]): row for row in best or ()}
    except (ValueError, KeyError, TypeError) as error:
        raise OutputError(f"{path}: no summary of an exploration") from error
    if rank not in found:
        there = f"1 to {len(found)}" if found else "none"
        raise RequestError(f"{folder} has no design #{rank}: there are {there}")
    row = found[rank]
    request = read_request(folder)
    document = LoadedScenario(request.scenario, request.folder).document
    dimensions = dimensions_of(request.scenario, request.section, document)
    try:
        scenario = varied(
            request.scenario, variant_of(dimensions, row["values"])
        ).changed(explore=None)
    except (KeyError, ScenarioError) as error:
        raise OutputError(f"{path}: is of another exploration: {error}") from error
    changes = "; ".join(row["changes"]) or "the scenario as it is"
    head = f"# Design {row['design']} of an exploration of {scenario.name}: {changes}\n"
    return write_beginning(target, head + scenario_text(scenario), request.folder)


def scenario_text(scenario: Scenario) -> str:
    """Return a scenario as YAML, without what it leaves to defaults."""
    whole = scenario.model_dump(mode="json", by_alias=True, exclude={"explore"})
    said = scenario.model_dump(
        mode="json", by_alias=True, exclude_defaults=True, exclude={"explore"}
    )
    content = _with_kinds(said, whole)
    return yaml.safe_dump(
        content, sort_keys=False, allow_unicode=True, default_flow_style=None, width=110
    )


def _with_kinds(said: Any, whole: Any) -> Any:
    """Return what is said with the kind of every section, also where that is its default."""
    if isinstance(said, dict):
        found = {key: _with_kinds(value, whole[key]) for key, value in said.items()}
        kind = {"kind": whole["kind"]} if "kind" in whole else {}
        return {**kind, **found}
    if isinstance(said, list):
        return [_with_kinds(*pair) for pair in zip(said, whole, strict=True)]
    return said

"""Folder of an exploration: names of its files, and its request as a manifest."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError

from planning.errors import OutputError, RequestError
from twin.explore.journal import JOURNAL
from twin.host.guard import versions_of
from twin.planning.build_workcell import build_workcell
from twin.scenario.manifest import (
    MANIFEST,
    read_manifest,
    unchanged_base,
    write_manifest,
)
from twin.scenario.sections.exploration import ExploreSection
from twin.scenario.sections.scenario import Scenario

SUMMARY, REPORT, PARCELS = "summary.json", "report.html", "parcels"

_ENTRY = "exploration"
_CHOOSING = ("optuna", "cmaes")
"""Packages that choose designs."""


@dataclass(frozen=True)
class ExploreRequest:
    """What is explored.

    Attributes:
        scenario: as it is.
        base: where relative paths in it start.
        section: what varies, and what is looked for.
        singles: how many single changes are asked for; 0 for a search.
    """

    scenario: Scenario
    base: Path
    section: ExploreSection
    singles: int = 0


def write_request(folder: Path, request: ExploreRequest) -> None:
    """Write ``manifest.json``: what is needed to understand, go on with and repeat the exploration."""
    cell = build_workcell(request.scenario, request.base)
    entry = {
        "section": request.section.model_dump(mode="json"),
        "single_changes": request.singles,
        "packages": versions_of(_CHOOSING),
    }
    write_manifest(folder, request.scenario, cell, request.base, **{_ENTRY: entry})


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
                f"{folder} was begun with other versions: {entry['packages']}, now {now}"
            )
        section = ExploreSection.model_validate_json(json.dumps(entry["section"]))
        singles = int(entry["single_changes"])
        return ExploreRequest(scenario, base, section, singles)
    except (ValueError, KeyError, TypeError, ValidationError) as error:
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

"""Output folder of a design exploration: its file names, and its settings, stored as a manifest."""

from __future__ import annotations

import json
import logging
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from planning.errors import OutputError, RequestError
from planning.files import LARGEST, NPZ_ERRORS, read_file, read_npz, replace_atomically
from planning.transforms import Array
from twin.explorations.journal import JOURNAL
from twin.explorations.rungs import ExplorationSetting
from twin.explorations.section import ExploreSection
from twin.host.versions import versions_of
from twin.planning.build_workcell import build_workcell
from twin.scenario.manifest import (
    MANIFEST,
    read_manifest,
    unchanged_base,
    write_manifest,
)

SUMMARY, REPORT, SAMPLES = "summary.json", "report.html", "samples"

_log = logging.getLogger(__name__)

_ENTRY = "exploration"
_CHOOSING = ("optuna", "cmaes")
"""Packages that choose designs."""


@dataclass(frozen=True)
class ExploreRequest(ExplorationSetting):
    """Settings of an exploration, which all its designs share.

    Attributes:
        singles: number of single changes requested; 0 for a search.
    """

    singles: int = 0


def write_request(folder: Path, request: ExploreRequest) -> None:
    """Write ``manifest.json``: the data needed to understand, resume and repeat the exploration."""
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
        RequestError: it does; names how to resume it.
    """
    if folder is None:
        return
    if (folder / JOURNAL).exists():
        raise RequestError(
            f"{folder} holds an exploration already: continue it with --resume {folder}, or give"
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
        _log.warning("%s: cannot be read, is recomputed: %s", path, error)
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
    with replace_atomically(path) as temporary:
        np.savez_compressed(temporary, makespans_s=makespans_s)

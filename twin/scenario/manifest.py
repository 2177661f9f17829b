"""``manifest.json``: the data needed to understand, repeat and resume a run or a study."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from planning.cell.workcell import PlacedRobot, Workcell
from planning.errors import OutputError, RequestError, ScenarioError, format_names
from planning.files import read_file, read_object, require_own_files
from planning.robots.descriptions.description_files import description_sha256
from planning.transforms import Transform, quat_wxyz
from twin.document.section import iterate_nested
from twin.durations.measured import Empirical
from twin.host.atomic_files import write_json
from twin.host.versions import versions
from twin.scenario.sections.scenario import Scenario, resolve_scenario, restore_scenario

MANIFEST = "manifest.json"

RESULTS = (
    *(MANIFEST, "plan.json", "plan.npz", "robots", "in-turns", "first-plan"),
    *("events.jsonl", "trajectory.parquet", "objects.parquet", "measured.csv"),
    *("plans", "blocks", "prevented", "audits", "journal.jsonl", "samples"),
    *("summary.json", "compare.json"),
)
"""Files and folders of results that are read again, or needed to resume."""


def write_manifest(
    folder: Path, scenario: Scenario, cell: Workcell, base: Path, **more: Any
) -> None:
    """Write the manifest of a run, a comparison or a study.

    Args:
        folder: of the results.
        scenario: the scenario of the run.
        cell: built from it.
        base: where its relative paths start.
        more: further entries as plain JSON values, needed to resume.
    """
    content = resolve_scenario(scenario)
    write_json(
        folder / MANIFEST,
        {
            "scenario": content,
            "scenario_sha256": scenario_sha256(content),
            "seed": scenario.seed,
            "versions": versions(),
            "base": os.path.relpath(base.resolve(), folder.resolve()),
            "files": file_hashes(scenario, base),
            "robots": [_robot_entry(robot) for robot in cell.robots],
            **more,
        },
    )


def read_manifest(folder: Path, what: str) -> tuple[Scenario, dict[str, Any]]:
    """Return the scenario and all entries of a manifest.

    Args:
        folder: of the results.
        what: the kind of manifest, for messages: ``run to resume``.

    Raises:
        OutputError: there is no manifest, or it is damaged.
    """
    path = folder / MANIFEST
    require_own_files(folder, RESULTS)
    content = read_object(path, what)
    try:
        scenario, digest = content["scenario"], content["scenario_sha256"]
    except KeyError as error:
        raise OutputError(f"{path}: damaged: {error!r}") from error
    if scenario_sha256(scenario) != digest:
        raise OutputError(f"{path}: the scenario is not the one of scenario_sha256")
    try:
        return restore_scenario(scenario), content
    except ScenarioError as error:
        raise OutputError(f"{path}: the scenario is no longer valid: {error}") from None


def manifest_base(folder: Path, manifest: Mapping[str, Any]) -> Path:
    """Return the base folder of relative paths in the scenario of a manifest.

    Raises:
        OutputError: the manifest has no such entry.
    """
    base = manifest.get("base")
    if not isinstance(base, str):
        raise OutputError(
            f"{folder / MANIFEST}: does not say where its paths start: no 'base'"
        )
    return Path(os.path.normpath(folder.resolve() / base))


def file_hashes(scenario: Scenario, base: Path) -> dict[str, str]:
    """Return the sha256 of every file of measured durations of a scenario, by name.

    Raises:
        OutputError: one cannot be read.
    """
    out = {}
    parts = (part for _, part in iterate_nested(scenario))
    for name in sorted({part.csv for part in parts if isinstance(part, Empirical)}):
        try:
            content = read_file(base / name)
        except OSError as error:
            raise OutputError(f"{base / name}: cannot be read: {error}") from error
        out[name] = hashlib.sha256(content).hexdigest()
    return out


def require_same_files(
    folder: Path, manifest: Mapping[str, Any], scenario: Scenario, base: Path
) -> None:
    """Refuse to continue if a file that the scenario names has changed.

    Raises:
        RequestError: a file has changed; the message names it.
        OutputError: a file cannot be read.
    """
    before = manifest.get("files")
    for name, digest in file_hashes(scenario, base).items():
        if isinstance(before, dict) and before.get(name) != digest:
            raise RequestError(
                f"{folder / MANIFEST}: {base / name} is not what it was when this began"
            )


def require_same_versions(folder: Path, manifest: Mapping[str, Any]) -> None:
    """Refuse to mix results of different versions of Python or of a package.

    Raises:
        RequestError: a version is another one; the message names all of them.
    """
    before, now = manifest.get("versions"), versions()
    if isinstance(before, dict) and before != now:
        changed = [
            f"{name} was {before.get(name, 'unknown')} and is {now.get(name, 'unknown')}"
            for name in sorted({*before, *now})
            if before.get(name) != now.get(name)
        ]
        raise RequestError(
            f"{folder / MANIFEST}: begun with other versions: {format_names(changed)}"
        )


def unchanged_base(
    folder: Path, manifest: Mapping[str, Any], scenario: Scenario
) -> Path:
    """Return the base folder of a run or study to resume; refuse one that cannot be resumed.

    Raises:
        RequestError: a file that the scenario names, or a version, has changed since.
        OutputError: a file cannot be read.
    """
    base = manifest_base(folder, manifest)
    require_same_files(folder, manifest, scenario, base)
    require_same_versions(folder, manifest)
    return base


def scenario_sha256(content: Mapping[str, Any]) -> str:
    """Return the hash of a resolved scenario: of its compact JSON with sorted keys."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _robot_entry(robot: PlacedRobot) -> dict[str, Any]:
    model = robot.model
    return {
        "name": robot.name,
        "model": model.name,
        "urdf": model.urdf.name,
        "sha256": description_sha256(model),
        "base": _pose_entry(robot.base),
        "joints": list(model.joint_names),
        "tool": {
            "last_joint_T_flange": _pose_entry(model.flange),
            "flange_T_frame": {k: _pose_entry(p) for k, p in model.frames.items()},
        },
    }


def _pose_entry(pose: Transform) -> dict[str, list[float]]:
    return {"xyz": pose[:3, 3].tolist(), "quat_wxyz": quat_wxyz(pose).tolist()}

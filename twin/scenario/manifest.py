"""``manifest.json``: all that is needed to understand, repeat and resume a run or a study.

Reading a scenario file: text -> YAML -> sections -> checked scenario, or all problems at once.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

from planning.cell.workcell import PlacedRobot, Workcell
from planning.errors import OutputError, RequestError, ScenarioError, listed
from planning.files import read_file, read_json, require_own_files
from planning.robots.descriptions.xml_files import description_sha256
from planning.transforms import Transform, quat_wxyz
from twin.durations.measured import Empirical
from twin.host.guard import versions, write_json
from twin.registry import KINDS
from twin.scenario.checks import find_problems
from twin.scenario.document.section import Section, parts_of
from twin.scenario.document.validation import (
    FileProblem,
    InvalidScenarioError,
    parsed,
    validated,
)
from twin.scenario.document.yaml_text import Mark, YamlDocument
from twin.scenario.sections.scenario import Scenario, resolved, restored

MANIFEST = "manifest.json"

RESULTS = (
    *(MANIFEST, "plan.json", "plan.npz", "robots", "in-turns", "first-plan"),
    *("events.jsonl", "trajectory.parquet", "objects.parquet", "measured.csv"),
    *("plans", "blocks", "prevented", "audits", "journal.jsonl", "samples"),
    *("summary.json", "compare.json"),
)
"""Files and folders of results that are read back, or gone on with."""


def write_manifest(
    folder: Path, scenario: Scenario, cell: Workcell, base: Path, **more: Any
) -> None:
    """Write the manifest of a run, a comparison or a study.

    Args:
        folder: of the results.
        scenario: what is run.
        cell: built from it.
        base: where its relative paths start.
        more: further entries, as plain JSON values: what it takes to go on.
    """
    content = resolved(scenario)
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
    """Return the scenario of a manifest, and all of its entries.

    Args:
        folder: of the results.
        what: what they are wanted for, for messages: ``run to resume``.

    Raises:
        OutputError: there is no manifest, or it is damaged.
    """
    path = folder / MANIFEST
    require_own_files(folder, RESULTS)
    try:
        content: dict[str, Any] = read_json(path)
        scenario, digest = content["scenario"], content["scenario_sha256"]
    except (OSError, ValueError) as error:
        raise OutputError(f"{path}: no {what}: {error}") from error
    except (KeyError, TypeError) as error:
        raise OutputError(f"{path}: damaged: {error!r}") from error
    if scenario_sha256(scenario) != digest:
        raise OutputError(f"{path}: the scenario is not the one of scenario_sha256")
    try:
        return restored(scenario), content
    except ScenarioError as error:
        raise OutputError(f"{path}: the scenario is no longer valid: {error}") from None


def manifest_base(folder: Path, manifest: Mapping[str, Any]) -> Path:
    """Return where relative paths of the scenario of a manifest start.

    Raises:
        OutputError: the manifest does not say.
    """
    base = manifest.get("base")
    if not isinstance(base, str):
        raise OutputError(
            f"{folder / MANIFEST}: does not say where its paths start: no 'base'"
        )
    return Path(os.path.normpath(folder.resolve() / base))


def file_hashes(scenario: Scenario, base: Path) -> dict[str, str]:
    """Return the sha256 of every file of measured times that a scenario names, by its name.

    Raises:
        OutputError: one cannot be read.
    """
    out = {}
    parts = (part for _, part in parts_of(scenario))
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
    """Refuse to go on when a file that the scenario names is not what it was.

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
            f"{folder / MANIFEST}: begun with other versions: {listed(changed)}"
        )


def unchanged_base(
    folder: Path, manifest: Mapping[str, Any], scenario: Scenario
) -> Path:
    """Return where relative paths of what was begun start, if it can be gone on with as it began.

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


def load_scenario(path: Path) -> Scenario:
    """Read and check a scenario file.

    Args:
        path: the YAML file; paths inside it are relative to its folder.

    Raises:
        InvalidScenarioError: with every problem found, each at its line and column.
    """
    return read_scenario(path)[0]


def read_scenario(path: Path) -> tuple[Scenario, YamlDocument]:
    """Read and check a scenario file as load_scenario does; return its text with places, too."""
    return scenario_of(path, _read_text(path))


def scenario_of(path: Path, text: str) -> tuple[Scenario, YamlDocument]:
    """Read and check the text of a scenario file, which need not be there yet.

    Args:
        path: where it is, or will be.
        text: its content.

    Raises:
        InvalidScenarioError: see load_scenario.
    """
    document, included = _include_section(parsed(path, text))
    scenario = validated(document, Scenario, scenario_schema)
    if included is not None:
        _check_included(scenario, included)
    found = [document.problem(*item) for item in find_problems(scenario, path.parent)]
    if found or document.problems:
        problems = [*document.problems, *found]
        raise InvalidScenarioError(path, problems, document.lines)
    return scenario, document


@cache
def scenario_schema() -> dict[str, Any]:
    """Return the JSON schema of scenario files, for editors."""
    schema = Scenario.model_json_schema(by_alias=True)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "title": "Scenario of assembly-twin",
    }


def _read_text(path: Path) -> str:
    try:
        if path.is_dir():
            reason = "this is a folder, a scenario file is expected"
        else:
            return read_file(path).decode("utf-8-sig")
    except FileNotFoundError:
        reason = "no such file"
    except UnicodeDecodeError as error:
        reason = f"not a UTF-8 text file (byte {error.start})"
    except OSError as error:
        reason = f"cannot be read: {error.strerror or error}"
    raise InvalidScenarioError(path, [FileProblem(Mark(1, 1), reason)])


def _include_section(
    document: YamlDocument,
) -> tuple[YamlDocument, YamlDocument | None]:
    """Return a scenario with the section of the file that its assembly names, and that file if any.

    Such as ``assembly.structure`` may be ``{file: NAME}``, relative to the scenario.
    """
    for kind in KINDS.load_all().values():
        for key, section in kind.included.items():
            name = _file_name(document.data, key)
            if name is not None:
                return _included(document, key, name, section)
    return document, None


def _included(
    document: YamlDocument, key: str, name: str, section: type[Section]
) -> tuple[YamlDocument, YamlDocument]:
    """Return a scenario with the section that a file holds, and that file.

    Raises:
        InvalidScenarioError: the file cannot be read, or does not hold such a section.
    """
    path = document.path.parent / name
    try:
        text = read_file(path).decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not a UTF-8 text file"
        problem = FileProblem(
            document.mark_of(("assembly", key, "file")),
            f"{path}: cannot be read: {reason}",
        )
        raise InvalidScenarioError(document.path, [problem], document.lines) from None
    included = parsed(path, text)
    validated(included, section, section.model_json_schema)
    if included.problems:
        raise InvalidScenarioError(path, included.problems, included.lines)
    data = dict(document.data)
    data["assembly"] = {**data["assembly"], key: included.data}
    return replace(document, data=data), included


def _check_included(scenario: Scenario, included: YamlDocument) -> None:
    """Raise an error, with places in that file, for what cannot be as it says."""
    found = scenario.kind.included_problems()
    problems = [included.problem(*item) for item in found]
    if problems:
        raise InvalidScenarioError(included.path, problems, included.lines)


def _file_name(data: Any, key: str) -> str | None:
    """Return the file that an entry of the assembly names, None where it is given in full or not at all."""
    assembly = data.get("assembly") if isinstance(data, dict) else None
    entry = assembly.get(key) if isinstance(assembly, dict) else None
    if not isinstance(entry, dict) or set(entry) != {"file"}:
        return None
    name = entry["file"]
    return name if isinstance(name, str) else None

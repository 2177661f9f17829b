"""``manifest.json``: all that is needed to understand, repeat and resume a run or a study."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from planning.cell.workcell import PlacedRobot, Workcell
from planning.errors import OutputError, ScenarioError
from planning.transforms import Transform, quat_wxyz
from twin.host.atomic import write_json
from twin.scenario.sections.scenario import Scenario, resolved, restored

MANIFEST = "manifest.json"

_PACKAGES = (
    "assembly-twin",
    "coal",
    "numba",
    "numpy",
    "ompl",
    "pin",
    "pybullet",
    "pulp",
    "pyarrow",
    "rerun-sdk",
    "scipy",
    "simpy",
)


def write_manifest(
    folder: Path, scenario: Scenario, cell: Workcell, **more: Any
) -> None:
    """Write the manifest of a run, a comparison or a study.

    Args:
        folder: of the results.
        scenario: what is run.
        cell: built from it.
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
    try:
        content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        scenario, digest = content["scenario"], content["scenario_sha256"]
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise OutputError(f"{path}: no {what}: {error}") from error
    except (KeyError, TypeError) as error:
        raise OutputError(f"{path}: damaged: {error!r}") from error
    if scenario_sha256(scenario) != digest:
        raise OutputError(f"{path}: the scenario is not the one of scenario_sha256")
    try:
        return restored(scenario), content
    except ScenarioError as error:
        raise OutputError(f"{path}: the scenario is no longer valid: {error}") from None


def scenario_sha256(content: Mapping[str, Any]) -> str:
    """Return the hash of a resolved scenario: of its compact JSON with sorted keys."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that results depend on."""
    found = {"python": platform.python_version()}
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


def _robot_entry(robot: PlacedRobot) -> dict[str, Any]:
    model = robot.model
    return {
        "name": robot.name,
        "model": model.name,
        "urdf": str(model.urdf),
        "base": _pose_entry(robot.base),
        "joints": list(model.joint_names),
        "tool": {
            "last_joint_T_flange": _pose_entry(model.flange),
            "flange_T_frame": {k: _pose_entry(p) for k, p in model.frames.items()},
        },
    }


def _pose_entry(pose: Transform) -> dict[str, list[float]]:
    return {"xyz": pose[:3, 3].tolist(), "quat_wxyz": quat_wxyz(pose).tolist()}

"""The folder of a run: made before planning starts, filled as results come."""

from __future__ import annotations

import hashlib
import json
import os
import platform
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from planning.cell.workcell import PlacedRobot, Workcell
from planning.errors import OutputError
from planning.transforms import Transform, quat_wxyz
from twin.host.atomic import write_json

MANIFEST = "manifest.json"
EVENTS = "events.jsonl"
TRAJECTORY = "trajectory.parquet"
OBJECTS = "objects.parquet"
RECORDING = "run.rrd"
GANTT = "gantt.png"
SUMMARY = "summary.json"
COMPARISON = "compare.json"
CHART = "compare.png"

_RESULTS = (
    EVENTS,
    TRAJECTORY,
    OBJECTS,
    RECORDING,
    GANTT,
    SUMMARY,
    COMPARISON,
    CHART,
)
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


def prepare_run_folder(out: Path | None, scenario_name: str) -> Path:
    """Return a folder that can be written to, made where it is missing.

    Called before anything that takes time, so that a long plan is not lost for want of a place
    to put it. Results of an earlier run in the folder are removed, plans are left.

    Args:
        out: the folder; by default ``logs/<scenario>-<UTC time>``.
        scenario_name: name of the scenario.

    Raises:
        OutputError: it cannot be made or written to.
    """
    folder = _new_log_folder(scenario_name) if out is None else out
    probe = folder / f".probe.{os.getpid()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe.write_bytes(b"")
        probe.unlink()
        for name in _RESULTS:
            (folder / name).unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written to: {error}") from error
    return folder


@contextmanager
def run_folder(out: Path | None, scenario_name: str) -> Iterator[Path]:
    """Give a folder for results, made as by prepare_run_folder.

    When the work in it fails before there is any result, a folder made for it goes again.
    """
    existed = out is not None and out.exists()
    folder = prepare_run_folder(out, scenario_name)
    try:
        yield folder
    except BaseException:
        if not existed:
            with suppress(OSError):
                folder.rmdir()
        raise


def _new_log_folder(scenario_name: str) -> Path:
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    first = Path("logs") / f"{scenario_name}-{stamp}"
    folder, count = first, 1
    while folder.exists():
        count += 1
        folder = first.with_name(f"{first.name}-{count}")
    return folder


def manifest(
    scenario: Mapping[str, Any],
    cell: Workcell,
    *,
    seed: int,
    run: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return what is needed to understand and repeat a run.

    Args:
        scenario: the resolved scenario, as plain JSON values.
        cell: built from it.
        seed: of the run.
        run: what else a run needs that is to be resumed.
    """
    about = {} if run is None else {"run": dict(run)}
    return {
        "scenario": dict(scenario),
        "scenario_sha256": scenario_sha256(scenario),
        "seed": seed,
        "versions": versions(),
        "robots": [_robot_entry(robot) for robot in cell.robots],
        **about,
    }


def write_manifest(
    folder: Path,
    scenario: Mapping[str, Any],
    cell: Workcell,
    *,
    seed: int,
    run: Mapping[str, Any] | None = None,
) -> None:
    """Write ``manifest.json`` into a run folder; see manifest."""
    write_json(folder / MANIFEST, manifest(scenario, cell, seed=seed, run=run))


def scenario_sha256(scenario: Mapping[str, Any]) -> str:
    """Return the hash of a resolved scenario: of its compact JSON with sorted keys."""
    text = json.dumps(scenario, sort_keys=True, separators=(",", ":"))
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

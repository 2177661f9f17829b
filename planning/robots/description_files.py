"""The files of a robot's description: their hash, and a copy that goes with a plan."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from xml.etree import ElementTree

from planning.cell.robot_model import RobotModel
from planning.errors import OutputError
from planning.files import is_file, read_file
from planning.robots.descriptions.mesh_files import find_mesh

_MESH_BYTES = 1 << 30
"""Bytes of a mesh of a description."""


def description_sha256(model: RobotModel) -> str | None:
    """Return a hash of a robot's URDF and of all meshes that it collides with.

    Returns:
        None where the description is not in files, or not there any more.
    """
    if not is_file(model.urdf):
        return None
    stamps = tuple(path.stat().st_mtime_ns for _, path in _meshes(model, "collision"))
    return _sha256(model, (model.urdf.stat().st_mtime_ns, *stamps))


@lru_cache(maxsize=64)
def _sha256(model: RobotModel, stamps: tuple[int, ...]) -> str:
    """Hash what the files hold; ``stamps`` makes an edited file be read anew."""
    digest = hashlib.sha256(read_file(model.urdf))
    for _, path in _meshes(model, "collision"):
        digest.update(hashlib.sha256(read_file(path, _MESH_BYTES)).digest())
    return digest.hexdigest()


def copy_description(model: RobotModel, folder: Path) -> Path:
    """Copy a robot's URDF and meshes to where they are found without the rest of the disk.

    Args:
        model: the robot, whose URDF stays as it is.
        folder: where the files go, made where it is missing.

    Returns:
        The copy of the URDF.

    Raises:
        OutputError: a file cannot be copied.
    """
    target = folder / model.urdf.name
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _copy(model.urdf, target)
        for name, path in _meshes(model, ""):
            place = folder / name
            # What is named by its place on this disk, or above the URDF, is not brought along.
            if place.resolve().is_relative_to(folder.resolve()):
                place.parent.mkdir(parents=True, exist_ok=True)
                _copy(path, place)
    except OSError as error:
        raise OutputError(f"{target}: cannot be written: {error}") from error
    return target


def _copy(source: Path, target: Path) -> None:
    if source.resolve() != target.resolve():
        shutil.copyfile(source, target)


def _meshes(model: RobotModel, purpose: str) -> Iterator[tuple[str, Path]]:
    """Yield the meshes of a description by their names without a scheme, each once."""
    root = ElementTree.fromstring(read_file(model.urdf))
    seen = set()
    for mesh in root.findall(f".//{purpose}//mesh" if purpose else ".//mesh"):
        name = mesh.get("filename", "")
        found = find_mesh(name, model.package_dirs)
        if found is not None and name not in seen:
            seen.add(name)
            yield name.removeprefix("file://").removeprefix("package://"), found

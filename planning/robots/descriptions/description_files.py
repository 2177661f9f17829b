"""Files of a robot description: hashes, copies for saved plans, and generated files."""

from __future__ import annotations

import atexit
import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from functools import cache, lru_cache
from hashlib import sha256
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from planning.cell.robot_model import RobotModel
from planning.errors import OutputError
from planning.files import is_file, read_file
from planning.robots.descriptions.xml_files import find_mesh

MESH_BYTES = 1 << 30
"""Largest size of a mesh file [bytes]."""


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
    """Return a hash of the contents of files; ``stamps`` invalidates the cache of an edited file."""
    digest = hashlib.sha256(read_file(model.urdf))
    for _, path in _meshes(model, "collision"):
        digest.update(hashlib.sha256(read_file(path, MESH_BYTES)).digest())
    return digest.hexdigest()


def copy_description(model: RobotModel, folder: Path) -> Path:
    """Copy a robot's URDF and meshes into a self-contained folder.

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


def store_description(root: Element, name: str) -> Path:
    """Write a description to a file named by its content, with its meshes next to it.

    Args:
        root: of a URDF whose meshes have absolute names; they are named again here.
        name: of the file, without a suffix.

    Returns:
        The file; it is gone when the program ends.
    """
    meshes: dict[str, str] = {}
    for mesh in root.iter("mesh"):
        source = mesh.get("filename", "")
        number = len(meshes)
        target = meshes.setdefault(source, f"meshes/{number:02d}-{Path(source).name}")
        mesh.set("filename", target)
    text = ElementTree.tostring(root)
    digest = sha256(text)
    for source in meshes:
        stat = os.stat(source)
        digest.update(f"{source} {stat.st_mtime_ns} {stat.st_size}".encode())
    folder = session_folder() / digest.hexdigest()[:16]
    path = folder / f"{name}.urdf"
    if not path.exists():
        (folder / "meshes").mkdir(parents=True, exist_ok=True)
        for source, target in meshes.items():
            _link(Path(source), folder / target)
        # Written last, and at once: who finds it finds its meshes too.
        draft = folder / f"{name}.{os.getpid()}"
        draft.write_bytes(text)
        draft.replace(path)
    return path


@cache
def session_folder() -> Path:
    """Return a temporary folder that exists as long as the program runs."""
    folder, owner = Path(tempfile.mkdtemp(prefix="assembly-twin-")), os.getpid()

    def remove() -> None:
        if os.getpid() == owner:  # a process that was forked has the same folder
            shutil.rmtree(folder, ignore_errors=True)

    atexit.register(remove)
    return folder


def _link(source: Path, target: Path) -> None:
    """Link a file to a second place, or copy it where the file system has no links."""
    try:
        target.symlink_to(source)
    except FileExistsError:
        return
    except OSError:
        shutil.copyfile(source, target)

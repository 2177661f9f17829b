"""Descriptions that are made here, kept in files as long as the program runs."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from functools import cache
from hashlib import sha256
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element


def keep_description(root: Element, name: str) -> Path:
    """Write a description to a file, with its meshes beside it; the same goes to the same file.

    Args:
        root: of a URDF whose meshes have absolute names; they are named anew here.
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
    folder = kept_folder() / digest.hexdigest()[:16]
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
def kept_folder() -> Path:
    """Return a folder that is there as long as the program runs."""
    folder, owner = Path(tempfile.mkdtemp(prefix="assembly-twin-")), os.getpid()

    def remove() -> None:
        if os.getpid() == owner:  # a process that was forked has the same folder
            shutil.rmtree(folder, ignore_errors=True)

    atexit.register(remove)
    return folder


def _link(source: Path, target: Path) -> None:
    """Put a file in a second place, without a copy where the file system can do that."""
    try:
        target.symlink_to(source)
    except FileExistsError:
        return
    except OSError:
        shutil.copyfile(source, target)

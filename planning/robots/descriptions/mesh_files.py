"""The files that the meshes of a description may be in."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from planning.files import is_file
from planning.packages import ros_folders

_ABOVE = 3
"""So many folders above that of a description are searched."""


def search_folders(path: Path, package_dirs: Sequence[Path] = ()) -> tuple[Path, ...]:
    """Return where the meshes of a description are looked up, its own folder first.

    Where ROS is set up, its packages are searched too.
    """
    above = list(path.resolve().parents)[1 : _ABOVE + 1]
    return tuple(dict.fromkeys((path.parent, *package_dirs, *above, *ros_folders())))


def find_mesh(name: str, dirs: Sequence[Path]) -> Path | None:
    """Return the first file that a mesh's name may mean, None where there is none."""
    bare = bare_name(name)
    places = (folder / bare for folder in dirs)  # an absolute path stays as it is
    return next((place for place in places if is_file(place)), None)


def find_mesh_of_package(name: str, dirs: Sequence[Path]) -> Path | None:
    """Return the file that a mesh's name may mean where its package's folder is called otherwise.

    A package that was downloaded is often in a folder such as ``arm_description-main``.
    """
    found = find_mesh(name, dirs)
    if found is None and name.startswith(("package://", "model://")):
        found = find_mesh(bare_name(name).partition("/")[2], dirs)
    return found


def bare_name(name: str) -> str:
    """Return the name of a mesh without the scheme in front of it."""
    for scheme in ("file://", "package://", "model://"):
        name = name.removeprefix(scheme)
    return name

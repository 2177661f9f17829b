"""Files by the names that ROS gives them, ``package://PACKAGE/PATH``: in packages of ROS and of Python."""

from __future__ import annotations

import os
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

from planning.errors import TwinError
from planning.files import is_file

SCHEME = "package://"


def file_named(name: str, folder: Path, error: type[TwinError]) -> Path:
    """Return the file that a name means: a path, or ``package://PACKAGE/PATH``.

    Args:
        name: as a user wrote it.
        folder: where relative paths start.
        error: what is raised.

    Raises:
        TwinError: of the class ``error``: there is no such package, or no such file in it.
    """
    if not name.startswith(SCHEME):
        return folder / name
    package, _, rest = name.removeprefix(SCHEME).partition("/")
    places = list(_package_folders(package))
    if not places:
        raise error(
            f"{name}: no package {package!r} is installed in this Python"
            " or found by ROS_PACKAGE_PATH or AMENT_PREFIX_PATH"
        )
    found = next((place / rest for place in places if is_file(place / rest)), None)
    if found is None:
        raise error(f"{name}: there is no file {rest!r} in {places[0]}")
    return found


def ros_folders() -> list[Path]:
    """Return the folders in which ROS has its packages, where it is set up."""
    ros = [Path(p) for p in os.environ.get("ROS_PACKAGE_PATH", "").split(":") if p]
    ament = os.environ.get("AMENT_PREFIX_PATH", "").split(":")
    return ros + [Path(prefix, "share") for prefix in ament if prefix]


def _package_folders(package: str) -> Iterator[Path]:
    yield from (f / package for f in ros_folders() if (f / package).is_dir())
    if package.isidentifier():  # a dot would import what is before it
        try:
            spec = find_spec(package)
        except (ImportError, ValueError):
            spec = None
        yield from map(Path, (spec and spec.submodule_search_locations) or ())

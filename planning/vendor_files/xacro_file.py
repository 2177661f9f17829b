"""Robot descriptions in xacro, expanded to XML by a process of its own."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from types import MappingProxyType
from xml.etree.ElementTree import Element

from planning.errors import FittingError, RobotModelError
from planning.files import is_file, ros_folders
from planning.robots.descriptions.description_files import store_description
from planning.robots.descriptions.mounting import write_mesh_paths
from planning.robots.descriptions.xml_files import (
    check_meshes,
    parse_xml,
    search_folders,
)
from planning.vendor_files.expand_xacro import CPU_S

_SUFFIX = ".xacro"

_PACKAGE = "package.xml"

_ABOVE = 6
"""Number of folders above a file in which its package is looked for."""

NO_ARGUMENTS: Mapping[str, str | float | bool] = MappingProxyType({})

_TIMEOUT_S = 3 * CPU_S

_PROGRAM = (
    "import sys; sys.path.insert(0, sys.argv[1]);"
    " from planning.vendor_files.expand_xacro import main; main()"
)
_ROOT = str(Path(__file__).parents[2])


def is_xacro(path: Path) -> bool:
    """Tell whether a file is xacro, by its name."""
    return path.suffix.lower() == _SUFFIX


def description_file(
    path: Path, arguments: Mapping[str, str | float | bool] = NO_ARGUMENTS
) -> Path:
    """Return a description as URDF or MJCF; arguments and errors are as of ``xacro_root``."""
    return stored_xacro(path, arguments) if is_xacro(path) else path


def xacro_root(path: Path, arguments: Mapping[str, str | float | bool]) -> Element:
    """Return a xacro file as XML, given its arguments by name.

    Raises:
        RobotModelError: it cannot be expanded; the message says why and in which file.
        FittingError: it lacks an argument.
    """
    if not is_file(path):
        raise RobotModelError(f"robot description {path} does not exist")
    given = tuple(sorted((name, _text(value)) for name, value in arguments.items()))
    return parse_xml(_expanded(path, path.stat().st_mtime_ns, given).encode(), path)


def stored_xacro(path: Path, arguments: Mapping[str, str | float | bool]) -> Path:
    """Return a URDF file with the content of a xacro file, and its meshes beside it.

    The file is gone when the program ends. Arguments and errors are as of ``xacro_root``.
    """
    root, dirs = xacro_root(path, arguments), search_folders(path)
    check_meshes(root, path, dirs)
    write_mesh_paths(root, dirs)
    return store_description(root, path.name.partition(".")[0])


def _text(value: str | float | bool) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _folders(path: Path) -> list[str]:
    """Return the folders below which a file may include others.

    That is the folder around its package, for other packages there, or its own folder; and packages of ROS.
    """
    above = path.parents[: _ABOVE + 1]
    packages = [folder for folder in above if is_file(folder / _PACKAGE)]
    own = packages[0].parent if packages else path.parent
    return [str(own), *map(str, packages[:1]), *map(str, ros_folders())]


@lru_cache(maxsize=32)
def _expanded(path: Path, stamp: int, arguments: tuple[tuple[str, str], ...]) -> str:
    """Return the text of an expanded file; ``stamp`` invalidates the cache of an edited file."""
    if find_spec("xacro") is None:
        raise RobotModelError(
            f"{path} needs the package xacro (pip install 'assembly-twin[xacro]'), or a URDF made of it"
            " (xacro robot.urdf.xacro > robot.urdf)"
        )
    question = {"path": str(path), "folders": _folders(path)}
    try:
        done = subprocess.run(
            [sys.executable, "-I", "-c", _PROGRAM, _ROOT],
            input=json.dumps(question | {"arguments": dict(arguments)}).encode(),
            capture_output=True,
            timeout=_TIMEOUT_S,
            check=True,
            env={},
        )
        answer = json.loads(done.stdout)
    except (subprocess.SubprocessError, ValueError):
        most = f"within {CPU_S} s and the memory that an expansion may take"
        raise RobotModelError(f"{path} cannot be expanded {most}") from None
    if "text" in answer:
        return str(answer["text"])
    file = answer.get("file", path.name)
    where = "" if file == path.name else f" ({file})"
    if name := answer.get("argument"):
        words = f"{path}{where} needs the argument {name!r}: give it with 'xacro'"
        raise FittingError(words, key="xacro")
    raise RobotModelError(f"{path}{where} cannot be expanded: {answer['error']}")

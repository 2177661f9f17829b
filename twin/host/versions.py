"""Versions of Python and of the packages that results depend on."""

from __future__ import annotations

import platform
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version

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


def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that results depend on."""
    return {"python": platform.python_version(), **versions_of(_PACKAGES)}


def versions_of(packages: Iterable[str]) -> dict[str, str]:
    """Return the versions of some packages."""
    found = {}
    for package in packages:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found

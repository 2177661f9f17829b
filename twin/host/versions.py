"""Versions of Python and of the packages that results depend on."""

from __future__ import annotations

import platform
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
    found = {"python": platform.python_version()}
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found

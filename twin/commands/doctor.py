"""``twin doctor``: versions, for bug reports, and what is missing."""

from __future__ import annotations

import os
import platform
import sys
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version

import typer

from twin.commands.options import AsJson
from twin.host.guard import COMPLETED, FAILED, guarded, print_json
from twin.host.silence import silenced

# Distribution and the module that proves it works.
PARTS = (
    ("assembly-twin", "twin"),
    ("numpy", "numpy"),
    ("scipy", "scipy"),
    ("numba", "numba"),
    ("simpy", "simpy"),
    ("networkx", "networkx"),
    ("pin", "pinocchio"),
    ("coal", "coal"),
    ("ompl", "ompl.geometric"),
    ("pulp", "pulp"),
    ("highspy", "highspy"),
    ("pybullet", "pybullet"),
    ("pyarrow", "pyarrow"),
    ("rerun-sdk", "rerun"),
    ("pydantic", "pydantic"),
    ("pyyaml", "yaml"),
    ("typer", "typer"),
    ("rich", "rich"),
    ("matplotlib", "matplotlib"),
)


@guarded
def doctor(as_json: AsJson = False) -> int:
    """Print versions for a bug report, and say what does not load."""
    found = {"python": platform.python_version(), "system": platform.platform()}
    found["processors"] = str(os.cpu_count())
    missing = {}
    for distribution, module in PARTS:
        try:
            with silenced():
                import_module(module)
            found[distribution] = _version(distribution)
        except Exception as error:  # a broken library may raise anything on import
            missing[distribution] = f"{type(error).__name__}: {error}"
    if as_json:
        print_json({"versions": found, "missing": missing})
        return FAILED if missing else COMPLETED
    for name, text in found.items():
        typer.echo(f"{name:<14} {text}")
    for name, text in missing.items():
        typer.echo(f"{name:<14} does not load: {text}")
    if "pybullet" in missing and sys.version_info >= (3, 12):
        typer.echo("PyBullet has ready-made packages for Python 3.11 only.")
    return FAILED if missing else COMPLETED


def _version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return "not installed as a package"

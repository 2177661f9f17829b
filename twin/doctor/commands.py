"""``twin doctor``: report about the installation, with versions, missing packages and the audit's collision engine."""

from __future__ import annotations

import os
import platform
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec

import typer

from twin.commands.options import AsJson
from twin.host.guard import ExitCode, guarded, print_json
from twin.registry import HOOKS

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
    ("pyarrow", "pyarrow"),
    ("rerun-sdk", "rerun"),
    ("pydantic", "pydantic"),
    ("pyyaml", "yaml"),
    ("typer", "typer"),
    ("rich", "rich"),
    ("matplotlib", "matplotlib"),
)


OPTIONAL = ("pybullet", "pybullet")
"""Distribution and module that the program can do without."""


@guarded
def doctor(as_json: AsJson = False) -> int:
    """Print versions for a bug report, packages that do not load, and the engine of the audit."""
    from planning.silence import silence_output

    found = {"python": platform.python_version(), "system": platform.platform()}
    found["processors"] = str(os.cpu_count())
    missing = {}
    for distribution, module in (*PARTS, OPTIONAL):
        try:
            with silence_output():
                import_module(module)
            found[distribution] = _version(distribution)
        except Exception as error:  # a broken library may raise anything on import
            if find_spec(module.partition(".")[0]) or (distribution, module) in PARTS:
                missing[distribution] = f"{type(error).__name__}: {error}"
    engine, hint = None, ""
    if "coal" not in missing and "audit engine" in HOOKS:
        engine, hint = HOOKS.load("audit engine")()
    if as_json:
        print_json({"versions": found, "missing": missing, "audit_engine": engine})
        return ExitCode.FAILED if missing else ExitCode.COMPLETED
    for name, text in found.items():
        typer.echo(f"{name:<14} {text}")
    for name, text in missing.items():
        typer.echo(f"{name:<14} does not load: {text}")
    if engine is not None:
        typer.echo(f"{'audit engine':<14} {engine}")
    if hint and OPTIONAL[0] not in found:
        typer.echo(hint)
    return ExitCode.FAILED if missing else ExitCode.COMPLETED


def _version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return "not installed as a package"

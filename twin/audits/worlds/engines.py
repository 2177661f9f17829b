"""Collision engines of the audit: coal finds violations, and PyBullet cross-checks them if it is installed."""

from __future__ import annotations

import sys
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Literal

from planning.errors import RequestError

if TYPE_CHECKING:  # libraries are loaded when they are needed
    from twin.audits.worlds.bullet_world import BulletWorld
    from twin.audits.worlds.world import AuditWorld

Engine = Literal["pybullet", "coal"]

ENGINES: tuple[Engine, ...] = ("pybullet", "coal")
"""What the audit can look with: ``pybullet`` is coal, and PyBullet at samples."""

INSTALL = "pip install 'assembly-twin[audit]'" + (
    "" if sys.version_info < (3, 12) else " (compiles it, with a C++ compiler)"
)
"""What installs PyBullet: there are ready-made packages for Python 3.11 only."""


def engine_named(name: str | None) -> Engine:
    """Return the engine with a given name; by default PyBullet if it is installed, else coal.

    Raises:
        RequestError: there is no such engine, or it is not installed.
    """
    if name is None:
        return "pybullet" if _loads_pybullet() is None else "coal"
    if name not in ENGINES:
        raise RequestError(f"audit: there is no engine {name!r}", choices=ENGINES)
    if name == "pybullet" and (why := _loads_pybullet()) is not None:
        raise RequestError(
            f"audit: PyBullet does not load ({why}); choose the engine coal, or {INSTALL}"
        )
    return name


def _loads_pybullet() -> str | None:
    """Return why PyBullet cannot be used, None where it can."""
    try:
        import twin.audits.worlds.bullet_world  # noqa: F401
    except Exception as error:  # a broken library may raise anything
        return f"{type(error).__name__}: {error}"
    return None


@cache
def engine_and_version(engine: Engine) -> str:
    """Return the name of an engine in reports: ``"coal 3.0.3, pybullet 3.2.7"``, or the first alone."""
    names = ("coal",) if engine == "coal" else ("coal", engine)
    return ", ".join(map(_with_version, names))


def _with_version(library: str) -> str:
    try:
        return f"{library} {version(library)}"
    except PackageNotFoundError:  # compiled into its place by hand
        return library


def second_world(world: AuditWorld, engine: Engine) -> BulletWorld | None:
    """Return the same cell in PyBullet, None for coal alone; to be closed after use.

    Raises:
        RobotModelError: a description cannot be read.
    """
    if engine == "coal":
        return None
    from twin.audits.worlds.bullet_world import BulletWorld

    return BulletWorld(world)

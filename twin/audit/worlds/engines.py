"""Which collision library the audit measures with: PyBullet where it is installed, else coal."""

from __future__ import annotations

import sys
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Literal

from planning.errors import RequestError

if TYPE_CHECKING:  # libraries are loaded when they are needed
    from planning.cell.workcell import Workcell
    from twin.audit.worlds.world import AuditWorld

Engine = Literal["pybullet", "coal"]

ENGINES: tuple[Engine, ...] = ("pybullet", "coal")
"""Libraries the audit can measure with, the stronger witness first."""

INSTALL = "pip install 'assembly-twin[audit]'" + (
    "" if sys.version_info < (3, 12) else " (compiles it, with a C++ compiler)"
)
"""What installs PyBullet: there are ready-made packages for Python 3.11 only."""


def engine_named(name: str | None) -> Engine:
    """Return the engine of a name; without one PyBullet where it is installed, else coal.

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
        import twin.audit.worlds.bullet_world  # noqa: F401
    except Exception as error:  # a broken library may raise anything
        return f"{type(error).__name__}: {error}"
    return None


@cache
def engine_and_version(engine: Engine) -> str:
    """Return an engine as reports name it: ``"coal 3.0.3"``."""
    try:
        return f"{engine} {version(engine)}"
    except PackageNotFoundError:  # compiled into its place by hand
        return engine


def open_world(cell: Workcell, engine: Engine | None = None) -> AuditWorld:
    """Return a cell loaded into an engine; close it after use.

    Args:
        cell: what to load: URDF files of robots, boxes for the rest.
        engine: by default PyBullet where it is installed, else coal.

    Raises:
        RequestError: the engine is not installed.
        RobotModelError: a description cannot be read.
    """
    if engine_named(engine) == "pybullet":
        from twin.audit.worlds.bullet_world import BulletWorld

        return BulletWorld(cell)
    from twin.audit.worlds.coal_world import CoalWorld

    return CoalWorld(cell)

"""Packages that only some of the program needs, and that are installed as extras."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from planning.errors import RequestError, TwinError


def extra_module(
    module: str,
    *,
    package: str,
    extra: str,
    needs: str,
    error: type[TwinError] = RequestError,
) -> Any:
    """Return a module of a package that is an extra.

    Args:
        module: its name.
        package: what is installed for it.
        extra: of this program that does so.
        needs: who needs it, for people, such as ``"a cluster"``.
        error: that is raised without it.

    Raises:
        TwinError: it is not installed; says what to do.
    """
    try:
        return import_module(module)
    except ImportError as missing:
        raise error(
            f"{needs} needs the package {package!r}: pip install 'assembly-twin[{extra}]'"
        ) from missing

"""Import of optional packages, which are installed as extras."""

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
    """Return a module of an optional package.

    Args:
        module: its name.
        package: the package to install.
        extra: of this program that does so.
        needs: the feature that needs it, for people, such as ``"a cluster"``.
        error: that is raised without it.

    Raises:
        TwinError: it is not installed; names the remedy.
    """
    try:
        return import_module(module)
    except ImportError as missing:
        raise error(
            f"{needs} needs the package {package!r}: pip install 'assembly-twin[{extra}]'"
        ) from missing

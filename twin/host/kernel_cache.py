"""Whether the compiled kernels are there already: the first run has to wait for them."""

from __future__ import annotations

from pathlib import Path

import planning


def kernels_are_cached() -> bool:
    """Tell whether every file with kernels has been compiled since it last changed.

    numba keeps an index file (``.nbi``) a function in ``__pycache__`` beside the source, or, where
    that cannot be written, in a folder of the user. Looking at the files needs no import of
    numba. A wrong answer costs nothing but the notice.
    """
    root = Path(planning.__file__).parent.parent
    sources = [
        path
        for package in ("planning", "scheduling", "twin")
        for path in (root / package).rglob("*.py")
        if b"\n@njit" in path.read_bytes()
    ]
    return all(_is_compiled(path) for path in sources)


def _is_compiled(source: Path) -> bool:
    folders = [source.parent / "__pycache__", *_elsewhere()]
    stamps = [
        index.stat().st_mtime
        for folder in folders
        for index in folder.rglob(f"{source.stem}.*.nbi")
    ]
    return bool(stamps) and max(stamps) >= source.stat().st_mtime


def _elsewhere() -> list[Path]:
    import os

    given = os.environ.get("NUMBA_CACHE_DIR")
    home = Path.home() / ".cache" / "numba"
    return [path for path in (Path(given) if given else home,) if path.is_dir()]

"""Caches of computed results, in memory or in the user's cache folder."""

from __future__ import annotations

import os
from collections.abc import Callable, Hashable, Mapping, Sequence
from contextlib import suppress
from functools import cache
from hashlib import sha256
from pathlib import Path
from time import perf_counter
from typing import Any, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from planning.errors import OutputError
from planning.files import LARGEST, NPZ_ERRORS, read_file, read_npz, replace_atomically

Arrays = Mapping[str, npt.NDArray[Any]]

LEAST_SECONDS_TO_CACHE = 0.1
"""Results computed in less time are not cached [s]."""

Result = TypeVar("Result")


def cache_folder(kind: str) -> Path:
    """Return the folder of the cached results of one kind."""
    named = os.environ.get("XDG_CACHE_HOME")
    return Path(named or Path.home() / ".cache") / "assembly-twin" / kind


def load_or_compute(
    kind: str,
    inputs: bytes,
    names: frozenset[str],
    find: Callable[[], Arrays],
    sources: Sequence[str],
) -> Arrays:
    """Return the cached result for some inputs, or compute and store it.

    A cache file that cannot be read, or that has other arrays, is ignored. If no file can be written, the result is
    computed again every time.

    Args:
        kind: of result: the name of a folder.
        inputs: all inputs of the computation, as bytes.
        names: of the arrays of a result.
        find: computes the result.
        sources: files with the code that the result depends on (``__file__`` of modules). Results of other versions
            of these files are not used.
    """
    key = sha256(inputs)
    for source in sources:
        key.update(_hash_of(source))
    file = cache_folder(kind) / f"{key.hexdigest()}.npz"
    with suppress(*NPZ_ERRORS):
        known = read_npz(read_file(file), kinds="if", most=LARGEST)
        if known.keys() == names:
            return known
    begin = perf_counter()
    found = find()
    if perf_counter() - begin >= LEAST_SECONDS_TO_CACHE:
        _write(file, found)
    return found


@cache
def _hash_of(source: str) -> bytes:
    """Return the hash of a source file, which does not change while it runs."""
    return sha256(Path(source).read_bytes()).digest()


def _write(file: Path, result: Arrays) -> None:
    arrays: dict[str, Any] = dict(result)
    with suppress(OSError, OutputError):
        file.parent.mkdir(parents=True, exist_ok=True)
        with replace_atomically(file) as part:
            np.savez_compressed(part, **arrays)


class BoundedCache(Generic[Result]):
    """In-memory cache by key, cleared when it is full.

    Args:
        most: greatest number of results that are kept.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._results: dict[Hashable, Result] = {}

    def get(self, key: Hashable, compute: Callable[[], Result]) -> Result:
        """Return the value of a key, computed if it is not cached."""
        known = self._results.get(key)
        if known is None:
            if len(self._results) >= self._most:
                self._results.clear()
            known = self._results[key] = compute()
        return known

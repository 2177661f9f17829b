"""Caches of computed answers: in memory while the program runs, or in the user's cache folder."""

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
"""Answers computed in less time are not cached [s]."""

Answer = TypeVar("Answer")


def cache_folder(kind: str) -> Path:
    """Return the folder of cached answers to one kind of question."""
    named = os.environ.get("XDG_CACHE_HOME")
    return Path(named or Path.home() / ".cache") / "assembly-twin" / kind


def load_or_compute(
    kind: str,
    question: bytes,
    names: frozenset[str],
    find: Callable[[], Arrays],
    sources: Sequence[str],
) -> Arrays:
    """Return the cached answer to a question, or compute and store it.

    A file that cannot be read, or that has other arrays, is one that is not there; where no file
    can be written, answers are computed again every time.

    Args:
        kind: of question: the name of a folder.
        question: all that is given to what finds the answer.
        names: of the arrays of an answer.
        find: returns the answer.
        sources: files with the code that decides the answer (``__file__`` of modules). What was
            found by them as they were before is no answer.
    """
    asked = sha256(question)
    for source in sources:
        asked.update(_hash_of(source))
    file = cache_folder(kind) / f"{asked.hexdigest()}.npz"
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


def _write(file: Path, answer: Arrays) -> None:
    arrays: dict[str, Any] = dict(answer)
    with suppress(OSError, OutputError):
        file.parent.mkdir(parents=True, exist_ok=True)
        with replace_atomically(file) as part:
            np.savez_compressed(part, **arrays)


class BoundedCache(Generic[Answer]):
    """In-memory cache by key, cleared when it is full.

    Args:
        most: how many are kept.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._answers: dict[Hashable, Answer] = {}

    def get(self, question: Hashable, work_out: Callable[[], Answer]) -> Answer:
        """Return the value of a key, computed if it is not cached."""
        known = self._answers.get(question)
        if known is None:
            if len(self._answers) >= self._most:
                self._answers.clear()
            known = self._answers[question] = work_out()
        return known

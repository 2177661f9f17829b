"""Files of a run as they were written: their hashes in the summary, and the check against them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path

from planning.errors import OutputError
from planning.files import read_file
from twin.run.folder import EVENTS, OBJECTS, SUMMARY, TRAJECTORY

PLAN_FILES = ("plan.json", "plan.npz")
_READ_BACK = (*PLAN_FILES, EVENTS, TRAJECTORY, OBJECTS)


def hashes_as_written(folder: Path) -> dict[str, str]:
    """Return the sha256 of each file of a run that commands read back, by its name.

    Raises:
        OutputError: a file cannot be read.
    """
    return {name: _sha256(folder / name) for name in _READ_BACK}


def require_as_written(folder: Path, names: Iterable[str]) -> None:
    """Refuse files of a run that are not those that its summary was made with.

    A folder without a summary, as a killed run leaves, has nothing to compare with.

    Args:
        folder: of the run.
        names: files that are about to be read.

    Raises:
        OutputError: a file has changed, is of another run, or cannot be read.
    """
    path = folder / SUMMARY
    try:
        files = json.loads(read_file(path)).get("files", {})
    except FileNotFoundError:
        return
    except (OSError, ValueError, RecursionError, AttributeError) as error:
        raise OutputError(f"{path}: no summary of a run: {error!r}") from error
    for name in names:
        if name in files and files[name] != _sha256(folder / name):
            raise OutputError(
                f"{folder / name} is not as the run wrote it: its sha256 is not the one in {SUMMARY}"
            )


def _sha256(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise OutputError(f"{path}: cannot be read: {error}") from error

"""Run folder: file names, hashes, a lock for the process that writes, and replacement of old results."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from os import PathLike
from pathlib import Path

from planning.errors import OutputError, RequestError
from planning.files import open_regular, read_object, require_own_files

EVENTS = "events.jsonl"
TRAJECTORY = "trajectory.parquet"
OBJECTS = "objects.parquet"
RECORDING = "run.rrd"
GANTT = "gantt.png"
PRODUCTS = "products.png"
SUMMARY = "summary.json"
TURNS = "in-turns"
"""Folder of the plan in turns, where another plan was made of it."""

FIRST = "first-plan"
"""Folder of the plan with which an operation began."""

VERSIONS = "versions"
"""Folder of the plans that took the place of that one, each in a folder named by its number, from 2."""

_RESULTS = (
    *(TURNS, FIRST, VERSIONS, "manifest.json", "plan.json", "plan.npz"),
    *(EVENTS, TRAJECTORY, OBJECTS, RECORDING, GANTT, PRODUCTS, "measured.csv"),
    *(SUMMARY, "compare.json", "compare.png"),
)
_LAST = (SUMMARY, "compare.json")  # written when all else has been

# Earlier results while new ones are made. They are whole in .before only: a process that is
# killed while moving them leaves .aside, from which all are restored.
_ASIDE, _BEFORE, _GONE = ".aside", ".before", ".gone"

LARGEST_RESULT = 1 << 30
"""Most bytes of a file of a run that is read back."""

PLAN_FILES = ("plan.json", "plan.npz")
_READ_BACK = (*PLAN_FILES, EVENTS, TRAJECTORY, OBJECTS)


@contextmanager
def run_folder(out: str | PathLike[str] | None, name: str) -> Iterator[Path]:
    """Create and lock a folder for results.

    Called before anything that takes time, so that a long plan is not lost for want of a place
    to put it. Results of an earlier run stay there until ``set_aside_results``, and come back when the
    work ends with an error. A folder made for work that leaves nothing goes again.

    Args:
        out: the folder; by default ``logs/<name>-<UTC time>``.
        name: of the scenario.

    Raises:
        OutputError: it cannot be made or written to, or another process writes to it.
        RequestError: it holds a study.
    """
    made = out is None or not os.path.lexists(out)
    folder = prepare_run_folder(out, name)
    if (folder / "blocks").is_dir():
        raise RequestError(f"{folder} holds a study: give another folder")
    with lock_folder(folder):
        recover_folder(folder)
        try:
            yield folder
        except BaseException:
            with suppress(OSError):
                recover_folder(folder)
                if made:
                    folder.rmdir()
            raise


def prepare_run_folder(out: str | PathLike[str] | None, name: str) -> Path:
    """Return a writable folder, created if missing.

    Args:
        out: the folder; by default ``logs/<name>-<UTC time>``.
        name: of the scenario.

    Raises:
        OutputError: it cannot be made or written to.
    """
    folder = _new_log_folder(name) if out is None else Path(out)
    probe = folder / f".probe.{os.getpid()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe.write_bytes(b"")
        probe.unlink()
    except (OSError, ValueError) as error:
        raise OutputError(f"{folder}: cannot be written to: {error}") from error
    return folder


@contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Lock a folder against other writers, at most until this process ends.

    Where a file system or an operating system knows no locks nothing is done.

    Raises:
        OutputError: another process writes to it, or it is not there.
    """
    try:
        import fcntl
    except ImportError:
        yield
        return
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be opened: {error.strerror}") from error
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise OutputError(
                f"{folder}: a running process writes its results there; give another folder,"
                " or wait for its end"
            ) from None
        except OSError:
            pass
        yield
    finally:
        os.close(handle)


def set_aside_results(folder: Path) -> None:
    """Move earlier results away, until ``drop_earlier_results`` or ``recover_folder``.

    Raises:
        OutputError: they cannot be moved.
    """
    there = [name for name in _RESULTS if (folder / name).exists()]
    if not there:
        return
    try:
        (folder / _ASIDE).mkdir()
        for name in there:
            (folder / name).replace(folder / _ASIDE / name)
        (folder / _ASIDE).replace(folder / _BEFORE)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written to: {error}") from error


@contextmanager
def replace_results(folder: Path) -> Iterator[None]:
    """Keep earlier results while new ones are made, and drop them when those are complete."""
    set_aside_results(folder)
    yield
    drop_earlier_results(folder)


def drop_earlier_results(folder: Path) -> None:
    """Drop the earlier results after the new ones are complete."""
    with suppress(FileNotFoundError):
        (folder / _BEFORE).replace(folder / _GONE)
    shutil.rmtree(folder / _GONE, ignore_errors=True)


def recover_folder(folder: Path) -> None:
    """Clean up after a killed process: remove partial files, restore earlier results.

    Only called while the folder is locked.
    """
    shutil.rmtree(folder / _GONE, ignore_errors=True)
    for name in (TURNS, _BEFORE, _ASIDE):
        if (folder / name).is_symlink():
            raise OutputError(
                f"{folder / name}: is a symbolic link; it is no work of this program"
            )
    for place in (folder, folder / TURNS):
        for part in place.glob(".*.part*"):
            part.unlink(missing_ok=True)
    if (folder / _BEFORE).is_dir():
        if any((folder / name).exists() for name in _LAST):
            drop_earlier_results(folder)
            return
        for name in (TURNS, FIRST, VERSIONS):
            shutil.rmtree(folder / name, ignore_errors=True)
        for name in _RESULTS:
            (folder / name).unlink(missing_ok=True)
        (folder / _BEFORE).replace(folder / _ASIDE)
    if (folder / _ASIDE).is_dir():
        for path in (folder / _ASIDE).iterdir():
            path.replace(folder / path.name)
        (folder / _ASIDE).rmdir()


def _new_log_folder(name: str) -> Path:
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    first = Path("logs") / f"{name}-{stamp}"
    folder, count = first, 1
    while folder.exists():
        count += 1
        folder = first.with_name(f"{first.name}-{count}")
    return folder


def recorded_hashes(folder: Path) -> dict[str, str]:
    """Return the sha256 of each file of a run that commands read, by name.

    Raises:
        OutputError: a file cannot be read.
    """
    return {name: _sha256(folder / name) for name in _READ_BACK}


def require_recorded_hashes(folder: Path, names: Iterable[str]) -> None:
    """Refuse files of a run that differ from those of its summary.

    A folder without a summary, as a killed run leaves, has nothing to compare with.

    Args:
        folder: of the run.
        names: files that are about to be read.

    Raises:
        OutputError: a file has changed, is of another run, or cannot be read.
    """
    path, names = folder / SUMMARY, tuple(names)
    require_own_files(folder, (SUMMARY, *names))
    if not path.exists():
        return
    files = read_object(path, "summary of a run").get("files", {})
    try:
        asked = {name: files[name] for name in names if name in files}
    except TypeError as error:
        raise OutputError(f"{path}: no summary of a run: {error!r}") from error
    for name, digest in asked.items():
        path = folder / name
        if path.is_file() and path.stat().st_size > LARGEST_RESULT:
            raise OutputError(f"{path}: larger than {LARGEST_RESULT >> 20} MiB")
        if digest != _sha256(folder / name):
            raise OutputError(
                f"{folder / name} is not as the run wrote it: its sha256 is not the one in {SUMMARY}"
            )


def _sha256(path: Path) -> str:
    try:
        with open_regular(path) as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise OutputError(f"{path}: cannot be read: {error}") from error

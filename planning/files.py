"""File access: bounded reads, ``package://`` names, and atomic writes."""

from __future__ import annotations

import errno
import os
import stat
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec
from io import BufferedReader, BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy

from planning.errors import OutputError, TwinError
from planning.json_files import parse_json

_PIECE = 1 << 20
"""Block size of reads in bytes: growth of a file is noticed after each block."""

LARGEST = 64 << 20
"""Most bytes that a file of settings or of a robot is believed to have."""

_STDIN, _HANDLES = Path("/dev/stdin"), (Path("/dev/fd"), Path("/proc/self/fd"))

_MOST_ARRAYS = 200_000
"""Most arrays of an npz file."""

_ENTRY_MARK = b"PK\x01\x02"
"""What an entry of the directory of a zip file begins with."""

NPZ_ERRORS = (
    *(OSError, ValueError, KeyError, TypeError, IndexError, EOFError, MemoryError),
    *(NotImplementedError, RuntimeError, zipfile.BadZipFile, zlib.error),
)
"""Whatever zipfile and numpy raise for bytes that are no npz file of some known arrays."""

_SCHEME = "package://"


def open_regular(path: Path) -> BufferedReader:
    """Open a regular file, or a pipe that the shell hands over, for reading.

    Named pipes, which would be waited for, and devices are errors of the operating system.

    Raises:
        OSError: it cannot be opened, or is no regular file; ``strerror`` says why.
    """
    # Opening a named pipe waits for whoever writes to it, unless told not to.
    try:
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    except ValueError as error:  # a NUL in the path
        raise OSError(errno.EINVAL, str(error)) from None
    try:
        mode = os.fstat(handle).st_mode
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        handed = path == _STDIN or path.parent in _HANDLES
        if stat.S_ISFIFO(mode) and handed:
            os.set_blocking(handle, True)
        elif not stat.S_ISREG(mode):
            raise OSError(errno.EINVAL, "is no regular file")
        return os.fdopen(handle, "rb")
    except BaseException:
        os.close(handle)
        raise


def read_file(path: Path, most: int = LARGEST) -> bytes:
    """Return the content of a file.

    Devices and named pipes, paths that no file system takes and files of a size that makes no
    sense are errors of the operating system like others.

    Args:
        path: the file.
        most: bytes that it may have.

    Raises:
        OSError: it cannot be read, or is larger; ``strerror`` says why.
    """
    with open_regular(path) as file:
        # By pieces: a read of so many bytes takes as much memory before there is any.
        pieces, left = [], most + 1
        while left > 0 and (piece := file.read(min(left, _PIECE))):
            pieces.append(piece)
            left -= len(piece)
    if left <= 0:
        raise OSError(errno.EMSGSIZE, f"larger than {most >> 20} MiB")
    return b"".join(pieces)


def read_object(path: Path, what: str) -> dict[str, Any]:
    """Return the object of a JSON file.

    Args:
        path: the file.
        what: what it should be, for messages: ``summary of a run``.

    Raises:
        OutputError: it cannot be read, is no JSON of bounded size, or holds no object.
    """
    try:
        found = parse_json(read_file(path))
    except FileNotFoundError as error:
        raise OutputError(f"{path}: no {what}: there is none") from error
    except (OSError, ValueError) as error:
        raise OutputError(f"{path}: no {what}: {error}") from error
    if not isinstance(found, dict):
        raise OutputError(f"{path}: no {what}: an object was expected")
    return found


def require_own_files(folder: Path, names: Iterable[str]) -> None:
    """Check that a folder contains only files and folders, none of them linked elsewhere.

    A folder may come from someone else: through a symbolic link that leads out of it other files
    would be read, written to or moved, and a named pipe would be waited for.

    Args:
        folder: of results; it may be a symbolic link itself.
        names: files in it, and folders of which everything is looked at.

    Raises:
        OutputError: there is such a file; the message names it.
    """
    root, left = folder.resolve(), [folder / name for name in names]
    while left:
        path = left.pop()
        try:
            linked = path.is_symlink()
            if linked and not path.resolve().is_relative_to(root):
                raise OutputError(
                    f"{path}: is a symbolic link that leads out of {folder}"
                )
            mode = path.stat().st_mode
            if stat.S_ISDIR(mode) and not linked:
                left += path.iterdir()
            elif not stat.S_ISREG(mode):
                raise OutputError(f"{path}: is no regular file")
        except (FileNotFoundError, NotADirectoryError):
            continue
        except (OSError, RuntimeError) as error:  # a link to itself
            raise OutputError(f"{path}: cannot be read: {error}") from error


def read_npz(content: bytes, *, kinds: str, most: int) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of an npz file; their size is checked before memory is allocated.

    Args:
        content: of the file.
        kinds: kinds of numpy's types that arrays may have.
        most: bytes that all of them may take.

    Raises:
        ValueError: they are too large, or of another kind.
        Exception: of NPZ_ERRORS: it is no npz file.
    """
    size = 0
    if content.count(_ENTRY_MARK) > _MOST_ARRAYS:  # zipfile reads all entries at once
        raise ValueError(f"it has more than {_MOST_ARRAYS} arrays")
    with zipfile.ZipFile(BytesIO(content)) as archive:
        items = archive.infolist()
        if len({item.filename for item in items}) < len(items):
            raise ValueError("an array is given twice")
        for item in items:
            with archive.open(item) as file:
                version = npy.read_magic(file)
                read = (
                    npy.read_array_header_1_0
                    if version == (1, 0)
                    else npy.read_array_header_2_0
                )
                shape, _, dtype = read(file)
            if dtype.kind not in kinds:
                raise ValueError(f"{item.filename} holds {dtype}")
            bytes_there = int(np.prod(shape, dtype=object)) * dtype.itemsize
            size += max(item.file_size, bytes_there)
            if size > most:
                raise ValueError(f"its arrays take more than {most >> 20} MiB")
    with np.load(BytesIO(content), allow_pickle=False) as loaded:
        return {name: loaded[name] for name in loaded.files}


def is_file(path: Path) -> bool:
    """Tell whether a file exists; False for paths that no file system accepts."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


@contextmanager
def replace_atomically(path: Path) -> Iterator[Path]:
    """Provide a temporary path next to ``path`` to write to, and rename it at the end.

    When writing fails the temporary file goes and what was at ``path`` stays.

    Raises:
        OutputError: the file system refuses.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part{path.suffix}")
    try:
        yield temporary
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error}") from error
    finally:
        temporary.unlink(missing_ok=True)


def digest_parts(arrays: Mapping[str, npt.NDArray[Any]]) -> Iterator[bytes]:
    """Yield the bytes to hash for named arrays: names, types, shapes and contents."""
    for name in sorted(arrays):
        yield f"{name} {arrays[name].dtype} {arrays[name].shape}".encode()
        yield np.ascontiguousarray(arrays[name]).tobytes()


def resolve_file_name(name: str, folder: Path, error: type[TwinError]) -> Path:
    """Return the file that a name means: a path, or ``package://PACKAGE/PATH``.

    Args:
        name: as a user wrote it.
        folder: where relative paths start.
        error: what is raised.

    Raises:
        TwinError: of the class ``error``: there is no such package, or no such file in it.
    """
    if not name.startswith(_SCHEME):
        return folder / name
    package, _, rest = name.removeprefix(_SCHEME).partition("/")
    places = list(_package_folders(package))
    if not places:
        raise error(
            f"{name}: no package {package!r} is installed in this Python"
            " or found by ROS_PACKAGE_PATH or AMENT_PREFIX_PATH"
        )
    found = next((place / rest for place in places if is_file(place / rest)), None)
    if found is None:
        raise error(f"{name}: there is no file {rest!r} in {places[0]}")
    return found


def ros_folders() -> list[Path]:
    """Return the ROS package folders, where ROS is set up."""
    ros = [Path(p) for p in os.environ.get("ROS_PACKAGE_PATH", "").split(":") if p]
    ament = os.environ.get("AMENT_PREFIX_PATH", "").split(":")
    return ros + [Path(prefix, "share") for prefix in ament if prefix]


def _package_folders(package: str) -> Iterator[Path]:
    yield from (f / package for f in ros_folders() if (f / package).is_dir())
    if package.isidentifier():  # a dot would import what is before it
        try:
            spec = find_spec(package)
        except (ImportError, ValueError):
            spec = None
        yield from map(Path, (spec and spec.submodule_search_locations) or ())

"""Conversion of STEP files to triangles by the CAD kernel, in a process with limits of time and memory."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from planning.cad import convert_step
from planning.cad.step_text import check_step_text, circle_of_entities
from planning.errors import RequestError
from planning.files import read_file

MOST_BYTES = 64 << 20
"""Greatest size of a file [B]."""

_MEMORY = 4 << 30
"""Most memory of the process [B]."""

_SECONDS, _SECONDS_PER_MIB = 30, 4
"""Most time of the processor: this, and for each MiB of the file this [s]."""

_WAIT = 10
"""So many times longer is waited for, where other processes use the processor as well."""

_LARGEST_GLB = 512 << 20
"""Greatest size of the triangles [B]."""

_SYNTAX = re.compile(
    r"Line (\d+): (Incorrect syntax: [^*\n]+?)\s*(?:\*|$)", re.MULTILINE
)
"""Message of the kernel's reader; its lines begin with 2."""

_FAILS = re.compile(r"Incorrect Syntax : Fails Count : (\d+)")
"""Message of the kernel's reader about entities that it leaves out."""


def triangulate_step(path: Path, deviation: float) -> bytes:
    """Return the bodies of a STEP file as GLB, lengths in metres.

    Args:
        path: the file.
        deviation: greatest distance of the triangles from round surfaces [m].

    Raises:
        RequestError: the file cannot be read, is not valid, or needs more time or memory than there is.
    """
    content = _read(path)
    check_step_text(path, content)
    with TemporaryDirectory() as folder:
        target = Path(folder) / "bodies.glb"
        seconds = _SECONDS + _SECONDS_PER_MIB * (len(content) >> 20)
        limits = (_MEMORY, seconds, _LARGEST_GLB)
        command = [sys.executable, "-P", convert_step.__file__, str(target)]
        try:
            done = subprocess.run(
                [*command, repr(deviation * 1e3), *map(str, limits)],
                input=content,
                capture_output=True,
                timeout=_WAIT * seconds,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise RequestError(f"{path}: {_too_long(seconds)}") from None
        said = (done.stdout + b"\n" + done.stderr).decode("utf-8", "replace")
        if done.returncode != 0 and not _SYNTAX.search(said):
            reason = _reason(done.returncode, said, seconds)
            raise RequestError(f"{_place_of_circle(path, content)}: {reason}")
        found = target.read_bytes() if target.exists() else b""
    if not found or _SYNTAX.search(said) or _FAILS.search(said):
        raise RequestError(_refusal(path, content, said))
    return found


def place_of_circle(path: Path) -> str:
    """Return a file, with line and entity where one refers to itself."""
    return _place_of_circle(path, _read(path))


def _place_of_circle(path: Path, content: bytes) -> str:
    """Return the file, with line and entity where one refers to itself."""
    circle = circle_of_entities(content)
    return str(path) if circle is None else f"{path}:{circle}"


def _read(path: Path) -> bytes:
    if path.is_dir():
        raise RequestError(f"{path}: this is a folder, a STEP file is expected")
    try:
        return read_file(path, MOST_BYTES)
    except FileNotFoundError:
        raise RequestError(f"{path}: no such file") from None
    except OSError as error:
        raise RequestError(f"{path}: cannot be read: {error.strerror}") from None


def _too_long(seconds: int) -> str:
    return f"the CAD kernel takes more than {seconds} s for it: export fewer or simpler bodies"


def _reason(code: int, said: str, seconds: int) -> str:
    """Return in words why the process ended with an exit code."""
    if code == convert_step.NO_MEMORY or "bad_alloc" in said or "MemoryError" in said:
        return (
            f"the CAD kernel takes more than {_MEMORY >> 30} GiB of memory for it: export"
            " fewer or simpler bodies"
        )
    names = {int(number): number.name for number in signal.Signals}
    name = names.get(-code, "")
    if name in ("SIGXCPU", "SIGKILL"):
        return _too_long(seconds)
    if name == "SIGXFSZ":
        return f"its triangles take more than {_LARGEST_GLB >> 20} MiB: export simpler bodies"
    last = next((line for line in reversed(said.splitlines()) if line.strip()), "")
    how = name or f"exit code {code}" + (f": {last[:200]}" if last else "")
    return (
        f"the CAD kernel crashed on it ({how}): the file is not valid; export it again"
    )


def _refusal(path: Path, content: bytes, said: str) -> str:
    """Return in words why the kernel found nothing."""
    syntax = _SYNTAX.search(said)
    if syntax is not None:
        return f"{path}:{max(int(syntax[1]) - 1, 1)}:1: {syntax[2]}"
    fails = _FAILS.search(said)
    if fails is not None:
        return f"{path}: the CAD kernel cannot read {fails[1]} of its entities: export it again"
    place = _place_of_circle(path, content)
    return f"{place}: no bodies: it has no shapes that the CAD kernel can read"

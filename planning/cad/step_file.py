"""Reading of STEP files as the bodies of an assembly.

The CAD kernel converts them to triangles, in a process with limits of time and memory.
"""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from planning.bounds import LARGEST_M
from planning.cad import convert_step
from planning.cad.glb_bodies import read_bodies
from planning.cad.part_types import PartType, sort_by_shape
from planning.cad.step_text import check_step_text, place_of_circle
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


_SIMPLER = "export fewer or simpler bodies"


_DEVIATIONS = (1e-5, 5e-5, 2e-4)
"""Distances of triangles from round surfaces that are tried, until no body has too many triangles [m]."""

_MOST_TRIANGLES = 100_000
"""Most triangles of a body: more are refused of meshes that are not convex."""


def read_assembly(file: Path) -> tuple[list[PartType], list[str]]:
    """Return the types of the bodies of a STEP file, and notes.

    Raises:
        RequestError: it cannot be used.
    """
    notes: list[str] = []
    for deviation in _DEVIATIONS:
        content = triangulate_step(file, deviation)
        try:
            bodies, notes = read_bodies(content)
        except RequestError as error:
            raise RequestError(f"{file}: {error.message}") from None
        most = max((len(body.faces) for body in bodies), default=0)
        if most <= _MOST_TRIANGLES:
            break
    else:
        words = f"a body has {most} triangles, more than {_MOST_TRIANGLES}"
        raise RequestError(f"{file}: {words}: simplify it")
    if deviation > _DEVIATIONS[0]:
        notes.append(f"round surfaces are met to within {deviation * 1e3:g} mm")
    if not bodies:
        found = "; ".join(notes) or "it has no shapes"
        place = place_of_circle(file, _read(file))
        raise RequestError(f"{place}: no solid bodies: {found}")
    if len(bodies) < 2:
        words = "it has one body, and an assembly has two or more"
        raise RequestError(f"{file}: {words}: export the assembly, not a part")
    types = sort_by_shape(bodies)
    points = np.vstack([p.vertices for own in types for p in own.placed])
    if np.abs(points).max() > LARGEST_M:
        words = f"it reaches beyond {LARGEST_M} m: look at its units"
        raise RequestError(f"{file}: {words}")
    return types, notes


def triangulate_step(path: Path, deviation: float) -> bytes:
    """Return the bodies of a STEP file as GLB, in metres, with triangles within a deviation from round surfaces [m].

    Raises:
        RequestError: the file cannot be read, is not valid, or needs more time or memory than there is.
    """
    content = _read(path)
    check_step_text(path, content)
    seconds = _SECONDS + _SECONDS_PER_MIB * (len(content) >> 20)
    with TemporaryDirectory() as folder:
        target = Path(folder) / "bodies.glb"
        given = (target, deviation * 1e3, _MEMORY, seconds, _LARGEST_GLB)
        try:
            done = subprocess.run(
                [sys.executable, "-P", convert_step.__file__, *map(str, given)],
                input=content,
                capture_output=True,
                timeout=_WAIT * seconds,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise RequestError(f"{path}: {_too_long(seconds)}") from None
        found = target.read_bytes() if target.exists() else b""
    said = (done.stdout + b"\n" + done.stderr).decode("utf-8", "replace")
    if syntax := _SYNTAX.search(said):
        line = max(int(syntax[1]) - 1, 1)
        raise RequestError(f"{path}:{line}:1: {syntax[2]}")
    if done.returncode != 0:
        reason = _reason(done.returncode, said, seconds)
    elif fails := _FAILS.search(said):
        words = f"the CAD kernel cannot read {fails[1]} of its entities"
        raise RequestError(f"{path}: {words}: export it again")
    elif not found:
        reason = "no bodies: it has no shapes that the CAD kernel can read"
    else:
        return found
    raise RequestError(f"{place_of_circle(path, content)}: {reason}")


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
    return f"the CAD kernel takes more than {seconds} s for it: {_SIMPLER}"


def _reason(code: int, said: str, seconds: int) -> str:
    """Return in words why the process ended with an exit code."""
    if code == convert_step.NO_MEMORY or "bad_alloc" in said or "MemoryError" in said:
        most = f"{_MEMORY >> 30} GiB of memory"
        return f"the CAD kernel takes more than {most} for it: {_SIMPLER}"
    name = next((own.name for own in signal.Signals if own == -code), "")
    if name in ("SIGXCPU", "SIGKILL"):
        return _too_long(seconds)
    if name == "SIGXFSZ":
        return f"its triangles take more than {_LARGEST_GLB >> 20} MiB: {_SIMPLER}"
    last = said.strip().rpartition("\n")[2].strip()[:200]
    how = name or f"exit code {code}" + (f": {last}" if last else "")
    words = f"the CAD kernel crashed on it ({how})"
    return f"{words}: the file is not valid; export it again"

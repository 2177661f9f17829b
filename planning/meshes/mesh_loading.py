"""Loading of mesh files: their triangles, and their convex pieces, which are cached on disk."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from hashlib import sha256
from pathlib import Path

import numpy as np

from planning.caches import Arrays, BoundedCache, load_or_compute
from planning.cell import cover
from planning.cell.shape import Mesh
from planning.errors import ShapeError
from planning.meshes import convex_pieces, holes, mesh_file, prisms
from planning.meshes.convex_pieces import Cut, TooManyPiecesError, cut_convex
from planning.meshes.mesh_file import MeshTriangles, read_mesh_bytes, read_triangles
from planning.transforms import read_only_copy

_SOURCES = (
    __file__,
    mesh_file.__file__,
    convex_pieces.__file__,
    prisms.__file__,
    holes.__file__,
    cover.__file__,
)

_MOST_PIECES = 64
"""Greatest number of pieces of a non-prismatic body if no ``within`` is given and a coarser share is left to try."""

_FILLED_SHARES = (1.0 / 60.0, 1.0 / 20.0)
"""Depth of the hollows that convex pieces may fill by default, as a share of the mesh's longest edge: the second one
if the first would need too many pieces."""


_LOADED: BoundedCache[Mesh] = BoundedCache(64)

_SLOW_TO_CUT = 2000
"""A mesh with more triangles takes some seconds to cut into pieces."""

_LISTENER: ContextVar[Callable[[Path], None] | None] = ContextVar(
    "listener", default=None
)
_NAMES = frozenset({"counts", "corners", "centre", "numbers"})


@contextmanager
def watch_cutting(begin: Callable[[Path], None]) -> Iterator[None]:
    """Within the context, call a function with each large mesh file before its decomposition, if it is not cached."""
    token = _LISTENER.set(begin)
    try:
        yield
    finally:
        _LISTENER.reset(token)


def load_mesh(
    path: Path, scale: float | None = None, within: float | None = None
) -> Mesh:
    """Return the triangles and convex pieces of a mesh file.

    Args:
        path: of an STL or OBJ file.
        scale: factor to metres; None for 1, which is refused if the size is then implausible.
        within: greatest depth of a hollow that a convex piece may fill [m]; None for a sixtieth of the longest edge,
            or a twentieth if that would need too many pieces.

    Raises:
        ShapeError: the file cannot be used; the message says what to do.
    """
    content = read_mesh_bytes(path)
    key = path, sha256(content).hexdigest(), scale, within
    return _LOADED.get(key, lambda: _load(*key, content))


def _load(
    path: Path, sha: str, scale: float | None, within: float | None, content: bytes
) -> Mesh:
    triangles = read_triangles(path, content, scale)
    settings = f"{sha} {path.suffix.lower()} {scale} {within}".encode()

    def find() -> Arrays:
        listener = _LISTENER.get()
        if listener is not None and len(triangles.faces) > _SLOW_TO_CUT:
            listener(path)
        return _arrays(_cut(triangles, within))

    try:
        cut = _cut_of(load_or_compute("convex", settings, _NAMES, find, _SOURCES))
    except ShapeError as error:
        raise ShapeError(f"mesh {path}: {error.message}") from None
    return Mesh(
        read_only_copy(triangles.vertices),
        triangles.faces,
        tuple(read_only_copy(hull) for hull in cut.hulls),
        cut.volume,
        read_only_copy(cut.centre),
        cut.missed,
        str(path),
    )


def _cut(triangles: MeshTriangles, within: float | None) -> Cut:
    """Return the convex pieces of a mesh, with the requested or the default accuracy."""
    if within is not None:
        return cut_convex(triangles, within)
    longest = float(np.ptp(triangles.vertices, axis=0).max())
    for share in _FILLED_SHARES[:-1]:
        with suppress(TooManyPiecesError):
            return cut_convex(triangles, share * longest, _MOST_PIECES)
    return cut_convex(triangles, _FILLED_SHARES[-1] * longest)


def _arrays(cut: Cut) -> Arrays:
    return {
        "counts": np.array([len(hull) for hull in cut.hulls]),
        "corners": np.vstack(cut.hulls),
        "centre": cut.centre,
        "numbers": np.array([cut.volume, cut.missed]),
    }


def _cut_of(arrays: Arrays) -> Cut:
    hulls = tuple(np.split(arrays["corners"], np.cumsum(arrays["counts"])[:-1]))
    volume, missed = arrays["numbers"].tolist()
    return Cut(hulls, volume, arrays["centre"], missed)

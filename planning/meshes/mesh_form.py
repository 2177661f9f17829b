"""The form of a mesh file: its triangles, and convex pieces that are cached on disk."""

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
from planning.meshes import (
    convex_pieces,
    holes,
    mesh_file,
    prisms,
    simplified_surface,
)
from planning.meshes.convex_pieces import Cut, TooManyPiecesError, cut_convex
from planning.meshes.mesh_file import MeshTriangles, read_mesh_bytes, read_triangles
from planning.transforms import read_only_copy

_SOURCES = (
    __file__,
    mesh_file.__file__,
    convex_pieces.__file__,
    prisms.__file__,
    simplified_surface.__file__,
    holes.__file__,
    cover.__file__,
)

_FEW = 64
"""Greatest number of pieces of a body where the scenario does not state how to cut it."""

_SHARES = (1.0 / 60.0, 1.0 / 20.0)
"""Hollows up to this share of the longest edge are filled by default: the
second one where the first makes too many pieces."""


_FORMS: BoundedCache[Mesh] = BoundedCache(64)

_MANY = 2000
"""Triangles of a mesh that takes some seconds to cut."""

_LISTENER: ContextVar[Callable[[Path], None] | None] = ContextVar(
    "listener", default=None
)
_NAMES = frozenset({"counts", "corners", "centre", "numbers"})


@contextmanager
def watch_cutting(begin: Callable[[Path], None]) -> Iterator[None]:
    """Call back with the file of each mesh that takes a while to cut; not for cached ones."""
    token = _LISTENER.set(begin)
    try:
        yield
    finally:
        _LISTENER.reset(token)


def mesh_form(
    path: Path, scale: float | None = None, within: float | None = None
) -> Mesh:
    """Return a mesh file as a form.

    Args:
        path: of an STL or OBJ file.
        scale: factor to metres; None for 1 where the size is then believable.
        within: how deep a hollow may be that a convex piece fills; None for a sixtieth of its
            longest edge, a twentieth where those would be too many [m].

    Raises:
        ShapeError: it cannot be used; names the file and what to do.
    """
    content = read_mesh_bytes(path)
    key = path, sha256(content).hexdigest(), scale, within
    return _FORMS.get(key, lambda: _form(*key, content))


def _form(
    path: Path, sha: str, scale: float | None, within: float | None, content: bytes
) -> Mesh:
    triangles = read_triangles(path, content, scale)
    settings = f"{sha} {path.suffix.lower()} {scale} {within}".encode()

    def find() -> Arrays:
        listener = _LISTENER.get()
        if listener is not None and len(triangles.faces) > _MANY:
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
        cut.simplified,
    )


def _cut(triangles: MeshTriangles, within: float | None) -> Cut:
    """Return the pieces of a mesh: as accurate as asked, within the allowed number of pieces."""
    if within is not None:
        return cut_convex(triangles, within)
    longest = float(np.ptp(triangles.vertices, axis=0).max())
    for share in _SHARES[:-1]:
        with suppress(TooManyPiecesError):
            return cut_convex(triangles, share * longest, _FEW)
    return cut_convex(triangles, _SHARES[-1] * longest)


def _arrays(cut: Cut) -> Arrays:
    return {
        "counts": np.array([len(hull) for hull in cut.hulls]),
        "corners": np.vstack(cut.hulls),
        "centre": cut.centre,
        "numbers": np.array([cut.volume, cut.missed, cut.simplified]),
    }


def _cut_of(arrays: Arrays) -> Cut:
    hulls = tuple(np.split(arrays["corners"], np.cumsum(arrays["counts"])[:-1]))
    volume, missed, simplified = arrays["numbers"].tolist()
    return Cut(hulls, volume, arrays["centre"], missed, simplified)

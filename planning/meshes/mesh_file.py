"""Reading and validation of mesh files: every error names the file and a remedy."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from planning.bounds import LARGEST_M, THINNEST_M
from planning.errors import ShapeError
from planning.files import read_file
from planning.transforms import Array, Indices

_SUFFIXES = (".stl", ".obj")
MOST_BYTES = 256 << 20
"""Greatest size of a file [B]."""

_MOST_FACES = 500_000
"""Greatest number of triangles in a file."""

_PLAUSIBLE_M = 5.0
"""Greatest extent of a mesh without a scale that is plausible in metres [m]."""

_SIMPLIFY = "simplify it (MeshLab, Blender), or describe the shape by a compound"


@dataclass(frozen=True, eq=False)
class MeshTriangles:
    """Triangles of a file, in metres.

    Attributes:
        vertices: each point once, shape (v, 3) [m].
        faces: the three vertices of each, shape (f, 3).
    """

    vertices: Array
    faces: Indices


def read_triangles(path: Path, content: bytes, scale: float | None) -> MeshTriangles:
    """Return the triangles of a mesh file.

    Args:
        path: path of the file, for its format and for messages.
        content: content of the file.
        scale: factor to metres; None if not given: then 1, if that makes the size plausible.

    Raises:
        ShapeError: the file is no valid mesh, or the mesh cannot be the surface of a body.
    """
    import trimesh

    loaded: Any
    try:
        loaded = trimesh.load_mesh(
            BytesIO(_in_utf8(content)), file_type=path.suffix.lower()[1:], process=False
        )
        if isinstance(loaded, trimesh.Scene):
            loaded = loaded.to_mesh()
        vertices = np.array(loaded.vertices, dtype=np.float64).reshape(-1, 3)
        faces = np.array(loaded.faces, dtype=np.int64).reshape(-1, 3)
    except ModuleNotFoundError:  # trimesh looks for a package that guesses encodings
        raise ShapeError(
            f"mesh {path} is cut off, or not written as {path.suffix[1:].upper()}: export it again"
        ) from None
    # Invalid content can raise any error in the readers of trimesh.
    except Exception as error:
        raise ShapeError(
            f"mesh {path} cannot be read as {path.suffix[1:].upper()} ({error}): export it again"
        ) from None
    if len(faces) == 0:
        raise ShapeError(
            f"mesh {path} has no triangles: export a surface, not points or curves"
        )
    if len(faces) > _MOST_FACES:
        raise ShapeError(
            f"mesh {path} has {len(faces)} triangles, more than {_MOST_FACES}: {_SIMPLIFY}"
        )
    if not np.all(np.isfinite(vertices)):
        raise ShapeError(
            f"mesh {path} has coordinates that are no finite numbers: export it again"
        )
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ShapeError(f"mesh {path} has triangles without corners: export it again")
    triangles = _merged(vertices * (1.0 if scale is None else scale), faces)
    _require_size(path, triangles, scale)
    return triangles


def read_mesh_bytes(path: Path) -> bytes:
    """Return the content of a mesh file.

    Raises:
        ShapeError: the file is missing, too large, or of an unknown format.
    """
    if path.suffix.lower() not in _SUFFIXES:
        raise ShapeError(
            f"mesh {path} is of an unknown kind: export it as one of these",
            choices=_SUFFIXES,
        )
    try:
        return read_file(path, MOST_BYTES)
    except FileNotFoundError:
        raise ShapeError(
            f"mesh {path} is not there: relative paths start at the scenario's folder"
        ) from None
    except OSError as error:
        raise ShapeError(f"mesh {path} cannot be read: {error.strerror}") from None


def _in_utf8(content: bytes) -> bytes:
    """Return a text mesh converted to UTF-8, whatever the encoding of its names."""
    try:
        content.decode()
    except UnicodeDecodeError:
        written = content.lstrip().startswith((b"solid", b"#", b"v ", b"o ", b"g "))
        if written and (b"facet" in content or b"\nf " in content):
            return content.decode("latin-1").encode()
    return content


def _merged(vertices: Array, faces: Indices) -> MeshTriangles:
    """Return the triangles with equal vertices merged, without triangles of zero area."""
    used = np.unique(faces)
    number = np.zeros(len(vertices), dtype=np.int64)
    points, own = np.unique(vertices[used], axis=0, return_inverse=True)
    number[used] = own.reshape(-1)
    faces = number[faces]
    a, b, c = (points[faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return MeshTriangles(points, faces[area > 0.0])


def _require_size(path: Path, triangles: MeshTriangles, scale: float | None) -> None:
    if len(triangles.faces) == 0:
        raise ShapeError(
            f"mesh {path} has only triangles without an area: export it again"
        )
    edges = np.ptp(triangles.vertices, axis=0)
    measures = " x ".join(f"{edge:.3g}" for edge in edges) + " m"
    if edges.max() > (_PLAUSIBLE_M if scale is None else LARGEST_M):
        raise ShapeError(
            f"mesh {path} measures {measures}: if it is in millimetres, write scale: 0.001"
            + (" beside it; if it is so large, scale: 1" if scale is None else "")
        )
    if edges.max() < THINNEST_M:
        raise ShapeError(
            f"mesh {path} measures {measures}, less than a tenth of a millimetre: leave scale"
            " away, or write a larger one"
        )
    centred = triangles.vertices - triangles.vertices.mean(axis=0)
    across = np.linalg.svd(centred, full_matrices=False)[2][2]
    thick = float(np.ptp(centred @ across))
    if thick < THINNEST_M:
        raise ShapeError(
            f"mesh {path} is flat, {thick * 1e3:.2g} mm thick: a body has a volume; give the"
            " sheet a thickness, or describe it by a box"
        )

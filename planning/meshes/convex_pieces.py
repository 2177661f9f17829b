"""Convex decomposition of a mesh: hulls of convex bodies, prisms of plates, and coacd for all other bodies.

Every closed body of a mesh is decomposed separately. The pieces must contain the mesh: points on its surface are
tested, and a point outside of all pieces is added to the nearest piece.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

from planning.bounds import THINNEST_M
from planning.cell.cover import hull_vertices, sphere_directions
from planning.errors import ShapeError
from planning.meshes.holes import closed_surface
from planning.meshes.mesh_file import MeshTriangles
from planning.meshes.prisms import prism_pieces
from planning.transforms import Array, Indices

_MOST_PIECES = 256
"""Greatest number of pieces of a mesh that the planner can handle."""

_MOST_BODIES = 2000
"""Greatest number of disconnected bodies of a mesh."""

_MOST_CORNERS = 96
"""Greatest number of corners of a hull; finer ones are enclosed by a coarser one."""

_MOST_CUT = 100_000
"""Greatest number of triangles of a non-convex body, which takes a minute."""

_SAMPLES = 4000
"""Points spread over the surface, and as many of its vertices, that pieces are compared with."""

_ROUNDING = 1e-5
"""A point counts as inside of a piece if it is outside by no more than this [m]."""

_SAME = 1e-6
"""A body counts as convex if its volume and that of its hull differ by no more than this share."""


class TooManyPiecesError(ShapeError):
    """A mesh needs more convex pieces than the planner can handle.

    Attributes:
        count: number of convex pieces of the mesh.
        most: greatest number of pieces that the planner can handle.
    """

    def __init__(self, message: str, *, count: int, most: int) -> None:
        self.count, self.most = count, most
        super().__init__(message)


@dataclass(frozen=True, eq=False)
class Cut:
    """Convex pieces of a mesh, and how accurately they fit it.

    Attributes:
        hulls: corners of the convex pieces, each of shape (c, 3) [m].
        volume: enclosed by the mesh, or that of the pieces if the mesh is not closed [m^3].
        centre: centre of mass, shape (3,) [m].
        missed: greatest distance of a point of the mesh's surface from all pieces [m].
    """

    hulls: tuple[Array, ...]
    volume: float
    centre: Array
    missed: float


def cut_convex(
    triangles: MeshTriangles, within: float, most: int = _MOST_PIECES
) -> Cut:
    """Return convex pieces that contain a mesh.

    Args:
        triangles: the mesh.
        within: greatest depth of a hollow that a piece may fill [m].
        most: greatest number of pieces of a non-prismatic body.

    Raises:
        ShapeError: there would be too many pieces.
    """
    bodies = _bodies(triangles)
    if len(bodies) > _MOST_BODIES:
        raise ShapeError(
            f"it has {len(bodies)} bodies that do not hang together, more than {_MOST_BODIES}:"
            " leave out what nothing can touch, or describe the shape by a compound"
        )
    hulls: list[Array] = []
    for vertices, faces in bodies:
        found = _pieces(vertices, faces, within, most)
        hulls += [_simpler(hull, 0.25 * within) for hull in found]
    hulls = _without_inner(hulls)
    _require_few(len(hulls), _MOST_PIECES, within)
    points = _surface_points(triangles)
    hulls = _including(hulls, points)
    missed = float(np.min([_outside(hull, points) for hull in hulls], axis=0).max())
    volume, centre = _mass(bodies, hulls)
    return Cut(tuple(hulls), volume, centre, max(0.0, missed))


def _bodies(triangles: MeshTriangles) -> list[tuple[Array, Indices]]:
    """Return the connected components of a mesh, each with vertices and faces of its own.

    Triangles are connected by an edge that exactly two triangles share, so two bodies that touch at an edge stay
    separate.
    """
    vertices, faces = triangles.vertices, triangles.faces
    edges, face = _edges(faces)
    edge, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)[1:]
    order = np.argsort(edge.reshape(-1), kind="stable")
    order = order[count[edge.reshape(-1)[order]] == 2]
    one, two = face[order[0::2]], face[order[1::2]]
    links = coo_array((np.ones(len(one)), (one, two)), shape=(len(faces),) * 2)
    bodies, label = connected_components(links, directed=False)
    out = []
    for own in np.split(
        faces[np.argsort(label, kind="stable")],
        np.cumsum(np.bincount(label, minlength=bodies))[:-1],
    ):
        used, number = np.unique(own, return_inverse=True)
        out.append((vertices[used], number.reshape(-1, 3)))
    return out


def _edges(faces: Indices) -> tuple[Indices, Indices]:
    """Return the edges of faces, the lower vertex first, shape (3 f, 2), and the faces they belong to."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    return np.sort(edges, axis=1), np.tile(np.arange(len(faces)), 3)


def _require_few(count: int, most: int, within: float) -> None:
    """Raise TooManyPiecesError when there are more pieces than allowed."""
    if count > most:
        raise TooManyPiecesError(
            f"it falls into {count} convex pieces, more than {most}: write a larger"
            f" within_m than {within:.3g}, simplify it, or describe the shape by a compound",
            count=count,
            most=most,
        )


def _pieces(vertices: Array, faces: Indices, within: float, most: int) -> list[Array]:
    """Return the convex pieces of one body, see ``cut_convex``."""
    import trimesh

    hull = _hull(vertices)
    if hull is None:
        return [_thickened(vertices)]
    if _fills(trimesh.Trimesh(vertices, faces, process=False), hull):
        return [hull_vertices(vertices)]
    closed = closed_surface(vertices, faces)
    prisms = prism_pieces(*closed, within, _MOST_PIECES)
    if prisms is not None:
        return prisms
    body: Any = trimesh.Trimesh(*closed, process=False)
    if len(faces) > _MOST_CUT:
        raise ShapeError(
            f"a body of it has {len(faces)} triangles and is not convex, and more than"
            f" {_MOST_CUT} take too long to cut: simplify it (MeshLab, Blender)"
        )
    import coacd

    coacd.set_log_level("error")
    # What is not closed is closed first, by a surface around it.
    found = coacd.run_coacd(
        coacd.Mesh(np.asarray(body.vertices), np.asarray(body.faces)),
        threshold=within,
        real_metric=True,
        preprocess_mode="auto",
        mcts_iterations=60,
        seed=1,
    )
    _require_few(len(found), most, within)
    return [hull_vertices(np.asarray(points)) for points, _ in found]


def _hull(points: Array) -> ConvexHull | None:
    """Return the hull of points, None where it has no volume."""
    try:
        return ConvexHull(points)
    except QhullError:
        return None


def _thickened(points: Array) -> Array:
    """Return the corners of a thin body around points in a plane, of the least thickness allowed."""
    middle = points.mean(axis=0)
    across = np.linalg.svd(points - middle, full_matrices=False)[2][-1]
    corners = hull_vertices(points)
    return np.vstack([corners + 0.5 * side * THINNEST_M * across for side in (-1, 1)])


def _fills(body: Any, hull: ConvexHull) -> bool:
    """Tell whether a body equals its hull; for an open one, whether all of it is on the hull."""
    if body.is_watertight and body.is_winding_consistent:
        return bool(abs(abs(float(body.volume)) / hull.volume - 1.0) < _SAME)
    size = float(np.ptp(hull.points, axis=0).max())
    points = np.vstack([body.triangles_center, body.vertices])
    depth = -(points @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)
    return bool(depth.max() < 1e-4 * size)


def _without_inner(hulls: list[Array]) -> list[Array]:
    """Return the pieces that are not inside another one."""
    kept: list[Array] = []
    boxes: list[Array] = []
    for hull in sorted(hulls, key=lambda h: -float(np.prod(np.ptp(h, axis=0)))):
        box = np.concatenate([-hull.min(axis=0), hull.max(axis=0)])
        around = [k for k, other in enumerate(boxes) if np.all(box < other + _ROUNDING)]
        if not any(_outside(kept[k], hull).max() <= _ROUNDING for k in around):
            kept.append(hull)
            boxes.append(box)
    return kept


def _surface_points(triangles: MeshTriangles) -> Array:
    """Return points of the surface: corners of triangles, and others spread over them."""
    rng = np.random.default_rng(0)
    corners = triangles.vertices[triangles.faces]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    chosen = rng.choice(len(corners), _SAMPLES, p=area / area.sum())
    shares = rng.dirichlet((1.0, 1.0, 1.0), _SAMPLES)
    spread = np.einsum("sk,skx->sx", shares, corners[chosen])
    vertices = triangles.vertices
    if len(vertices) > _SAMPLES:
        vertices = vertices[rng.choice(len(vertices), _SAMPLES, replace=False)]
    return np.vstack([vertices, spread])


def _outside(hull: Array, points: Array) -> Array:
    """Return the distance of points beyond the farthest face plane of a hull, shape (p,) [m]."""
    planes = ConvexHull(hull).equations
    return np.asarray((points @ planes[:, :3].T + planes[:, 3]).max(axis=1))


def _including(hulls: list[Array], points: Array) -> list[Array]:
    """Return pieces extended by points: each is added to the nearest piece."""
    beyond = np.array([_outside(hull, points) for hull in hulls])
    nearest = beyond.argmin(axis=0)
    left_out = beyond.min(axis=0) > _ROUNDING
    return [
        hull_vertices(np.vstack([hull, points[left_out & (nearest == k)]]))
        for k, hull in enumerate(hulls)
    ]


def _simpler(hull: Array, tolerance: float) -> Array:
    """Return the corners of a hull, or of an enclosing one with fewer corners.

    The face planes that cut off most are added one after another, until what is left stands out
    by no more than the tolerance, or has as many corners as it may.
    """
    if len(hull) <= _MOST_CORNERS:
        return hull
    planes = np.unique(np.round(ConvexHull(hull).equations, 12), axis=0)
    inner = np.append(hull.mean(axis=0), 1.0)
    around = np.vstack([sphere_directions(32), np.eye(3), -np.eye(3)])
    chosen = np.column_stack([around, -(hull @ around.T).max(axis=0)])
    corners = _corners(chosen, inner)
    while len(corners) < _MOST_CORNERS:
        out = corners @ planes[:, :3].T + planes[:, 3]
        if out.max() <= tolerance:
            break
        worst = np.argsort(-out.max(axis=1))[:12]
        more = planes[np.unique(out[worst].argmax(axis=1))]
        chosen = np.vstack([chosen, more])
        corners = _corners(chosen, inner)
    return corners


def _corners(planes: Array, inner: Array) -> Array:
    found = HalfspaceIntersection(planes, inner[:3]).intersections
    return hull_vertices(np.round(found, 9))


def _mass(
    bodies: list[tuple[Array, Indices]], hulls: list[Array]
) -> tuple[float, Array]:
    """Return volume and centre of mass: of the mesh where its holes can be closed, else of the hulls."""
    import trimesh

    meshes = [trimesh.Trimesh(*closed_surface(*body), process=False) for body in bodies]
    if all(m.is_watertight and m.is_winding_consistent for m in meshes):
        with np.errstate(divide="ignore", invalid="ignore"):
            volumes = np.array([float(mesh.volume) for mesh in meshes])
            # A body that is flat has no centre of mass.
            centres = np.nan_to_num([mesh.center_mass for mesh in meshes])
        if volumes.sum() < 0.0:
            volumes = -volumes  # inside out
        if volumes.sum() > 0.0:
            return float(volumes.sum()), volumes @ centres / volumes.sum()
    meshes = [trimesh.Trimesh(hull, ConvexHull(hull).simplices) for hull in hulls]
    solids = [mesh.convex_hull for mesh in meshes]
    volumes = np.array([float(solid.volume) for solid in solids])
    centres = np.array([solid.center_mass for solid in solids])
    return float(volumes.sum()), volumes @ centres / volumes.sum()

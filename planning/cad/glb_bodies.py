"""Bodies of an assembly that the CAD kernel wrote as GLB: closed surfaces, names, colours and places."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from planning.errors import RequestError
from planning.transforms import Array, Indices, Transform, from_quat_wxyz

MOST_BODIES = 300
"""Most bodies of a file."""

_MOST_TRIANGLES = 3_000_000
"""Most triangles of a file."""

_DEEPEST = 100
"""Most levels of assemblies in assemblies."""

_WELD = 1e-6
"""Corners of triangles that are nearer to each other than this are one [m]."""

_TRIANGLES = 4
"""Mode of a primitive that has triangles."""

Colour = tuple[int, int, int]

_TYPES = {5121: np.uint8, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
_WIDTHS = {"SCALAR": 1, "VEC3": 3}


@dataclass(frozen=True, eq=False)
class CadBody:
    """A solid body of an assembly.

    Attributes:
        names: what it is called: its product, and its instance in the assembly.
        vertices: corners of its triangles in its own frame, shape (v, 3) [m].
        faces: corners of each, anticlockwise as seen from outside, shape (f, 3).
        surfaces: number of the surface of each triangle in ``forms``, -1 if not known, shape (f,).
        forms: exact surfaces that the triangles are on, None where they are of no known type.
        pose: of its frame in the assembly.
        colour: red, green, blue, 0 to 255; None if it has none.
    """

    names: tuple[str, ...]
    vertices: Array
    faces: Indices
    surfaces: Indices
    forms: Sequence[Mapping[str, Any] | None]
    pose: Transform
    colour: Colour | None

    @cached_property
    def volume(self) -> float:
        """Enclosed volume [m^3]."""
        return signed_volume(self.vertices, self.faces)

    @cached_property
    def centre(self) -> Array:
        """Centroid of the surface, which turns with it, shape (3,) [m]."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        return np.asarray(area @ (a + b + c) / (3.0 * area.sum()))

    @cached_property
    def away(self) -> Array:
        """Distance of each corner from the centroid, shape (v,) [m]."""
        return np.asarray(np.linalg.norm(self.vertices - self.centre, axis=1))

    @cached_property
    def tree(self) -> cKDTree:
        """The corners, for queries."""
        return cKDTree(self.vertices)


@dataclass(frozen=True, eq=False)
class _Patch:
    """Triangles of a product."""

    vertices: Array
    faces: Indices
    surfaces: Indices
    forms: Sequence[Mapping[str, Any] | None]
    colours: Sequence[Colour | None]
    parts: int


def read_bodies(content: bytes) -> tuple[list[CadBody], list[str]]:
    """Return the bodies of a GLB file of the CAD kernel, and notes on what is left out.

    Raises:
        RequestError: it has no body, too many of them, or too many triangles.
    """
    length = struct.unpack_from("<I", content, 12)[0]
    data, binary = json.loads(content[20 : 20 + length]), content[20 + length + 8 :]
    known: dict[int, tuple[_Patch, list[tuple[Indices, bool]]]] = {}
    bodies: list[CadBody] = []
    notes: list[str] = []
    triangles = 0
    for number, names, pose in _placed_meshes(data):
        if number not in known:
            patch = _patch(data, binary, data["meshes"][number])
            known[number] = patch, list(_solids(patch))
        patch, solids = known[number]
        triangles += len(patch.faces)
        if triangles > _MOST_TRIANGLES:
            most = f"more than {_MOST_TRIANGLES} triangles"
            raise RequestError(f"its bodies have {most}: export simpler ones")
        called = names[0] or "a body"
        if not len(patch.faces):
            notes.append(f"{called}: has curves or points, and no surface: left out")
        for chosen, closed in solids:
            body = _body(patch, chosen, names, pose)
            if not closed:
                notes.append(f"{called}: its surface is not closed: left out")
            elif body.volume < 1e-12:
                notes.append(f"{called}: is flat, or smaller than 1 mm^3: left out")
            else:
                bodies.append(body)
            if len(bodies) > MOST_BODIES:
                raise RequestError(f"it has more than {MOST_BODIES} bodies")
    return bodies, list(dict.fromkeys(notes))


def signed_volume(vertices: Array, faces: Indices) -> float:
    """Return the volume that triangles enclose, negative if they are turned inside out [m^3]."""
    if not len(faces):
        return 0.0
    a, b, c = (vertices[faces[:, k]] - vertices[faces[0, 0]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def _placed_meshes(
    data: Mapping[str, Any],
) -> Iterator[tuple[int, tuple[str, ...], Transform]]:
    """Yield the number, the names and the pose of every mesh of the scene."""
    nodes, meshes = data.get("nodes", []), data.get("meshes", [])
    scenes = data.get("scenes") or [{"nodes": []}]
    left = [(n, np.eye(4), 0) for n in reversed(scenes[0].get("nodes", []))]
    while left:
        number, above, level = left.pop()
        if level > _DEEPEST:
            raise RequestError(f"it has assemblies in assemblies {_DEEPEST} deep")
        node = nodes[number]
        pose = above @ _node_pose(node)
        if "mesh" in node:
            mesh = node["mesh"]
            names = meshes[mesh].get("name", ""), node.get("name", "")
            yield mesh, names, _rigid(pose)
        left += [(n, pose, level + 1) for n in reversed(node.get("children", []))]


def _node_pose(node: Mapping[str, Any]) -> Transform:
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    pose = from_quat_wxyz(node.get("translation", (0.0, 0.0, 0.0)), (w, x, y, z))
    pose[:3, :3] = pose[:3, :3] * np.array(node.get("scale", 1.0))
    if "matrix" in node:
        pose = np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    return pose


def _rigid(pose: Transform) -> Transform:
    """Return the pose with an exact rotation: files have seven digits.

    Raises:
        RequestError: it is no rotation, but scales or mirrors.
    """
    left, sizes, right = np.linalg.svd(pose[:3, :3])
    turn = left @ right
    if np.abs(sizes - 1.0).max() > 1e-4 or np.linalg.det(turn) < 0.0:
        raise RequestError("a body is scaled or mirrored where it is placed")
    out = np.eye(4)
    out[:3, :3] = np.where(np.abs(turn) < 1e-9, 0.0, turn)
    out[:3, 3] = pose[:3, 3]
    return out


def _patch(data: Mapping[str, Any], binary: bytes, mesh: Mapping[str, Any]) -> _Patch:
    """Return the triangles of a mesh, with equal corners as one."""
    points, corners = [np.empty((0, 3))], [np.empty((0, 3), np.int64)]
    surfaces, colours = [np.empty(0, np.int64)], list[Colour | None]()
    forms: list[Mapping[str, Any] | None] = []
    before = 0
    for primitive in mesh.get("primitives", []):
        if primitive.get("mode", _TRIANGLES) != _TRIANGLES:
            continue
        points.append(_array(data, binary, primitive["attributes"]["POSITION"]))
        index = _array(data, binary, primitive["indices"]).reshape(-1, 3)
        corners.append(index.astype(np.int64) + before)
        before += len(points[-1])
        known = primitive.get("extensions", {}).get("TM_brep_faces", {})
        numbers = np.full(len(index), -1)
        if "faceIndices" in known:
            numbers = _array(data, binary, known["faceIndices"]).reshape(-1)
            numbers = numbers.astype(np.int64) + len(forms)
        surfaces.append(numbers)
        forms += known.get("faces", [])
        colours += [_colour(data, primitive)] * len(index)
    vertices, faces = np.vstack(points).astype(np.float64), np.vstack(corners)
    if not np.all(np.isfinite(vertices)):
        raise RequestError("a body has coordinates that are no finite numbers")
    if len(faces):
        vertices, faces = _welded(vertices, faces)
    kept = np.all(faces != np.roll(faces, 1, axis=1), axis=1)
    colours = [colour for colour, own in zip(colours, kept, strict=True) if own]
    numbers = np.concatenate(surfaces)[kept]
    return _Patch(vertices, faces[kept], numbers, forms, colours, len(surfaces) - 1)


def _array(data: Mapping[str, Any], binary: bytes, number: int) -> Array:
    """Return the values of an accessor, shape (n, width)."""
    accessor = data["accessors"][number]
    view = data["bufferViews"][accessor["bufferView"]]
    kind, width = np.dtype(_TYPES[accessor["componentType"]]), _WIDTHS[accessor["type"]]
    begin = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    step = view.get("byteStride", kind.itemsize * width)
    shape, strides = (accessor["count"], width), (step, kind.itemsize)
    return np.array(np.ndarray(shape, kind, binary, begin, strides))


def _welded(vertices: Array, faces: Indices) -> tuple[Array, Indices]:
    """Return the triangles with corners that are at the same place as one."""
    from trimesh.graph import connected_component_labels

    points, number = np.unique(vertices, axis=0, return_inverse=True)
    pairs = cKDTree(points).query_pairs(_WELD, output_type="ndarray")
    label = connected_component_labels(pairs, node_count=len(points))
    _, first = np.unique(label, return_index=True)
    return points[first], label.astype(np.int64)[number.reshape(-1)][faces]


def _solids(patch: _Patch) -> Iterator[tuple[Indices, bool]]:
    """Yield the triangles of each solid of a product, and whether their surface is closed.

    Surfaces are listed solid by solid: where all edges so far are between two triangles, a closed shell
    ends. A shell that is turned inwards is a cavity of the solid before it.
    """
    order = np.arange(len(patch.faces))
    if patch.parts == 1 and len(order) and patch.surfaces.min() >= 0:
        order = np.argsort(patch.surfaces, kind="stable")
        shells = _closed_in_turn(patch, order)
    else:
        shells = _connected(patch.faces)
    solids: list[Indices] = []
    for shell in shells:
        closed = _is_closed(patch.faces[shell])
        volume = signed_volume(patch.vertices, patch.faces[shell])
        if closed and volume < 0.0 and solids:
            solids[-1] = np.concatenate([solids[-1], shell])
        elif closed:
            # A surface that is turned inside out as a whole encloses the same body.
            if volume < 0.0:
                patch.faces[shell] = patch.faces[shell][:, ::-1]
            solids.append(shell)
        else:
            yield shell, False
    for solid in solids:
        yield solid, True


def _closed_in_turn(patch: _Patch, order: Indices) -> Iterator[Indices]:
    """Yield the triangles of each closed shell, taking surface after surface."""
    faces = patch.faces[order]
    ends = np.flatnonzero(np.diff(patch.surfaces[order], append=-2))
    open_edges: dict[tuple[int, int], int] = {}
    begin = last = 0
    for end in ends.tolist():
        for a, b, c in faces[last : end + 1].tolist():
            for x, y in ((a, b), (b, c), (c, a)):
                edge, sign = ((x, y), 1) if x < y else ((y, x), -1)
                open_edges[edge] = open_edges.get(edge, 0) + sign
                if not open_edges[edge]:
                    del open_edges[edge]
        last = end + 1
        if not open_edges:
            yield order[begin:last]
            begin = last
    if begin < len(order):
        yield from (order[begin:][own] for own in _connected(faces[begin:]))


def _connected(faces: Indices) -> Iterator[Indices]:
    """Yield the triangles that are connected by corners, the ones of least number first."""
    from trimesh.graph import connected_component_labels

    if len(faces):
        edges = np.vstack([faces[:, :2], faces[:, ::2]])
        label = connected_component_labels(edges, int(faces.max()) + 1)[faces[:, 0]]
        for number in dict.fromkeys(label.tolist()):
            yield np.flatnonzero(label == number)


def _is_closed(faces: Indices) -> bool:
    """Tell whether every edge of triangles is met in both directions equally often."""
    edges = np.vstack([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    signs = np.where(edges[:, 0] < edges[:, 1], 1, -1)
    _, number = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True)
    return not np.any(np.bincount(number.reshape(-1), signs))


def _body(
    patch: _Patch, chosen: Indices, names: tuple[str, ...], pose: Transform
) -> CadBody:
    used, faces = np.unique(patch.faces[chosen], return_inverse=True)
    colours = [patch.colours[k] for k in chosen.tolist()]
    # Single faces may be painted: the body has the colour of most of its triangles.
    most = max(dict.fromkeys(colours), key=colours.count, default=None)
    own, surfaces = patch.vertices[used], patch.surfaces[chosen]
    return CadBody(names, own, faces.reshape(-1, 3), surfaces, patch.forms, pose, most)


def _colour(data: Mapping[str, Any], primitive: Mapping[str, Any]) -> Colour | None:
    """Return the colour of a primitive; GLB has linear values."""
    if "material" not in primitive:
        return None
    material = data["materials"][primitive["material"]].get("pbrMetallicRoughness", {})
    linear = np.clip(material.get("baseColorFactor", [1.0] * 4)[:3], 0.0, 1.0)
    curved = 1.055 * linear ** (1.0 / 2.4) - 0.055
    seen = np.where(linear <= 0.0031308, 12.92 * linear, curved)
    red, green, blue = np.round(255.0 * seen).astype(int).tolist()
    return red, green, blue

"""Penetration depths of parts, measured on their exact shapes instead of the polyhedra used for planning.

Cylinders and capsules are exactly round here. The triangles of a mesh are used, not the convex pieces that fill its
cavities. If the wall of a hole in a mesh is the polygon of a round bore, the hole is treated as a round bore for a
round peg.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from typing import Any

import coal
import numpy as np
from scipy.spatial import ConvexHull

from planning.caches import BoundedCache
from planning.cell.body import Capsules, ConvexBody
from planning.cell.shape import Box, Capsule, Cylinder, Element, Form, Mesh, Shape
from planning.contacts.surface_depth import (
    ConvexSolid,
    RoundSolid,
    deepest_point,
    winding_number,
)
from planning.contacts.surface_gap import surface_gap
from planning.contacts.touching import PlacedObject, nearby_entities
from planning.geometry.exact import hull_shape, shape_distance
from planning.transforms import Array, Transform, inverse, read_only_copy, translation

ROUNDING = 1e-5
"""Default allowed penetration depth, due to rounding of poses [m]."""

DEEPEST = 0.05
"""Greatest penetration depth that can be allowed [m]."""

_NODE = 0.001
"""Nothing is pressed deeper into anything: bars that meet in a node are [m]."""

_STEP = 0.005
"""Sampling distance of a straight path [m]."""

_THROUGH = 0.9
"""A surface that comes so near to the middle of a form, as a share, goes through it."""

_ON_WAYS: BoundedCache[float] = BoundedCache(50_000)
_DEPTHS: BoundedCache[float] = BoundedCache(50_000)
_HULLS: BoundedCache[ConvexSolid] = BoundedCache(10_000)
_BODIES: BoundedCache[tuple[ConvexBody, ...]] = BoundedCache(1000)
_CORNERS: BoundedCache[tuple[Array, Array]] = BoundedCache(1000)

SNUG = 0.003
"""A wall no further from a peg than this is looked at [m]."""

_END = 1e-4
"""Least overhang of the faces next to a peg beyond its ends [m]."""

_WALL = 0.05
"""Faces of a bore are turned from its axis by no less than nearly a right angle: cosine."""

_ROUND = 2e-5, 5e-3
"""Corners of a bore are on one circle to within this [m], or this share of its radius."""

_WIDEST_GAP = math.radians(30.1)
"""No corner of a bore is further from the next one, around its axis: twelve sides at least [rad]."""


@dataclass(frozen=True)
class Overlaps:
    """Allowed penetration depths of parts in their places.

    Attributes:
        said: allowed depths of pairs of names, such as a pin and its hole or bars that meet in a node [m].
        joined: pairs that are joined, for messages.
        in_nodes: how deep what is joined may be in each other [m].
    """

    said: Mapping[frozenset[str], float] = field(default_factory=dict)
    joined: frozenset[frozenset[str]] = frozenset()
    in_nodes: float = 0.0

    def most(self, first: str, second: str) -> float:
        """Return the allowed penetration depth of two things [m]."""
        return self.said.get(frozenset((first, second)), 0.0) + ROUNDING

    def is_too_deep(
        self, name: str, part: PlacedObject, others: Mapping[str, PlacedObject]
    ) -> dict[str, float]:
        """Return the things that a part penetrates deeper than allowed, with the depths [m].

        Args:
            name: of the part.
            part: where it is.
            others: everything else, by name.
        """
        found = {}
        for other, gap in nearby_entities(part, others, 0.0).items():
            most = self.most(name, other)
            if -gap > most and (deep := overlap_depth(part, others[other])) > most:
                found[other] = deep
        return found

    def words(self, first: str, second: str, deep: float) -> str:
        """Return in words the depth of two things, the allowed one, and the remedy."""
        most = self.most(first, second)
        text = f"{format_depth(deep)}, and may by {format_depth(most)}"
        return text + self.remedy(first, second, deep)

    def remedy(self, first: str, second: str, deep: float) -> str:
        """Return in words the scenario entry that would allow two things to penetrate so deep."""
        digits = 6 if deep < 1e-4 else 5
        press = math.ceil(round(deep * 10**digits, 3)) / 10**digits
        if press > DEEPEST:
            return ""
        if frozenset((first, second)) in self.joined:
            return f"; if they meet in a node, say joined_overlap_m: {press:g}"
        text = (
            "; if one is pressed into the other, say"
            f" fits: [{{parts: [{first}, {second}], press_m: {press:g}}}]"
        )
        if deep > _NODE:
            text += (
                "; if they are bars that meet in a node, join them"
                f" (joined: [[{second}, {first}]])"
            )
            if press > self.in_nodes:
                text += f" and say joined_overlap_m: {press:g}"
        return text


def format_depth(depth: float) -> str:
    """Return a depth for messages: below a millimetre to three digits."""
    return f"{depth * 1e3:.3g} mm" if depth < 1e-3 else f"{depth * 1e3:.1f} mm"


def shapes_overlap_depth(
    item: PlacedObject,
    other: PlacedObject,
    approaches: Iterable[tuple[Transform, Array, float]],
) -> float:
    """Return the penetration depth of the convex pieces of two shapes along straight paths [m].

    Round ones are round; that is what proofs and audits of plans measure.

    Args:
        item: what is moved.
        other: what rests.
        approaches: end poses of the first, directions of its approach, and distances.
    """
    deepest = 0.0
    for pose, direction, length in approaches:
        where = tuple(array.tobytes() for array in (other[1], pose, direction))
        work = partial(_depth_on_way, item, other, pose, direction, length)
        key = item[0].shape, other[0].shape, *where, length
        deepest = max(deepest, _ON_WAYS.get(key, work))
    return deepest


def _depth_on_way(
    item: PlacedObject,
    other: PlacedObject,
    pose: Transform,
    direction: Array,
    length: float,
) -> float:
    """Return the penetration depth of a thing in another one along a straight path to a pose [m]."""
    deepest = 0.0
    met = [Element(e.form, other[1] @ e.pose) for e in other[0].shape.elements]
    for away in np.linspace(0.0, length, int(np.ceil(length / _STEP)) + 1):
        at = translation(*(-away * direction)) @ pose
        if nearby_entities((item[0], at), {"": other}, 0.0):
            own = [Element(e.form, at @ e.pose) for e in item[0].shape.elements]
            found = max(_pieces_overlap_depth(a, b) for a, b in product(own, met))
            deepest = max(deepest, found)
    return deepest


def sweeps_through(
    placed: PlacedObject,
    other: PlacedObject,
    insertion: Array,
    approach: float,
    most: float = ROUNDING,
) -> bool:
    """Tell whether a part on its straight insertion path penetrates another one deeper than ``most``."""
    item, pose = placed
    for away in np.linspace(0.0, approach, int(np.ceil(approach / _STEP)) + 1)[1:]:
        before = (item, translation(*(-away * insertion)) @ pose)
        near = nearby_entities(before, {"": other}, 0.0).values()
        if any(gap < -most for gap in near) and overlap_depth(before, other) > most:
            return True
    return False


def overlap_depth(one: PlacedObject, other: PlacedObject) -> float:
    """Return the penetration depth of two things [m].

    That is how far the one would have to go to be free; of a mesh, by how much the other would have to
    be thinner all over where its surface does not go through it. Not positive where they are free.
    """
    (item, at), (another, there) = one, other
    between = np.round(inverse(at) @ there, 12)
    key = item.shape, another.shape, between.tobytes()
    return _DEPTHS.get(key, lambda: _depth(item.shape, another.shape, between))


def _depth(one: Shape, other: Shape, between: Transform) -> float:
    """Return the penetration depth of two shapes, given the pose of the second in the frame of the first."""
    return max(
        forms_overlap_depth(
            first, Element(second.form, read_only_copy(between @ second.pose))
        )
        for first, second in product(one.elements, other.elements)
    )


def forms_overlap_depth(first: Element, second: Element) -> float:
    """Return the penetration depth of two forms; for meshes, triangles tell whether they are free [m]."""
    hulls = _pieces_overlap_depth(first, second)
    if hulls <= ROUNDING:
        return hulls
    if (gap := surface_gap(first, second)) > 0.0:
        return -gap
    approaches = []
    for convex, mesh in ((first, second), (second, first)):
        if isinstance(mesh.form, Mesh):
            approaches.append(_in_mesh(convex, mesh, hulls))
    return min(approaches, default=hulls)


def _in_mesh(item: Element, mesh: Element, hulls: float) -> float:
    """Return the penetration depth of a form in a mesh, given that in its convex pieces [m]."""
    assert isinstance(mesh.form, Mesh)
    if isinstance(item.form, Cylinder):
        bore = bore_around(item.form, item.pose, mesh)
        if bore is not None:
            play = bore.radius - bore.off - item.form.radius
            reached = _in_surface(item, mesh, hulls)
            if reached <= bore.chord + max(-play, 0.0) + ROUNDING:
                # What is at the ends of the peg counts, the corners of its wall do not.
                slim = min(item.form.radius, bore.radius - bore.off - bore.chord)
                if slim <= 0.0:
                    return -play
                thin = Element(Cylinder(slim - 1e-7, item.form.length), item.pose)
                return max(-play, _in_surface(thin, mesh, hulls))
            return reached
    return _in_surface(item, mesh, hulls)


def _in_surface(item: Element, mesh: Element, hulls: float) -> float:
    """Return the depth of a mesh surface in a form, or of the form where it passes through the surface."""
    assert isinstance(mesh.form, Mesh)
    corners = mesh.form.vertices[mesh.form.faces]
    near = np.argwhere(_box_gaps(item, mesh) <= 0.0).tolist()
    depths = zip(near, _pair_depths(item, mesh, near), strict=True)
    reached = {i for (i, _), deep in depths if deep > ROUNDING}
    deepest = -math.inf
    for number, (solid, pose) in enumerate(_solids(item)):
        if number not in reached:
            continue
        seen = inverse(pose) @ mesh.pose
        triangles = corners @ seen[:3, :3].T + seen[:3, 3]
        found = deepest_point(solid, triangles)
        through = found >= _THROUGH * solid.inner
        if through or abs(winding_number(solid.middle, triangles)) > 0.5:
            return hulls
        deepest = max(deepest, found)
    return min(deepest, hulls)


def _solids(element: Element) -> Iterator[tuple[ConvexSolid, Transform]]:
    """Yield the convex solids of a form, with their poses."""
    form, pose = element.form, element.pose
    if isinstance(form, Mesh):
        for body in mesh_bodies(form):
            yield _hull_solid(body), pose
    elif isinstance(form, Box):
        half = 0.5 * np.array(form.size)
        planes, offsets = np.vstack([np.eye(3), -np.eye(3)]), np.tile(half, 2)
        inner = float(half.min())
        yield ConvexSolid(planes, offsets, inner, np.zeros(3), -half, half), pose
    else:
        yield round_solid(form), pose


def round_solid(form: Cylinder | Capsule) -> ConvexSolid:
    """Return the solid of a round form."""
    flat = isinstance(form, Cylinder)
    axis = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]) if flat else np.empty((0, 3))
    half = 0.5 * form.length
    inner = min(form.radius, half) if flat else form.radius
    high = np.array([form.radius, form.radius, half + (0.0 if flat else form.radius)])
    planes = axis, np.full(len(axis), half), inner, np.zeros(3), -high, high
    return RoundSolid(*planes, form.radius, math.inf if flat else half)


def _hull_solid(body: ConvexBody) -> ConvexSolid:
    def solid() -> ConvexSolid:
        hull = ConvexHull(body.vertices)
        planes = np.unique(np.round(hull.equations, 12), axis=0)
        middle = body.vertices.mean(axis=0)
        offsets = -planes[:, 3]
        inner = float((offsets - planes[:, :3] @ middle).min())
        return ConvexSolid(planes[:, :3], offsets, inner, middle, body.low, body.high)

    return _HULLS.get(body, solid)


def mesh_bodies(form: Mesh) -> tuple[ConvexBody, ...]:
    """Return the convex pieces of a mesh in its own frame, of which only the hulls are used."""
    none = Capsules(np.empty((0, 3)), np.empty((0, 3)), np.empty(0))
    return _BODIES.get(
        form, lambda: tuple(ConvexBody("piece", hull, none) for hull in form.hulls)
    )


def _pieces_overlap_depth(one: Element, other: Element) -> float:
    """Return the greatest penetration depth of pieces of two forms, round ones exact [m].

    Not positive where they are free: then it is how far they are apart, or less.
    """
    gaps = _box_gaps(one, other)
    near = np.argwhere(gaps <= 0.0).tolist()
    if not near:
        return -float(gaps.min())
    return max(_pair_depths(one, other, near))


def _pair_depths(
    one: Element, other: Element, pairs: Iterable[list[int]]
) -> Iterator[float]:
    """Yield the penetration depths of pieces, pair by pair [m]."""
    own, met = _exact_shapes(one), _exact_shapes(other)
    for i, k in pairs:
        yield -shape_distance(*own[i], *met[k], coal.DistanceResult())


def _box_gaps(one: Element, other: Element) -> Array:
    """Return the gaps of the boxes around the pieces of two forms, negative where they overlap [m]."""
    (low, high), (other_low, other_high) = _boxes(one), _boxes(other)
    gaps = np.maximum(low[:, None] - other_high, other_low - high[:, None])
    return np.asarray(gaps.max(axis=2))


def _boxes(element: Element) -> tuple[Array, Array]:
    """Return the corners of boxes around the pieces of a form in its place, shape (n, 3) each [m]."""
    form, pose = element.form, element.pose

    def corners() -> tuple[Array, Array]:
        if isinstance(form, Mesh):
            low = np.array([hull.min(axis=0) for hull in form.hulls])
            return low, np.array([hull.max(axis=0) for hull in form.hulls])
        if isinstance(form, Box):
            half = 0.5 * np.array([form.size])
        else:
            ends = form.radius if isinstance(form, Capsule) else 0.0
            half = np.array([[form.radius, form.radius, 0.5 * form.length + ends]])
        return -half, half

    low, high = _CORNERS.get(form, corners)
    middle = 0.5 * (low + high) @ pose[:3, :3].T + pose[:3, 3]
    reach = 0.5 * (high - low) @ np.abs(pose[:3, :3]).T
    return middle - reach, middle + reach


def _exact_shapes(element: Element) -> list[tuple[Any, Any]]:
    """Return coal's shapes of a form with their poses: exact, but for the pieces of a mesh."""
    form, pose = element.form, element.pose
    at = coal.Transform3s(pose[:3, :3], pose[:3, 3])
    if isinstance(form, Mesh):
        return [(hull_shape(body), at) for body in mesh_bodies(form)]
    return [(_coal_shape(form), at)]


def _coal_shape(form: Form) -> Any:
    if isinstance(form, Box):
        return coal.Box(*form.size)
    assert not isinstance(form, Mesh)
    kind = coal.Cylinder if isinstance(form, Cylinder) else coal.Capsule
    return kind(form.radius, form.length)


@dataclass(frozen=True)
class Bore:
    """A round hole of a mesh, seen along the axis of a peg.

    Attributes:
        radius: of the circle that its corners are on [m].
        centre: of its axis in the frame of the peg, across it, shape (2,) [m].
        chord: how far its polygon reaches inside of the circle [m].
    """

    radius: float
    centre: Array
    chord: float

    @property
    def off(self) -> float:
        """Distance of its axis from that of the peg [m]."""
        return float(np.linalg.norm(self.centre))


def bore_around(form: Cylinder, pose: Transform, mesh: Element) -> Bore | None:
    """Return the bore of a mesh around a round peg, None where there is none.

    Its wall is made of the faces that are turned to the axis of the peg, beside the peg; their corners
    are on one circle and go all around. A hexagon is none.
    """
    wall = mesh.form
    assert isinstance(wall, Mesh)
    seen = inverse(pose) @ mesh.pose
    corners = (wall.vertices @ seen[:3, :3].T + seen[:3, 3])[wall.faces]
    near = np.linalg.norm(corners[:, :, :2], axis=2).max(axis=1) < form.radius + SNUG
    heights, half = corners[:, :, 2], 0.5 * form.length
    near &= (heights.min(axis=1) < half - _END) & (heights.max(axis=1) > _END - half)
    corners = corners[near]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.maximum(np.linalg.norm(normal, axis=1), 1e-300)
    middle = corners.mean(axis=1)
    turned = np.einsum("ij,ij->i", normal[:, :2], middle[:, :2])
    inward = turned < 0.0 if _is_right_side_out(wall) else turned > 0.0
    own = corners[inward & (np.abs(normal[:, 2]) < _WALL * length)]
    if len(own) == 0:
        return None
    points = own[:, :, :2].reshape(-1, 2)
    # The circle through all corners, least squares: |p|^2 = 2 c p + (r^2 - |c|^2).
    rows = np.column_stack([2.0 * points, np.ones(len(points))])
    (x, y, rest), *_ = np.linalg.lstsq(rows, (points**2).sum(axis=1), rcond=None)
    centre, radius = np.array([x, y]), math.sqrt(max(rest + x * x + y * y, 0.0))
    away = np.linalg.norm(points - centre, axis=1)
    if np.abs(away - radius).max() > max(_ROUND[0], _ROUND[1] * radius):
        return None
    turns = np.sort(np.arctan2(*(points - centre).T))
    gap = float(np.diff(turns, append=turns[0] + 2.0 * math.pi).max())
    if gap > _WIDEST_GAP:
        return None
    chord = radius * (1.0 - math.cos(0.5 * gap))
    return Bore(radius, centre, chord)


def _is_right_side_out(mesh: Mesh) -> bool:
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    return float(np.einsum("nx,nx->", a, np.cross(b, c))) >= 0.0

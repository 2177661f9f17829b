"""The meshes of our own robots: lattice girders of the tower crane, and the tools of the GP4.

``python -m tests.planning.robots.drawn_meshes`` writes the committed meshes anew.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull

from planning.robots.load_urdf import frustum_corners
from planning.transforms import Array

MESHES = Path(__file__).parents[3] / "planning" / "robots" / "urdf" / "meshes"

Strut = tuple[Array, Array, float]
"""Both ends and the thickness of a square bar [m]."""


def mast_struts(low: float, high: float, half: float) -> Iterator[Strut]:
    """Yield the bars of an upright square mast.

    Args:
        low, high: z of its ends [m].
        half: distance of the middle of its legs from its faces' middle lines [m].
    """
    corners = [(half, half), (-half, half), (-half, -half), (half, -half)]
    bays = max(1, round((high - low) / (2.0 * half)))
    level = np.linspace(low, high, bays + 1)
    for x, y in corners:
        yield np.array((x, y, low)), np.array((x, y, high)), 0.04
    for side in range(4):
        (x, y), (u, v) = corners[side], corners[(side + 1) % 4]
        for k, z in enumerate(level):
            yield np.array((x, y, z)), np.array((u, v, z)), 0.02
            if k < bays:
                ends = ((x, y), (u, v)) if k % 2 else ((u, v), (x, y))
                yield (
                    np.array((*ends[0], z)),
                    np.array((*ends[1], level[k + 1])),
                    0.02,
                )


def jib_struts(rear: float, front: float, half: float, apex: float) -> Iterator[Strut]:
    """Yield the bars of a jib along x: two beams, rungs, a ridge, a mast head and its ties.

    Args:
        rear, front: x of its ends [m].
        half: distance of the beams from the middle [m].
        apex: height of the mast head [m].
    """
    ridge, start, end = 0.34, 0.5, front - 0.25
    for y in (half, -half):
        yield np.array((rear, y, 0.03)), np.array((front, y, 0.03)), 0.05
    yield np.array((start, 0.0, ridge)), np.array((end, 0.0, ridge)), 0.035
    stations = np.linspace(start, end, 13)
    for k, x in enumerate(stations):
        for y in (half, -half):
            yield np.array((x, 0.0, ridge)), np.array((x, y, 0.05)), 0.016
            if k + 1 < len(stations):
                foot = np.array((stations[k + 1], y, 0.05))
                yield np.array((x, 0.0, ridge)), foot, 0.016
    for x in (rear, rear / 2.0, front):
        yield np.array((x, -half, 0.03)), np.array((x, half, 0.03)), 0.04
    head = np.array((0.0, 0.0, apex))
    for x, y in ((0.18, half), (0.18, -half), (-0.18, half), (-0.18, -half)):
        yield np.array((x, y, 0.05)), head, 0.035
    yield head, np.array((0.45 * front, 0.0, ridge)), 0.012
    yield head, np.array((0.85 * front, 0.0, ridge)), 0.012
    for y in (half, -half):
        yield head, np.array((rear + 0.15, y, 0.05)), 0.012


def obj_text(struts: Iterator[Strut], title: str) -> str:
    """Return square bars as Wavefront OBJ text."""
    lines = [f"# {title}: metres; tests/planning/robots/drawn_meshes.py"]
    count = 0
    for first, second, thickness in struts:
        corners = _bar(first, second, thickness)
        lines += [f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in corners]
        for a, b, c, d in ((0, 1, 2, 3), (7, 6, 5, 4), *_SIDES):
            ring = [count + k + 1 for k in (a, b, c, d)]
            lines.append(f"f {ring[2]} {ring[1]} {ring[0]}")
            lines.append(f"f {ring[3]} {ring[2]} {ring[0]}")
        count += 8
    return "\n".join(lines) + "\n"


_SIDES = tuple((k, k + 4, (k + 1) % 4 + 4, (k + 1) % 4) for k in range(4))


def _bar(first: Array, second: Array, thickness: float) -> Array:
    """Return the corners of a square bar: four around one end, then around the other."""
    along = (second - first) / np.linalg.norm(second - first)
    other = np.eye(3)[int(np.argmin(np.abs(along)))]
    side = np.cross(along, other)
    side /= np.linalg.norm(side)
    up = np.cross(along, side)
    ring = [side + up, -side + up, -side - up, side - up]
    return np.array(
        [end + 0.5 * thickness * r for end in (first, second) for r in ring]
    )


_DRAWN = "metres, axis z; tests/planning/robots/drawn_meshes.py"


def cone_obj() -> str:
    """Return the cone of the dual-arm tool as Wavefront OBJ text.

    Its radius goes from 38.6 mm to 6.6 mm over 33.9 mm: a twentieth of a millimetre around all
    that was measured.
    """
    corners = frustum_corners(0.0386, 0.0066, 0.0, 0.0339)
    return convex_obj(corners, f"cone of the GP4's dual-arm tool: {_DRAWN}")


def lever_obj() -> str:
    """Return the tapering root of the dual-arm tool's lever, up to 1.5 mm beyond its grip plane."""
    profile = ((-8.0, 0.0), (-5.2, 1.5), (0.0, 1.5), (0.0, 0.0))
    corners = [(x, y, z) for x, z in profile for y in (-8.0, 8.0)]
    return convex_obj(
        np.array(corners) / 1e3, f"lever of the GP4's dual-arm tool: {_DRAWN}"
    )


def slim_body_obj() -> str:
    """Return the body of the slim tool: eight sides, tapering to the tip from 38 mm on.

    It is 11.2 mm from the axis on four sides and 14.2 mm on the four between them.
    """
    near, far = 11.2, 14.2 * np.sqrt(2.0) - 11.2
    ring = [
        (sx * x, sy * y)
        for x, y in ((near, far), (far, near))
        for sx in (-1.0, 1.0)
        for sy in (-1.0, 1.0)
    ]
    tip = [(x, y, 40.0) for x in (-9.9, 8.0) for y in (-8.0, 8.0)]
    corners = np.array([*((x, y, z) for x, y in ring for z in (10.1, 38.0)), *tip])
    corners[:, 2] -= 10.1
    return convex_obj(corners / 1e3, f"body of the GP4's slim tool: {_DRAWN}")


def convex_obj(corners: Array, title: str) -> str:
    """Return a convex body as Wavefront OBJ text, its faces counter-clockwise from outside."""
    hull = ConvexHull(corners)
    lines = [f"# {title}"]
    lines += [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in corners]
    for face, plane in zip(hull.simplices, hull.equations, strict=True):
        a, b, c = corners[face]
        turned = np.cross(b - a, c - a) @ plane[:3] < 0.0
        i, j, k = face[::-1] if turned else face
        lines.append(f"f {i + 1} {j + 1} {k + 1}")
    return "\n".join(lines) + "\n"


def own_meshes() -> dict[str, str]:
    """Return all meshes by file name, as Wavefront OBJ text."""
    return {
        "crane_mast.obj": obj_text(mast_struts(0.3, 3.3, 0.16), "mast of the crane"),
        "crane_jib.obj": obj_text(jib_struts(-1.4, 4.2, 0.17, 1.3), "jib of the crane"),
        "tool_cone.obj": cone_obj(),
        "tool_lever.obj": lever_obj(),
        "slim_tool_body.obj": slim_body_obj(),
    }


if __name__ == "__main__":
    for name, text in own_meshes().items():
        (MESHES / name).write_text(text)

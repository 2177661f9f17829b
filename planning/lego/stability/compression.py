"""Loads that bricks pass down by pushing alone: a fast sufficient test for stability.

A push on top of a brick goes through when its point lies in the convex hull of contacts below
that go through themselves, down to the plate. Such loads add up without any friction (pushing
is unlimited), so a structure whose bricks all rest like this has score 0, and neither pressing
where it goes through nor a further brick that rests like this can raise the score of another.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from planning.lego.bricks.assembly import PlacedBrick
from planning.lego.bricks.contacts import Joint, knob_points

Point = tuple[float, float]
Region = tuple[Point, ...]
"""Corners of a convex polygon, counter-clockwise; fewer than three where it has no area."""

_EPS = 1e-9
"""Points as near as this are the same [m], areas as small are none [m^2]."""


def resting_region(
    item: PlacedBrick, joints: Iterable[Joint], regions: Mapping[str, Region]
) -> Region:
    """Return where a push on a brick goes through to the plate.

    Args:
        item: the brick.
        joints: those with what it stands on.
        regions: of the bricks that it stands on.

    Returns:
        A convex region in the plate's plane [studs], empty for a brick that rests on nothing.
    """
    points = [
        (float(x), float(y))
        for joint in joints
        for stud in joint.studs
        for x, y in knob_points(item, stud)
        if joint.lower is None or contains(regions[joint.lower], (x, y))
    ]
    return convex_hull(points)


def contains(region: Region, point: Point) -> bool:
    """Return True when a point lies in a convex region or on its edge."""
    if not region:
        return False
    if len(region) == 1:
        return _near(region[0], point)
    if len(region) == 2:
        a, b = region
        along = (b[0] - a[0]) * (point[0] - a[0]) + (b[1] - a[1]) * (point[1] - a[1])
        length = (b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2
        return abs(_cross(a, b, point)) <= _EPS and -_EPS <= along <= length + _EPS
    previous = region[-1]
    for corner in region:
        if _cross(previous, corner, point) < -_EPS:
            return False
        previous = corner
    return True


def convex_hull(points: Sequence[Point]) -> Region:
    """Return the convex hull of points in the plane, counter-clockwise."""
    ordered = sorted(set(points))
    if len(ordered) < 3:
        return tuple(ordered)
    lower = _chain(ordered)
    upper = _chain(ordered[::-1])
    return tuple(lower[:-1] + upper[:-1])


def _chain(ordered: Sequence[Point]) -> list[Point]:
    chain: list[Point] = []
    for point in ordered:
        while len(chain) > 1 and _cross(chain[-2], chain[-1], point) <= _EPS:
            chain.pop()
        chain.append(point)
    return chain


def _cross(a: Point, b: Point, c: Point) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _near(a: Point, b: Point) -> bool:
    return abs(a[0] - b[0]) <= _EPS and abs(a[1] - b[1]) <= _EPS

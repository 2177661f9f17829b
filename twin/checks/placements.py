"""Checks of start poses: overlaps, unsupported objects, and centres of mass."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from planning.contacts.interference import format_depth, overlap_depth
from planning.contacts.touching import (
    PlacedObject,
    bounding_corners,
    nearby_entities,
    standing_fixtures,
)
from twin.checks.finding import (
    CheckContext,
    Finding,
    Findings,
    format_millimetres,
    format_position,
)

_MISPLACED = 0.002
"""A centre of mass no farther outside of its part is one of a measured part [m]."""

_MERGED = 0.005
"""Fixtures of one piece of furniture may overlap by this [m]."""


def check_starts(subject: CheckContext) -> Findings:
    """Yield objects that overlap or are unsupported at the start."""
    cell, touch = subject.cell, subject.checks.touch_m
    there = [item for item in cell.objects if not item.later]
    placed: list[tuple[str, PlacedObject]] = [
        (item.name, (item, item.start)) for item in there
    ]
    placed += list(standing_fixtures(cell).items())
    moved = {item.name for item in there if not item.fixed}
    things = dict(placed)
    overlaps = subject.checks.overlaps
    touched: dict[str, set[str]] = {}
    for one, other, gap in close_pairs(placed, touch, first=len(there)):
        most = overlaps.most(one, other)
        deep = overlap_depth(things[one], things[other]) if -gap > most else 0.0
        if deep > most:
            movable = one in moved or other in moved
            yield Finding(
                subject.thing_at(one, "start"),
                f"{one} and {other} overlap by {format_depth(deep)} at the start, and may by"
                f" {format_depth(most)}: no two things can be in one place",
                error=movable,
                code="overlap",
                parts=(one, other),
                figures=(deep, most),
            )
        touched.setdefault(one, set()).add(other)
        touched.setdefault(other, set()).add(one)
    resting = {item.name for item in cell.fixtures}
    ahead = list(resting)
    while ahead:
        for name in touched.get(ahead.pop(), set()) - resting:
            resting.add(name)
            ahead.append(name)
    for item in there:
        if item.name not in resting:
            yield Finding(
                subject.thing_at(item.name, "start"),
                f"{item.name} hangs in the air at the start: nothing that stands on a fixture is"
                f" within {format_millimetres(touch)} of it{_below(placed, item.name)}",
                code="unsupported",
                parts=(item.name,),
            )


def check_centres(subject: CheckContext) -> Findings:
    """Yield parts whose centre of mass is outside their bounding box."""
    for item in subject.cell.objects:
        shape = item.shape
        if shape.own_centre is None:
            continue
        beyond = np.maximum(shape.low - shape.own_centre, shape.own_centre - shape.high)
        if (farthest := float(np.max(beyond))) > _MISPLACED:
            low, high = (
                format_position(shape.low.tolist()),
                format_position(shape.high.tolist()),
            )
            yield Finding(
                subject.thing_at(item.name, "centre_of_mass_m"),
                f"the centre of mass of {item.name} is {format_millimetres(farthest)} outside it: in the frame of its"
                f" shape it reaches from {low} to {high}",
                code="centre",
                parts=(item.name,),
            )


def check_fixtures(subject: CheckContext) -> Findings:
    """Yield overlapping fixtures of the file; boxes of one fixture may overlap slightly."""
    placed = [
        (name, item)
        for name, item in standing_fixtures(subject.cell).items()
        if name in subject.own_fixtures
    ]
    for one, other, gap in close_pairs(placed, 0.0):
        if gap < -_MERGED:
            yield Finding(
                subject.thing_at(other),
                f"fixtures {one} and {other} overlap by {format_millimetres(-gap)}: harmless if they are one"
                " thing, a mistake if not",
            )


def close_pairs(
    placed: Sequence[tuple[str, PlacedObject]],
    within: float,
    *,
    first: int | None = None,
) -> Iterator[tuple[str, str, float]]:
    """Yield near pairs with their distance, negative for overlap [m].

    Args:
        placed: names and placed shapes.
        within: greatest distance [m].
        first: number of first entries that contain one of each pair; by default all.
    """
    if not placed:
        return
    corners = np.array([bounding_corners(item) for _, item in placed])
    centre = 0.5 * (corners[:, 0] + corners[:, 1])
    half = 0.5 * (corners[:, 1] - corners[:, 0])
    for i in range(len(placed) if first is None else first):
        apart = np.abs(centre[i + 1 :] - centre[i]) - half[i + 1 :] - half[i]
        near = i + 1 + np.flatnonzero(np.all(apart <= within, axis=1))
        others = dict(placed[j] for j in near.tolist())
        for other, gap in nearby_entities(placed[i][1], others, within).items():
            yield placed[i][0], other, gap


def _below(placed: Sequence[tuple[str, PlacedObject]], name: str) -> str:
    """Return a text on the object below, and its distance."""
    things: Mapping[str, PlacedObject] = dict(placed)
    low, high = bounding_corners(things[name])
    best: tuple[float, str] | None = None
    for other, item in things.items():
        other_low, other_high = bounding_corners(item)
        apart = np.any(low[:2] > other_high[:2]) or np.any(high[:2] < other_low[:2])
        drop = float(low[2] - other_high[2])
        if other == name or apart or drop < 0.0:
            continue
        if best is None or drop < best[0]:
            best = drop, other
    return "" if best is None else f"; {best[1]} is {format_millimetres(best[0])} below"

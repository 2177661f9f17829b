"""Comparison of two workcells: a plan is valid only in the cell for which it was computed."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np

from planning.cell.body import ConvexBody
from planning.cell.robot_model import RobotModel
from planning.cell.shape import Shape
from planning.cell.workcell import (
    Begun,
    CellObject,
    Clearances,
    Fixture,
    PlacedRobot,
    Workcell,
)

_SAME = 1e-9  # poses and sizes that differ by less are equal but for rounding [m, rad]


def cell_differences(planned: Workcell, given: Workcell) -> list[str]:
    """Return the differences between the cell that a plan was made for and another one.

    Not compared: objects that appear later, such as further bricks of feeding stations; and, for a plan
    that begins during a run, the poses of objects at its begin, and HOME of robots out of service.

    Args:
        planned: cell of the plan.
        given: cell of a scenario.

    Returns:
        One sentence per difference, each naming what differs; empty if the plan fits.
    """
    begun = planned.begun
    out = [
        *_compared(
            "robot",
            planned.robots,
            given.robots,
            partial(_robot, out=() if begun is None else begun.out),
        ),
        *_compared("fixture", planned.fixtures, given.fixtures, _fixture),
        *_compared(
            "object",
            [
                item
                for item in planned.objects
                if _is_there_at_start(item, given, begun)
            ],
            [item for item in given.objects if not item.later],
            partial(_object, starts=begun is None),
        ),
    ]
    if planned.clearances != given.clearances:
        out.append(
            f"the clearances are {_metres(planned.clearances)} in the plan,"
            f" {_metres(given.clearances)} here"
        )
    return out


def _is_there_at_start(item: CellObject, given: Workcell, begun: Begun | None) -> bool:
    """Tell whether an object of a plan is compared: one that is there at the start of the scenario."""
    if begun is None:
        return not item.later
    return any(item.name == own.name and not own.later for own in given.objects)


def _metres(clearances: Clearances) -> str:
    return (
        f"{clearances.robot_robot:g} and {clearances.robot_object:g} m"
        f" (contact tolerance {clearances.contact_tolerance:g} m, depth"
        f" {clearances.contact_depth:g} m)"
    )


def _compared(
    what: str,
    planned: Sequence[Any],
    given: Sequence[Any],
    differences: Callable[[Any, Any], Iterator[str]],
) -> Iterator[str]:
    names, others = [item.name for item in planned], [item.name for item in given]
    for name in names:
        if name not in others:
            yield f"{what} {name!r} of the plan is not in the cell"
    for name in others:
        if name not in names:
            yield f"{what} {name!r} is not in the plan"
    if sorted(names) == sorted(others) and names != others:
        yield f"the {what}s are in another order"
    by_name = dict(zip(others, given, strict=True))
    for item in planned:
        if item.name in by_name:
            for text in differences(item, by_name[item.name]):
                yield f"{what} {item.name!r} {text}"


def _robot(a: PlacedRobot, b: PlacedRobot, out: Collection[str]) -> Iterator[str]:
    if a.model.name != b.model.name or a.model.joint_names != b.model.joint_names:
        yield f"is a {a.model.name} in the plan, a {b.model.name} here"
        return
    yield from _moved("its base", a.base, b.base)
    if a.name not in out and not np.allclose(a.home, b.home, rtol=0.0, atol=_SAME):
        yield "has another HOME"
    if sorted(a.model.frames) != sorted(b.model.frames):
        yield "has other tool frames"
    else:
        for name, pose in a.model.frames.items():
            yield from _moved(f"its frame {name!r}", pose, b.model.frames[name])
    yield from _moved("its flange", a.model.flange, b.model.flange)
    for group in ("arm", "tool"):
        if not _same_bodies(_bodies(a.model, group), _bodies(b.model, group)):
            yield f"has another {group}: its shape, or where it sits, is not as it was planned"
    for what in ("lower", "upper", "velocity"):
        if not np.allclose(getattr(a.model, what), getattr(b.model, what)):
            yield f"has other joint limits ({what})"
    if a.model.grip != b.model.grip:
        yield "has a tool that holds in another way, or opens farther or less"


def _bodies(model: RobotModel, group: str) -> list[tuple[int, ConvexBody]]:
    """Return the bodies of an arm, or of its tool, each with the joint that moves it."""
    return [(part.joint, part.body) for part in model.parts if part.group == group]


def _same_bodies(
    a: Sequence[tuple[int, ConvexBody]], b: Sequence[tuple[int, ConvexBody]]
) -> bool:
    """Tell whether bodies have the same shapes, in the same order, and are moved by the same joints."""
    return len(a) == len(b) and all(
        one == other
        and p.vertices.shape == q.vertices.shape
        and np.allclose(p.vertices, q.vertices, rtol=0.0, atol=_SAME)
        for (one, p), (other, q) in zip(a, b, strict=True)
    )


def _fixture(a: Fixture, b: Fixture) -> Iterator[str]:
    yield from _reshaped(a.shape, b.shape)
    yield from _moved("it", a.pose, b.pose)


def _object(a: CellObject, b: CellObject, *, starts: bool) -> Iterator[str]:
    if a.kind != b.kind:
        yield f"is of type {a.kind!r} in the plan, {b.kind!r} here"
    yield from _reshaped(a.shape, b.shape)
    if starts:
        yield from _moved("it", a.start, b.start)


def _reshaped(a: Shape, b: Shape) -> Iterator[str]:
    if not np.allclose(a.size, b.size, rtol=0.0, atol=_SAME):
        yield f"measures {_vector(a.size)} m in the plan, {_vector(b.size)} m here"
    elif not _same_bodies([(0, p) for p in a.pieces], [(0, p) for p in b.pieces]):
        yield "has another shape of the same size in the plan than here"


def _moved(what: str, a: Any, b: Any) -> Iterator[str]:
    apart = float(np.linalg.norm(a[:3, 3] - b[:3, 3]))
    if apart > _SAME:
        yield f"has moved: {what} is {apart:.6g} m from where it was planned"
    elif not np.allclose(a[:3, :3], b[:3, :3], rtol=0.0, atol=_SAME):
        cosine = (np.trace(a[:3, :3].T @ b[:3, :3]) - 1.0) / 2.0
        degrees = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
        yield f"has turned: {what} by {degrees:.3g} degrees"


def _vector(values: Any) -> str:
    return " x ".join(f"{value:g}" for value in values)

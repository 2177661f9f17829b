"""Picture of a cell before the first motion, from above and from the side.

Robots are drawn as their collision hulls at HOME, their start configuration, with the reach of their tool frames.
Fixtures and objects are drawn at their start poses, and goal poses of objects as outlines.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from planning.cell.shape import Shape
from planning.cell.workcell import PlacedRobot
from planning.errors import OutputError
from planning.kinematics.kinematics import frame_pose, joint_poses_of
from planning.tasks.task import DOOR
from planning.transforms import Array, Transform
from twin.checks.close_ups import CloseUp, find_close_ups, panel_width
from twin.checks.finding import CheckContext
from twin.checks.labels import NAME_SIZE, Names
from twin.checks.views import (
    DrawnShape,
    Viewpoint,
    draw_axes,
    draw_shapes,
    placed_points,
    style_view,
    widen_rectangle,
)
from twin.drawing.looks import foot_position
from twin.drawing.pictures import INK, new_picture
from twin.drawing.team_colours import team_colours
from twin.host.atomic_files import save_png
from twin.scenario.sections.scenario import Scenario

PICTURE = "cell.png"
"""Name of the picture in a folder."""

_FIXTURE, _FIXTURE_EDGE, _GOAL = "#dfe3e8", "#a7afb9", "#5b6470"
_DOOR = "#c23b54"
_FIXTURE_NAME = "#6b7480"
_MOST_ASIDE = 12
"""Things that are named in a view from the side: more stand behind each other."""

_SAMPLES = 1500
"""Random configurations from which the reach of a robot is drawn."""

_CAPTION = (
    "robots at HOME by their collision hulls; dashed arcs: reach of their tools at any height;"
    " coloured axes: tool frames (x red, y green, z blue, out of the hand);"
    " dashed outlines: where things are put; dotted outlines: doors of machines, shut"
)

_ARROW = 0.1
"""Length of the axes of a tool frame, x red, y green, z blue [m]."""


_FROM_ABOVE = Viewpoint("from above", 0, 1, 2, 1.0)


def draw_cell(subject: CheckContext, folder: Path) -> Path:
    """Draw the start state of the cell, in two views at one scale.

    Args:
        subject: the scenario and its cell.
        folder: of the picture; it is made where it is missing.

    Returns:
        The file.

    Raises:
        OutputError: it cannot be written.
    """
    path = folder / PICTURE
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made: {error}") from error
    save_png(cell_figure(subject), path)
    return path


def scenario_figure(scenario: Scenario, folder: Path) -> Figure:
    """Return the picture of the cell of a scenario; see ``cell_figure``.

    Args:
        scenario: passed the checks of its file.
        folder: where relative paths in it start.
    """
    return cell_figure(CheckContext(scenario, folder))


def cell_figure(
    subject: CheckContext, *, width_in: float = 15.0, detail: bool = True
) -> Figure:
    """Return the picture of ``draw_cell``.

    It shows where things are and happen, not as far as robots reach; where things would be tiny they
    are drawn again, larger, below.

    Args:
        subject: the scenario and its cell.
        width_in: of the picture [in]; the narrower it is, the fewer names have room.
        detail: whether tiny things are repeated in close-ups.
    """
    things = list(_things_drawn(subject))
    shapes = [*things, *_robots_drawn(subject)]
    goals = [
        DrawnShape(corners, "none", _GOAL, None, 0.6, (0, (3, 2)))
        for _, corners in subject.checks.goal_pieces()
    ]
    goals += [
        DrawnShape(corners, "none", _DOOR, None, 1.2, (0, (1, 1.5)))
        for _, corners in _doors(subject)
    ]
    reaches = {r.name: reach_radius(r, _frame(r)) for r in subject.cell.robots}
    least, most = _extent(subject)
    size = np.maximum(most - least, 0.1)
    wide = 0.5 * (width_in - 1.4)
    tall = float(
        np.clip(wide / size[0] * max(size[1:]), 0.2 * width_in, 0.45 * width_in)
    )
    scale = max(float(size[0]) / wide, float(max(size[1:])) / tall) / 72.0
    boxes = np.array([box[:, :2] for _, box, _ in _things(subject)]).reshape(-1, 2, 2)
    below = min(4.0, 0.45 * width_in)
    larger = (
        find_close_ups(boxes, size[:2], scale, (width_in, below - 0.7))
        if detail
        else []
    )
    below = below if larger else 0.0
    picture = new_picture(width_in, tall + 1.3 + below, dpi=110)
    grid = picture.add_gridspec(
        2 if larger else 1,
        2 * max(len(larger), 1),
        height_ratios=[tall + 0.6, below] if larger else [1.0],
    )
    half = max(len(larger), 1)
    for k, view in enumerate((_FROM_ABOVE, Viewpoint.from_side())):
        area = picture.add_subplot(grid[0, k * half : (k + 1) * half])
        low, high = least[view.flat], most[view.flat]
        style_view(area, view)
        draw_shapes(area, view, shapes)
        draw_shapes(area, view, goals)
        names = Names(area, scale, low, high, adjacent=view.eye == 2)
        _draw_robots(area, view, subject, reaches, names)
        for item in larger if view.eye == 2 else ():
            _draw_frame(area, item, names)
        if view.eye == 2 or len(list(_things(subject))) <= _MOST_ASIDE:
            _draw_names(names, view, subject, again=larger if view.eye == 2 else ())
        area.set_xlim(low[0], high[0])
        area.set_ylim(low[1], high[1])
    for k, item in enumerate(larger):
        area = picture.add_subplot(grid[1, 2 * k : 2 * k + 2])
        wide = panel_width(width_in, len(larger))
        low, high = widen_rectangle(item.low, item.high, wide / (below - 0.7))
        style_view(area, _FROM_ABOVE, f"{item.letter}, larger, without robots")
        draw_shapes(area, _FROM_ABOVE, things)
        draw_shapes(area, _FROM_ABOVE, goals)
        names = Names(area, float(high[0] - low[0]) / (72.0 * wide), low, high)
        _draw_names(names, _FROM_ABOVE, subject, goals=True)
        area.set_xlim(low[0], high[0])
        area.set_ylim(low[1], high[1])
    picture.suptitle(
        f"{subject.scenario.name}: the cell before the first motion",
        color=INK,
        fontsize=12,
    )
    caption = fill(_CAPTION, width=int(14.0 * width_in))
    picture.supxlabel(caption, color=INK, fontsize=8)
    return picture


def _things(subject: CheckContext) -> Iterator[tuple[str, Array, bool]]:
    """Yield objects and their goals: names, corners of boxes, whether it is a goal."""
    for thing in subject.cell.objects:
        if not thing.later:
            yield thing.name, _box(thing.shape, thing.start), False
    for name, corners in _doors(subject):
        yield name, _bounds(corners), False
    for name, pieces in groupby(subject.checks.goal_pieces(), key=itemgetter(0)):
        yield name, _bounds(np.vstack([corners for _, corners in pieces])), True


def _doors(subject: CheckContext) -> Iterator[tuple[str, Array]]:
    """Yield the closed doors of machines: names, corners of each piece, shape (v, 3) [m]."""
    doors = [thing for thing in subject.cell.objects if thing.kind == DOOR]
    # A door that is shut several times is several objects.
    for thing in {own.start.tobytes(): own for own in reversed(doors)}.values():
        for piece in thing.shape.pieces:
            yield thing.name, placed_points(piece.vertices, thing.start)


def _box(shape: Shape, pose: Transform) -> Array:
    """Return the lower and the upper corner of an upright box around a shape, shape (2, 3) [m]."""
    corners = np.vstack([piece.vertices for piece in shape.pieces])
    return _bounds(placed_points(corners, pose))


def _bounds(corners: Array) -> Array:
    return np.array([corners.min(axis=0), corners.max(axis=0)])


def reach_radius(robot: PlacedRobot, frame: str) -> float | None:
    """Return the reach of a robot's tool from its base axis [m]; None for a mobile robot.

    It is measured at random configurations, so it falls short by a few per cent.
    """
    model = robot.model
    if model.is_mobile:
        return None
    rng = np.random.default_rng(0)
    drawn = rng.uniform(model.lower, model.upper, (_SAMPLES, model.dof))
    base = foot_position(robot)
    return max(
        float(np.linalg.norm((frame_pose(robot, q, frame)[:3, 3] - base)[:2]))
        for q in drawn
    )


def cell_shapes(subject: CheckContext) -> Iterator[DrawnShape]:
    """Yield the shapes of a cell before the first motion: fixtures of the file, objects, robots at HOME."""
    yield from _things_drawn(subject, own=True)
    yield from _robots_drawn(subject)


def _things_drawn(subject: CheckContext, *, own: bool = False) -> Iterator[DrawnShape]:
    for item in subject.cell.fixtures:
        if own and item.name not in subject.own_fixtures:
            continue
        face = _FIXTURE if item.colour is None else _unit(item.colour)
        for piece in item.shape.pieces:
            corners = placed_points(piece.vertices, item.pose)
            yield DrawnShape(corners, face, _FIXTURE_EDGE, 1.0)
    for thing in subject.cell.objects:
        if not thing.later:
            face = _unit(thing.colour)
            for piece in thing.shape.pieces:
                yield DrawnShape(
                    placed_points(piece.vertices, thing.start), face, INK, 0.95
                )


def _robots_drawn(subject: CheckContext) -> Iterator[DrawnShape]:
    colours = team_colours([robot.name for robot in subject.built.robots])
    for robot in subject.cell.robots:
        colour = colours[robot.name]
        poses = joint_poses_of(robot, robot.home)
        for part in robot.model.parts:
            corners = placed_points(part.body.vertices, poses[part.joint + 1])
            alpha = 0.9 if part.group == "tool" else 0.55
            yield DrawnShape(corners, colour, colour, alpha)


def _unit(colour: tuple[int, int, int]) -> tuple[float, float, float]:
    """Return a colour for matplotlib, channels from 0 to 1."""
    red, green, blue = (value / 255.0 for value in colour)
    return red, green, blue


def _extent(subject: CheckContext) -> tuple[Array, Array]:
    """Return the corners of the visible extent: all but an implicit floor."""
    corners = [shape.corners for shape in _robots_drawn(subject)]
    corners += [box for _, box, _ in _things(subject)]
    corners += [
        _box(item.shape, item.pose)
        for item in subject.cell.fixtures
        if item.name in subject.own_fixtures or float(np.max(item.size)) < 5.0
    ]
    every = np.vstack(corners)
    least, most = every.min(axis=0), every.max(axis=0)
    margin = 0.05 * float((most - least).max())
    return least - margin, most + margin


def _draw_frame(area: Axes, item: CloseUp, names: Names) -> None:
    """Draw the frame of a close-up, with its letter in a corner."""
    corners = [
        item.low,
        (item.high[0], item.low[1]),
        item.high,
        (item.low[0], item.high[1]),
    ]
    area.add_patch(
        Polygon(
            np.array(corners), closed=True, fill=False, edgecolor=INK, linewidth=0.8
        )
    )
    names.mark(np.array([item.low[0], item.high[1]]), item.letter, INK, NAME_SIZE + 1)


def _draw_robots(
    area: Axes,
    view: Viewpoint,
    subject: CheckContext,
    reaches: Mapping[str, float | None],
    names: Names,
) -> None:
    colours = team_colours([robot.name for robot in subject.built.robots])
    for robot in subject.cell.robots:
        base = foot_position(robot)
        radius = reaches[robot.name]
        if view.eye == 2 and radius is not None:
            area.add_patch(
                Circle(
                    (float(base[0]), float(base[1])),
                    radius,
                    fill=False,
                    edgecolor=colours[robot.name],
                    linestyle=(0, (5, 3)),
                    linewidth=1.0,
                )
            )
        tool = frame_pose(robot, robot.home, _frame(robot))
        draw_axes(area, view, tool, _ARROW)
        foot = joint_poses_of(robot, robot.home)[min(3, robot.model.dof)]
        at = foot[:3, 3] if robot.model.is_mobile else base
        names.mark(at[view.flat], robot.name, INK)


def _draw_names(
    names: Names,
    view: Viewpoint,
    subject: CheckContext,
    *,
    goals: bool = False,
    again: Sequence[CloseUp] = (),
) -> None:
    """Write names of objects and fixtures where they fit, small things first.

    With ``goals`` those of places, too; not of what is drawn again, and named there.
    """
    for name, box, goal in _things(subject):
        there = any(item.holds(box[:, view.flat]) for item in again)
        if goals or not (goal or there):
            names.name(box[:, view.flat], name, _GOAL if goal else INK)
    fixtures = [
        (f.name, _box(f.shape, f.pose))
        for f in subject.cell.fixtures
        if f.name in subject.own_fixtures
    ]
    for name, box in sorted(
        fixtures, key=lambda entry: float(np.ptp(entry[1], axis=0).max())
    ):
        names.name(box[:, view.flat], name, _FIXTURE_NAME)


def _frame(robot: PlacedRobot) -> str:
    return "tool" if "tool" in robot.model.frames else "flange"

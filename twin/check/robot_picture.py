"""A picture of one robot, or of one tool: its collision hulls and its frames, from two sides."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from planning.cell.robot_model import RobotModel
from planning.cell.workcell import PlacedRobot
from planning.kinematics.kinematics import joint_poses_of
from planning.transforms import Array, Transform, identity, inverse
from twin.check.picture import AXIS_COLOURS, hull_outline
from twin.host.pictures import INK, new_picture, save_png, style_axes

_ARM, _TOOL = "#7f93ab", "#d9822b"
_VIEWS = (("from the front (+x)", 1, 2, 0, 1.0), ("from the side (-y)", 0, 2, 1, -1.0))
"""Title, axes to the right and up, axis towards the eye and its sign."""


@dataclass(frozen=True)
class PicturedThing:
    """A robot at HOME, or a tool, as it is drawn.

    Attributes:
        title: above the picture.
        hulls: corners in the world, and whether they are of a tool.
        frames: by name, each a pose in the world.
    """

    title: str
    hulls: tuple[tuple[Array, bool], ...]
    frames: Mapping[str, Transform]


def picture_of_robot(model: RobotModel) -> PicturedThing:
    """Return a robot at its HOME."""
    robot = PlacedRobot(model.name, model, identity(), model.home)
    poses = joint_poses_of(robot, model.home)
    flange = poses[-1] @ model.flange
    frames = {"flange": flange}
    frames |= {name: flange @ pose for name, pose in model.frames.items()}
    hulls = tuple(
        (_placed(part.body.vertices, poses[part.joint + 1]), part.group == "tool")
        for part in model.parts
    )
    return PicturedThing(f"{model.name} at HOME", hulls, frames)


def picture_of_tool(model: RobotModel, title: str) -> PicturedThing:
    """Return the tool of a robot alone, as seen from the flange."""
    back = inverse(model.flange)
    hulls = tuple(
        (_placed(part.body.vertices, back), True)
        for part in model.parts
        if part.group == "tool"
    )
    return PicturedThing(title, hulls, {"root": identity()})


def save_picture(thing: PicturedThing, path: Path) -> None:
    """Draw something from the front and from the side.

    Raises:
        OutputError: the picture cannot be written.
    """
    save_png(_figure(thing), path)


def _figure(thing: PicturedThing) -> Figure:
    corners = np.vstack(
        [hull for hull, _ in thing.hulls]
        + [pose[None, :3, 3] for pose in thing.frames.values()]
    )
    least, most = corners.min(axis=0), corners.max(axis=0)
    size = float((most - least).max())
    picture = new_picture(12.0, 6.6, dpi=110)
    for (title, right, up, eye, towards), area in zip(
        _VIEWS, picture.subplots(1, 2), strict=True
    ):
        style_axes(area)
        area.set_aspect("equal")
        area.set_title(title, color=INK, fontsize=10, loc="left")
        area.set_xlabel("xyz"[right] + " [m]", color=INK)
        area.set_ylabel("xyz"[up] + " [m]", color=INK)
        for hull, tool in sorted(
            thing.hulls,
            key=lambda item: (item[1], float((towards * item[0][:, eye]).max())),
        ):
            colour = _TOOL if tool else _ARM
            area.add_patch(
                Polygon(
                    hull_outline(hull[:, [right, up]]),
                    closed=True,
                    facecolor=colour,
                    edgecolor=INK,
                    linewidth=0.6,
                    alpha=0.55,
                )
            )
        _draw_frames(area, thing, (right, up), 0.12 * size)
        area.set_xlim(least[right] - 0.15 * size, most[right] + 0.15 * size)
        area.set_ylim(least[up] - 0.15 * size, most[up] + 0.15 * size)
    picture.suptitle(thing.title, color=INK, fontsize=12)
    picture.supxlabel(
        "collision hulls: arm grey, tool orange; frames: x red, y green, z blue",
        color=INK,
        fontsize=8,
    )
    return picture


def _draw_frames(
    area: Axes, thing: PicturedThing, view: tuple[int, int], length: float
) -> None:
    right, up = view
    named: list[tuple[float, float]] = []
    for pose, names in _together(thing.frames):
        for axis, colour in enumerate(AXIS_COLOURS):
            tip = pose[:3, 3] + length * pose[:3, axis]
            area.plot(
                [pose[right, 3], tip[right]],
                [pose[up, 3], tip[up]],
                color=colour,
                linewidth=1.8,
                zorder=5,
            )
        at = float(pose[right, 3]), float(pose[up, 3])
        # Frames that are in one place in this view have their names one below the other.
        near = sum(np.hypot(at[0] - x, at[1] - y) < length for x, y in named)
        named.append(at)
        area.annotate(
            ", ".join(names),
            at,
            xytext=(8, -10 - 13 * near),
            textcoords="offset points",
            color=INK,
            fontsize=8,
            zorder=6,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 1.0},
        )


def _together(
    frames: Mapping[str, Transform],
) -> Iterator[tuple[Transform, list[str]]]:
    """Yield poses with the names of all frames that have them."""
    left = dict(frames)
    while left:
        pose = next(iter(left.values()))
        names = [name for name, other in left.items() if np.allclose(other, pose)]
        yield pose, names
        for name in names:
            del left[name]


def _placed(points: Array, pose: Transform) -> Array:
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3])

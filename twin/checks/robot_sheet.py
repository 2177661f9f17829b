"""Data sheets of robot and tool description files, as text, tables and a picture."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from planning.cell.motion_limits import MotionLimits
from planning.cell.robot_model import DriveLimits, RobotModel
from planning.cell.workcell import PlacedRobot
from planning.errors import FittingError, RobotModelError
from planning.files import resolve_file_name
from planning.kinematics.kinematics import joint_poses_of
from planning.robots.descriptions.fitting import Fitting, Tool
from planning.robots.descriptions.urdf_file import GivenLimits
from planning.robots.registry import ROBOTS, robot_model
from planning.timing.torque import explain_unchecked_efforts
from planning.transforms import Array, Transform, identity, inverse
from twin.checks.ignored_contacts import exemption_words, overlap_words
from twin.checks.overview import LinkRow, Overview, robot_overview
from twin.checks.tools import finger_gap, frame_warnings
from twin.checks.views import (
    DrawnShape,
    Viewpoint,
    draw_axes,
    draw_shapes,
    placed_points,
    style_view,
)
from twin.drawing.pictures import INK, new_picture
from twin.host.atomic_files import save_png
from twin.planning.fitted_robots import described_model
from twin.registry import HOOKS

_ARM_COLOUR, _TOOL_COLOUR = "#7f93ab", "#d9822b"
_VIEWS = (Viewpoint("from the front (+x)", 1, 2, 0, 1.0), Viewpoint.from_side())

_CARRIER = "iiwa14"
"""Robot on which a tool is mounted to look at it."""

_TOOL = "tool"

_NO_ARGUMENTS: Mapping[str, str] = MappingProxyType({})

Rows = Sequence[tuple[str, ...]]


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
        (placed_points(part.body.vertices, poses[part.joint + 1]), part.group == "tool")
        for part in model.parts
    )
    return PicturedThing(f"{model.name} at HOME", hulls, frames)


def picture_of_tool(model: RobotModel, title: str) -> PicturedThing:
    """Return the tool of a robot alone, as seen from the flange."""
    back = inverse(model.flange)
    hulls = tuple(
        (placed_points(part.body.vertices, back), True)
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
    for view, area in zip(_VIEWS, picture.subplots(1, 2), strict=True):
        style_view(area, view)
        for wanted, colour in ((False, _ARM_COLOUR), (True, _TOOL_COLOUR)):
            hulls = (hull for hull, tool in thing.hulls if tool == wanted)
            drawn = (DrawnShape(hull, colour, INK, 0.55, 0.6) for hull in hulls)
            draw_shapes(area, view, drawn)
        _draw_frames(area, thing, view, 0.12 * size)
        low, high = least[view.flat] - 0.15 * size, most[view.flat] + 0.15 * size
        area.set_xlim(low[0], high[0])
        area.set_ylim(low[1], high[1])
    picture.suptitle(thing.title, color=INK, fontsize=12)
    picture.supxlabel(
        "collision hulls: arm grey, tool orange; frames: x red, y green, z blue",
        color=INK,
        fontsize=8,
    )
    return picture


def _draw_frames(
    area: Axes, thing: PicturedThing, view: Viewpoint, length: float
) -> None:
    named: list[tuple[float, float]] = []
    for pose, names in _group_frames(thing.frames):
        draw_axes(area, view, pose, length)
        at = float(pose[view.right, 3]), float(pose[view.up, 3])
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


def _group_frames(
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


@dataclass(frozen=True)
class RobotSheet:
    """The data sheet of a robot or a tool.

    Attributes:
        title: name of the robot or tool.
        words: choices and warnings.
        tables: heading, columns and rows of each.
        picture: shapes for its picture.
    """

    title: str
    words: tuple[str, ...]
    tables: tuple[tuple[str, tuple[str, ...], Rows], ...]
    picture: PicturedThing

    def content(self) -> dict[str, Any]:
        """Return the sheet for JSON."""
        tables = {
            heading.partition(" (")[0]: [
                dict(zip(columns, row, strict=True)) for row in rows
            ]
            for heading, columns, rows in self.tables
        }
        return {"title": self.title, "notes": list(self.words), **tables}


def robot_sheets(
    which: str,
    held: Mapping[str, float],
    flange: str | None,
    xacro: Mapping[str, str] = _NO_ARGUMENTS,
) -> tuple[RobotSheet, ...]:
    """Return the sheets of a registered robot, of a file, or of the robots of a scenario.

    Args:
        which: a name, the path of a description, or that of a scenario.
        held: fixed joints and their values [rad or m]; not for scenarios.
        flange: the link that is the flange; not for scenarios.
        xacro: arguments of a description in xacro.

    Raises:
        RobotModelError: it is neither a robot nor a tool; with both reasons.
        ScenarioError: the scenario cannot be read.
    """
    if which not in ROBOTS and Path(which).suffix.lower() in (".yaml", ".yml"):
        return _of_scenario(Path(which))
    more = {"xacro": xacro} if xacro else {}
    try:
        model = described_model(which, Path(), Fitting(held=held, flange=flange), more)
    except RobotModelError as error:
        if which in ROBOTS:
            raise
        if isinstance(error, FittingError) and error.key == "limits":
            given = GivenLimits(velocity=(1.0,))
            with suppress(RobotModelError):
                fitting = Fitting(held=held, flange=flange, limits=given)
                model = described_model(which, Path(), fitting, more)
                return (_of_robot(model, str(model.name), error.message),)
        path = resolve_file_name(which, Path(), RobotModelError).resolve()
        if "description file" in HOOKS:
            path = HOOKS.load("description file")(path, xacro)
        if not path.is_file() or flange is not None:
            raise
        return (_of_tool(path, held, error),)
    return (_of_robot(model, str(model.name)),)


def _of_scenario(path: Path) -> tuple[RobotSheet, ...]:
    from planning.handling.tool_changes import with_each_tool
    from twin.planning.build_workcell import build_workcell
    from twin.reading.scenario_file import load_scenario

    robots: dict[tuple[object, ...], list[PlacedRobot]] = {}
    cell = build_workcell(load_scenario(path), path.parent)
    for robot in with_each_tool(cell.robots):
        frames = [(name, pose.tobytes()) for name, pose in robot.model.frames.items()]
        key = (robot.model.urdf, robot.home.tobytes(), *frames)
        robots.setdefault(key, []).append(robot)
    return tuple(
        _of_robot(
            replace(alike[0].model, home=alike[0].home),
            f"{alike[0].model.name} ({', '.join(robot.name for robot in alike)})",
        )
        for alike in robots.values()
    )


def _of_robot(model: RobotModel, title: str, no_speeds: str = "") -> RobotSheet:
    """Return the sheet of a robot; without speeds in its description, with the reason."""
    found = robot_overview(model)
    words = [f"{model.dof} joints; HOME {_list(model.home)} rad or m", *found.words]
    words += exemption_words(model)
    words += [f"doubtful: {text}" for text in overlap_words(model)]
    joints, rows = _joints(found)
    if no_speeds:
        words.append(f"no scenario can use it as it is: {no_speeds}")
        at = joints.index("velocity")
        moved = [(*row[:at], "unknown", *row[at + 1 :]) for row in rows[: model.dof]]
        rows = [*moved, *rows[model.dof :]]
    if model.drives is not None and math.isfinite(model.drives.payload):
        words.append(f"payload {model.drives.payload:g} kg, the tool included")
    if model.name in ROBOTS and (source := ROBOTS[model.name].limits_source):
        words.append(f"limits: {source}")
    reason = explain_unchecked_efforts(
        PlacedRobot(title, model, identity(), model.home)
    )
    if reason is None:
        words.append("efforts: kept to in plans within limits, by these masses")
    else:
        words.append(f"efforts: not kept to, as {reason}")
    if any("(usual)" in cell for row in rows for cell in row):
        words.append("(usual): not specified, and assumed by plans within limits")
    words += _grip_words(model)
    for name, pose in model.frames.items():
        words += [
            f"doubtful: frame {name!r} {text}" for text in frame_warnings(model, pose)
        ]
    frames = [("flange", model.flange_link, *_place(identity()))]
    frames += [(name, "", *_place(pose)) for name, pose in model.frames.items()]
    return RobotSheet(
        title,
        tuple(words),
        (
            (
                "joints (limits in rad or m, per s, s^2, s^3)",
                joints,
                rows,
            ),
            (
                "links (places in the frame of the base, joints at HOME)",
                *_links(found.links, identity()),
            ),
            (
                "tool frames (in the flange frame)",
                ("frame", "link", "xyz [m]", "z points along"),
                frames,
            ),
        ),
        picture_of_robot(model),
    )


def _of_tool(
    path: Path, held: Mapping[str, float], reason: RobotModelError
) -> RobotSheet:
    """Return the sheet of a tool alone, as it is on a flange."""
    tool = Tool(name=_TOOL, description=path, held=held, tcp=identity())
    try:
        model = robot_model(_CARRIER, None, Fitting(tool=tool))
    except RobotModelError as error:
        raise RobotModelError(
            f"it is no robot: {reason}; and no tool: {error}"
        ) from None
    found, prefix = robot_overview(model), f"{_TOOL}."
    joints = {
        name.removeprefix(prefix): f"{value:.6g}"
        for name, value in found.held.items()
        if name.startswith(prefix)
    }
    links = [row for row in found.links if row.name.startswith(prefix)]
    root = next(row.pose for row in links if not row.parent.startswith(prefix))
    words = (
        f"a tool, as it is no robot: {reason}",
        "its joints are held as below: 'joints' of a tool, or --hold, holds them elsewhere",
    )
    links = [
        row if row.parent.startswith(prefix) else replace(row, parent="", joint="")
        for row in links
    ]
    columns, shown = _links(links, root)
    extents = _extents(model, inverse(model.flange))
    columns = (*columns, "bodies from [m]", "bodies to [m]")
    shown = [
        (*row, *extents.get(link.name, ("", "")))
        for row, link in zip(shown, links, strict=True)
    ]
    title = f"{path.stem} from {path.name}"
    return RobotSheet(
        title,
        words,
        (
            ("joints (held at, rad or m)", ("joint", "held at"), [*joints.items()]),
            (
                "links (places in the frame of its root)",
                columns,
                [tuple(cell.removeprefix(prefix) for cell in row) for row in shown],
            ),
        ),
        picture_of_tool(model, f"{path.stem} as seen from its root"),
    )


def _extents(model: RobotModel, back: Transform) -> dict[str, tuple[str, str]]:
    """Return the least and the greatest corner of the bodies of each link of a tool."""
    corners: dict[str, list[Array]] = {}
    for part in model.parts:
        if part.group == "tool":
            placed = placed_points(part.body.vertices, back)
            link = part.body.name.rpartition("_")[0]
            corners.setdefault(link, []).append(np.asarray(placed))
    return {
        link: (_list(np.vstack(all_).min(axis=0)), _list(np.vstack(all_).max(axis=0)))
        for link, all_ in corners.items()
    }


def _grip_words(model: RobotModel) -> list[str]:
    if model.grip is None:
        return []
    if model.grip.opening is None:
        return [f"{model.grip.tool} holds by suction"]
    least, most = model.grip.opening
    out = f"{model.grip.tool}: fingers open from {1e3 * least:g} to {1e3 * most:g} mm"
    gap = finger_gap(model, model.frames.get("tool", identity()))
    return [out + ("" if gap is None else f", held {1e3 * gap:.1f} mm apart")]


def _joints(found: Overview) -> tuple[tuple[str, ...], Rows]:
    columns = (
        "joint",
        "kind",
        "lower",
        "upper",
        "velocity",
        "acceleration",
        "jerk",
        "effort",
    )
    model, usual = found.model, MotionLimits.of(found.model)
    drives = model.drives or DriveLimits(*np.full((3, model.dof), np.inf))
    rows = []
    for k, name in enumerate(model.joint_names):
        kind = "slides [m]" if model.chain.prismatic[k] else "turns [rad]"
        limits = [model.lower[k], model.upper[k], model.velocity[k]]
        row = [name, kind, *(f"{value:.6g}" for value in limits)]
        for own, other in (
            (drives.acceleration, usual.acceleration),
            (drives.jerk, usual.jerk),
        ):
            row.append(
                f"{own[k]:.6g}" if np.isfinite(own[k]) else f"{other[k]:.6g} (usual)"
            )
        effort, unit = drives.effort[k], "N" if model.chain.prismatic[k] else "N m"
        known = np.isfinite(effort)
        rows.append((*row, f"{effort:.6g} {unit}" if known else "unknown"))
    held = ((n, f"held at {at:.6g}", *[""] * 6) for n, at in found.held.items())
    return columns, [*rows, *held]


def _links(rows: Sequence[LinkRow], root: Transform) -> tuple[tuple[str, ...], Rows]:
    columns = (
        "link",
        "hangs on",
        "by joint",
        "part of",
        "bodies",
        "xyz [m]",
        "z points along",
    )
    back = inverse(root)
    return columns, [
        (
            row.name,
            row.parent,
            row.joint,
            row.group,
            str(row.bodies),
            *_place(back @ row.pose),
        )
        for row in rows
    ]


def _place(pose: Transform) -> tuple[str, str]:
    return _list(pose[:3, 3]), _list(pose[:3, 2])


def _list(values: Any) -> str:
    rounded = np.round(np.asarray(values, dtype=float), 4) + 0.0
    return "(" + ", ".join(f"{value:g}" for value in rounded) + ")"

"""Overview of a robot description file: fixed joints, links with their poses, and likely mistakes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from planning.cell.robot_model import RobotModel
from planning.robots.descriptions.empty_shapes import EMPTY
from planning.robots.descriptions.fitting import written_options
from planning.robots.descriptions.urdf_file import tip_link
from planning.robots.descriptions.urdf_geometry import joint_link, pose_in_root
from planning.robots.descriptions.xml_files import read_xml
from planning.transforms import Transform

_LEVER = 0.001
"""A flange farther than this from the axis of its joint is swung by it [m]."""

_PARALLEL = 0.99
"""Cosine of the angle between axes that count as parallel."""

_MOST_TURNED, _FASTEST, _LONGEST = 60.0, 30.0, 50.0
"""Range of a joint that turns [rad], its speed [rad/s], and range of one that slides [m]: arms have less."""

_SMALLEST = 0.01
"""The largest body of an arm is longer than this share of the arm."""


@dataclass(frozen=True)
class LinkRow:
    """A link of a description.

    Attributes:
        name: of the link.
        parent: link that it hangs on, empty for the root.
        joint: joint in between.
        group: ``arm`` or ``tool``; ``flange`` for the link whose frame that is.
        bodies: number of its collision shapes.
        pose: of its frame in that of the root, joints at HOME.
    """

    name: str
    parent: str
    joint: str
    group: str
    bodies: int
    pose: Transform


@dataclass(frozen=True)
class Overview:
    """Contents of a robot description.

    Attributes:
        model: the robot.
        held: joints that are held, and at what [rad or m].
        links: in the order of the file.
        left_out: links with collision shapes that were left out as they have no volume, in words.
        doubts: quantities that are likely missing or in a wrong unit, in words.
        words: notes on all of this and on the flange.
    """

    model: RobotModel
    held: Mapping[str, float]
    links: tuple[LinkRow, ...]
    left_out: tuple[str, ...]
    doubts: tuple[str, ...]
    words: tuple[str, ...]


def robot_overview(model: RobotModel) -> Overview:
    """Return the contents of the description of a robot."""
    root = read_xml(model.urdf)
    values = dict(zip(model.joint_names, model.home.tolist(), strict=True))
    held = {
        str(joint.get("name")): float(value)
        for joint in root.findall("joint")
        if (value := joint.get("held")) is not None
    }
    tool = _tool_links(root, model)
    links = _links(root, values, model.urdf, tool, model.flange_link)
    left_out = tuple(_left_out(root))
    doubts = tuple(_doubts(root, model))
    words = _words(model, links, left_out, doubts)
    return Overview(model, held, links, left_out, doubts, tuple(words))


def _links(
    root: Element,
    values: Mapping[str, float],
    path: Path,
    tool: set[str],
    flange: str,
) -> tuple[LinkRow, ...]:
    above = {joint_link(joint, "child"): joint for joint in root.findall("joint")}
    rows = []
    for element in root.findall("link"):
        name = str(element.get("name"))
        joint = above.get(name)
        rows.append(
            LinkRow(
                name,
                "" if joint is None else joint_link(joint, "parent"),
                "" if joint is None else str(joint.get("name")),
                "flange" if name == flange else "tool" if name in tool else "arm",
                len(element.findall("collision")),
                pose_in_root(name, above, values, str(path)),
            )
        )
    return tuple(rows)


def _words(
    model: RobotModel,
    links: tuple[LinkRow, ...],
    left_out: tuple[str, ...],
    doubts: tuple[str, ...],
) -> list[str]:
    out = [f"flange: link {model.flange_link!r}, z out of it"]
    doubt = flange_warning(model)
    if doubt is not None:
        out[0] = f"flange: link {model.flange_link!r}"
        out.append(f"doubtful: {doubt}")
    out += [f"left out: {text}" for text in left_out]
    out += [f"doubtful: {text}" for text in doubts]
    tip = tip_link(tuple(row.name for row in links if row.group == "tool"))
    if tip is not None:
        out.append(f"the link {tip!r} is named as a tool's tip")
    return out


def _tool_links(root: Element, model: RobotModel) -> set[str]:
    notes = written_options(root)
    tool = set(notes.tool_links or ()) if notes else set[str]()
    return tool | {
        part.body.name.rpartition("_")[0]
        for part in model.parts
        if part.group == "tool"
    }


def _left_out(root: Element) -> list[str]:
    return [
        f"collision shapes of link {link.get('name')!r} ({kinds.replace(' ', ', ')}) have a size of 0, no"
        " triangles or no geometry: nothing can touch them"
        for link in root.findall("link")
        if (kinds := link.get(EMPTY))
    ]


def _doubts(root: Element, model: RobotModel) -> list[str]:
    """Return warnings of likely wrong units and of missing properties."""
    out, span = [], model.upper - model.lower
    slides = model.chain.prismatic
    checks = (
        (~slides & (span > _MOST_TURNED), span, "range", "rad", "degrees"),
        (~slides & (model.velocity > _FASTEST), model.velocity, "velocity", "rad/s", "degrees per second"),
        (slides & (span > _LONGEST) & (not model.is_mobile), span, "range", "m", "millimetres"),
    )  # fmt: skip
    for odd, values, what, unit, other in checks:
        if odd.any():
            k = int(np.argmax(odd))
            out.append(
                f"joint {model.joint_names[k]!r} has a {what} of {values[k]:g} {unit}: is that in {other}?"
            )
    angles = _numbers(origin.get("rpy", "") for origin in root.iter("origin"))
    if max(map(abs, angles), default=0.0) > 2.0 * np.pi + 0.01:
        worst = max(angles, key=abs)
        out.append(f"an <origin> has rpy {worst:g} rad: is that in degrees?")
    masses = _numbers(own.get("value", "") for own in root.iter("mass"))
    if min(masses, default=0.0) < 0.0:
        out.append(f"a link has a mass of {min(masses):g} kg, which no body has")
    sizes = [
        float(np.ptp(p.body.vertices, axis=0).max())
        for p in model.parts
        if p.group == "arm" and p.joint >= 0
    ]
    length = float(np.linalg.norm(model.chain.placement[:, :3, 3], axis=1).sum())
    if not sizes:
        out.append(
            "no link that moves has a collision shape: nothing notices what the arm passes through"
        )
    elif max(sizes) < _SMALLEST * length:
        out.append(
            f"its largest collision shape measures {1e3 * max(sizes):.2g} mm, and its joints are"
            f" {1e3 * length:.3g} mm apart: is the scale of its meshes right?"
        )
    return out


def _numbers(texts: Iterable[str]) -> list[float]:
    """Return the numbers in texts; others are refused where they are needed."""
    found = []
    for word in " ".join(texts).split():
        with suppress(ValueError):
            found.append(float(word))
    return found


def flange_warning(model: RobotModel) -> str | None:
    """Return a warning of a doubtful flange, None for none.

    On all but few robots the last joint is a roll joint: its axis is z of the flange. The axis of a pitch joint,
    about which the flange swings, is perpendicular to the direction of the tool: there the flange lies in that direction
    from the joint.
    """
    chain = model.chain
    if chain.prismatic[-1]:
        return None
    out, at = chain.axis[-1], model.flange[:3, 3]
    along = float(at @ out)
    lever = at - along * out
    length = float(np.linalg.norm(lever))
    why = "the last joint turns it about that axis"
    if _is_pitch_joint(model) or length > max(_LEVER, abs(along)):
        if length <= _LEVER:
            return None  # the flange is where the joint is: nothing says where a tool points
        out, why = lever / length, "it lies there from the last joint, which swings it"
    parts = np.abs(model.flange[:3, :3].T @ out)
    axis = int(np.argmax(parts))
    if axis == 2 or parts[axis] < 0.99:
        return None
    return (
        f"{'xyz'[axis]} points out of the flange {model.flange_link!r} and not z, as {why}; so it is in"
        " ROS-Industrial's links called flange; tools and parts would hang beside it: name another link with"
        " 'flange' (often tool0), or turn the tool with 'mount'"
    )


def _is_pitch_joint(model: RobotModel) -> bool:
    """Tell whether the axis of the last joint is parallel to that of the joint before it."""
    chain = model.chain
    if model.dof < 2 or chain.prismatic[-2]:
        return False
    before = chain.placement[-1][:3, :3].T @ chain.axis[-2]
    return abs(float(before @ chain.axis[-1])) > _PARALLEL

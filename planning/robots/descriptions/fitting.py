"""Changes of a robot description by a scenario (tool, flange, limits, fixed joints), and their XML form.

A tool mass given in the scenario replaces the sum of the masses of the tool's links. A joint with a given
constant value becomes a fixed joint, and so do all joints that mimic it.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal
from xml.etree.ElementTree import Element, SubElement

from planning.cell.robot_model import ToolGrip
from planning.cell.shape import Element as PlacedForm
from planning.errors import RobotModelError
from planning.robots.descriptions.urdf_file import GivenLimits, UrdfOptions
from planning.robots.descriptions.urdf_geometry import (
    TURNING,
    joint_motion,
    origin_pose,
    write_pose,
)
from planning.robots.descriptions.xml_files import parse_number, parse_vector
from planning.transforms import Array, Transform, identity, read_only_copy

BY_HAND = "ignore_contacts"
"""Reason of a pair of links that the cell exempts from self-collision checks."""

_ELEMENT = "assembly_twin"
_INERTIAS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")

_SHORTEST = 0.01
"""Least length of a tool [m]."""

_SLACK = 1e-6
"""Tolerance by which a value may exceed a limit, for rounding in files [rad or m]."""


@dataclass(frozen=True, kw_only=True)
class Tool:
    """A tool of a cell, independent of any robot.

    Attributes:
        name: unique in the cell.
        description: its URDF or MJCF file; None for a tool that is given by shapes.
        shapes: of a tool without a description, in the frame of its one link.
        within: greatest depth of hollows that the convex pieces of its meshes may fill; None for one hull
            for each mesh [m].
        held: its joints with the values at which they are held; zero for joints left out [rad or m].
        mount: pose of its root link in the flange frame of a robot.
        tcp: pose of its tool frame in the frame of its root link, z out of the hand; None for the link
            with that name in the description.
        closing: axis of that frame along which fingers close.
        frames: further frames, each a pose in the frame of the root link.
        grip: how it holds; None for tools that hold nothing.
        mass: total mass; None for the sum of the masses in its description [kg].
    """

    name: str
    description: Path | None = None
    shapes: tuple[PlacedForm, ...] = ()
    within: float | None = None
    held: Mapping[str, float] = field(default_factory=dict)
    mount: Transform = field(default_factory=identity)
    tcp: Transform | None = None
    closing: Literal["x", "y"] = "y"
    frames: Mapping[str, Transform] = field(default_factory=dict)
    grip: ToolGrip | None = None
    mass: float | None = None


@dataclass(frozen=True, kw_only=True)
class Fitting:
    """Changes that a cell makes to the description of a robot.

    Attributes:
        tool: the mounted tool; None for the robot's own.
        bare: whether nothing is mounted, not even the robot's own tool: its tools are handled as objects,
            which may touch the bodies behind its last joint.
        flange: link whose frame is the flange; None for the one given in the description. Of a description that
            branches, the joints that do not lead there are held.
        held: joints of the description that are held, with their values [rad or m].
        limits: joint limits that replace those of the description.
        removed: links of other robots in the same description, which are removed with all that hangs on them.
        emptied: links that the robot shares with those, whose shapes are fixtures of the cell.
        looks: whether these links are drawn with the robot.
        ignored: pairs of links that self-collision checks skip, each with the reason.
        home: HOME by joint, where none is known; used if it names all joints of the arm [rad or m].
        proposed: links that are the flange where none is given and no link is called tool0.
    """

    tool: Tool | None = None
    bare: bool = False
    flange: str | None = None
    held: Mapping[str, float] = field(default_factory=dict)
    limits: GivenLimits = field(default_factory=GivenLimits)
    removed: frozenset[str] = frozenset()
    emptied: frozenset[str] = frozenset()
    looks: bool = False
    ignored: Mapping[tuple[str, str], str] = field(default_factory=dict)
    home: Mapping[str, float] = field(default_factory=dict)
    proposed: tuple[str, ...] = ()

    @property
    def is_nothing(self) -> bool:
        """Whether the description stays unchanged."""
        return self == Fitting()


def write_options(root: Element, options: UrdfOptions) -> None:
    """Add the properties of a robot other than links and joints to its description."""
    assert options.flange_link is not None
    notes = SubElement(root, _ELEMENT, flange=options.flange_link)
    if options.home is not None:
        notes.set("home", " ".join(repr(float(value)) for value in options.home))
    if options.payload is not None:
        notes.set("payload_kg", repr(float(options.payload)))
    if options.tool_links is not None:
        tool = SubElement(notes, "tool")
        for link in options.tool_links:
            SubElement(tool, "part", link=link)
    if options.grip is not None:
        grip = SubElement(notes, "grip", tool=options.grip.tool)
        if options.grip.opening is not None:
            least, most = options.grip.opening
            grip.set("opening_m", f"{least!r} {most!r}")
        if options.grip.force is not None:
            grip.set("force_n", repr(float(options.grip.force)))
    for name, pose in (options.frames or {}).items():
        write_pose(SubElement(notes, "frame", name=name), pose)
    for (first, second), why in options.ignored.items():
        SubElement(notes, "ignored", first=first, second=second, why=why)


def written_options(root: Element) -> UrdfOptions | None:
    """Return the options that ``write_options`` wrote into a description; None if there are none.

    Raises:
        RobotModelError: a value that should be a number is not.
    """
    notes = root.find(_ELEMENT)
    if notes is None:
        return None
    tool, grip = notes.find("tool"), notes.find("grip")
    payload, home = notes.get("payload_kg"), notes.get("home")
    frames = {
        frame.get("name", ""): read_only_copy(
            origin_pose(frame.find("origin"), "a <frame>")
        )
        for frame in notes.findall("frame")
    }
    return UrdfOptions(
        home=None
        if home is None
        else parse_vector(home, "home of <assembly_twin>", len(home.split())),
        flange_link=notes.get("flange"),
        tool_links=None
        if tool is None
        else tuple(part.get("link", "") for part in tool.findall("part")),
        frames=frames or None,
        grip=None if grip is None else _grip(grip),
        payload=None if payload is None else parse_number(payload, "payload_kg"),
        ignored=ignored_pairs(root),
    )


def ignored_pairs(root: Element) -> dict[tuple[str, str], str]:
    """Return the pairs of links of a written description that self-collision checks skip, with reasons."""
    return {
        (pair.get("first", ""), pair.get("second", "")): pair.get("why", "")
        for pair in root.findall(f"{_ELEMENT}/ignored")
    }


def _grip(element: Element) -> ToolGrip:
    text, tool = element.get("opening_m"), element.get("tool", "tool")
    force = element.get("force_n")
    presses = None if force is None else parse_number(force, "force_n of a <grip>")
    if text is None:
        return ToolGrip(None, tool, presses)
    least, most = parse_vector(text, "opening_m of a <grip>", 2)
    return ToolGrip((least, most), tool, presses)


def set_total_mass(
    body: Element, link: str, mass: float, centre: Array, length: float
) -> None:
    """Scale the masses of the links to a total mass.

    Links with masses keep their shares of the total. If no link has a mass, one link gets the total mass, with the
    moment of inertia of a rod across its axis.

    Args:
        body: root element of a URDF, which is changed.
        link: link that gets the total mass if no link has a mass.
        mass: total mass [kg].
        centre: centre of mass in the frame of that link, shape (3,) [m].
        length: length of the rod [m].

    Raises:
        RobotModelError: a mass of the description is no number.
    """
    given = [
        (mass, mass.get("value", "0")) for mass in body.findall("link/inertial/mass")
    ]
    masses = [parse_number(value, "mass of a link") for _, value in given]
    if sum(masses) > 0.0:
        share = mass / sum(masses)
        for (element, _), own in zip(given, masses, strict=True):
            element.set("value", repr(own * share))
        for inertia in body.findall("link/inertial/inertia"):
            for key in _INERTIAS:
                own = parse_number(inertia.get(key, "0"), "inertia of a link")
                inertia.set(key, repr(own * share))
        return
    for element in body.findall("link"):
        for empty in element.findall("inertial"):
            element.remove(empty)
        if element.get("name") == link:
            turning = mass * max(length, _SHORTEST) ** 2 / 12.0
            inertial = SubElement(element, "inertial")
            SubElement(inertial, "origin", xyz=" ".join(map(repr, centre.tolist())))
            SubElement(inertial, "mass", value=repr(mass))
            same = {
                key: repr(turning if key[1] == key[2] else 0.0) for key in _INERTIAS
            }
            SubElement(inertial, "inertia", same)


def hold_joints(root: Element, path: Path, values: Mapping[str, float]) -> None:
    """Fix joints at given values, with all joints that mimic them.

    Args:
        root: root element of a URDF, which is changed.
        path: its file, for messages.
        values: values by joint name; joints that mimic others may be included [rad or m].

    Raises:
        RobotModelError: there is no such joint, it cannot be held, or a value exceeds its limits.
    """
    joints = {str(joint.get("name")): joint for joint in root.findall("joint")}
    for name, value in values.items():
        if name not in joints or joints[name].get("type") == "fixed":
            choices = _free_joints(root)
            raise RobotModelError(
                f"{path} has no joint {name!r} to hold"
                + ("" if choices else ": it has none that moves"),
                choices=choices,
            )
        _require_within(joints[name], value, f"{path}: joint {name!r}")
    for name, value in _with_followers(joints, values, path).items():
        _fix(joints[name], value, f"{path}: joint {name!r}")


def hold_all_joints(
    root: Element,
    path: Path,
    values: Mapping[str, float],
    moving: Collection[str] = (),
) -> None:
    """Fix all joints but those that move: those without a value at zero, or at the nearest limit."""
    held = dict(values)
    for joint in root.findall("joint"):
        name = str(joint.get("name"))
        fixed = joint.get("type") == "fixed" or joint.find("mimic") is not None
        if fixed or name in moving:
            continue
        lower, upper = _range(joint, f"{path}: joint {name!r}")
        held.setdefault(name, min(max(0.0, lower), upper))
    hold_joints(root, path, held)
    for name in _free_joints(root):
        if name not in moving:
            why = "that is not there" + (" or that the arm moves" if moving else "")
            raise RobotModelError(
                f"{path}: joint {name!r} mimics a joint {why}; name it among the joints that are held"
            )


def _free_joints(root: Element) -> tuple[str, ...]:
    """Return the names of the joints that are not fixed."""
    return tuple(
        str(joint.get("name"))
        for joint in root.findall("joint")
        if joint.get("type") != "fixed"
    )


def free_kinds(root: Element) -> frozenset[str]:
    """Return the joints of unsupported kinds, which can only be held at zero."""
    return frozenset(
        str(joint.get("name"))
        for joint in root.findall("joint")
        if joint.get("type") not in (*TURNING, "prismatic", "fixed")
    )


def _with_followers(
    joints: Mapping[str, Element], values: Mapping[str, float], path: Path
) -> dict[str, float]:
    """Return the values of held joints and of the joints that mimic them."""

    def value_of(name: str, followed: tuple[str, ...]) -> float | None:
        if name in values:
            return values[name]
        mimic = joints[name].find("mimic") if name in joints else None
        if mimic is None or joints[name].get("type") == "fixed":
            return None
        if name in followed:
            raise RobotModelError(f"{path}: joint {name!r} mimics itself")
        where = f"{path}: joint {name!r}, <mimic>"
        factor = parse_number(mimic.get("multiplier", "1"), f"{where} multiplier")
        offset = parse_number(mimic.get("offset", "0"), f"{where} offset")
        leader = value_of(str(mimic.get("joint")), (*followed, name))
        return None if leader is None else factor * leader + offset

    found = {name: value_of(name, ()) for name in joints}
    return {name: value for name, value in found.items() if value is not None}


def _range(joint: Element, where: str) -> tuple[float, float]:
    limit = joint.find("limit")
    if limit is None or joint.get("type") == "continuous":
        return -math.inf, math.inf
    lower = parse_number(limit.get("lower", "0"), f"{where}, lower limit")
    upper = parse_number(limit.get("upper", "0"), f"{where}, upper limit")
    if lower > upper:
        raise RobotModelError(f"{where} has an empty range: {lower:g} to {upper:g}")
    return lower, upper


def _require_within(joint: Element, value: float, where: str) -> None:
    lower, upper = _range(joint, where)
    if lower == upper:
        return  # an empty range stands for missing limits
    if not lower - _SLACK <= value <= upper + _SLACK:
        raise RobotModelError(
            f"{where} cannot be held at {value:g}: its limits are {lower:g} and {upper:g} (rad or m)"
        )


def _fix(joint: Element, value: float, where: str) -> None:
    kind = joint.get("type")
    pose = origin_pose(joint.find("origin"), where)
    if kind in (*TURNING, "prismatic"):
        pose = pose @ joint_motion(joint, value, where)
    elif value != 0.0:
        raise RobotModelError(
            f"{where} is of type {kind!r}: it can be held at 0 only, not at {value:g}"
        )
    for child in list(joint):
        if child.tag not in ("parent", "child", "origin"):
            joint.remove(child)
    joint.set("type", "fixed")
    joint.set("held", repr(float(value)))  # for human readers; parsers ignore it
    if kind != "fixed" and not (value == 0.0 and joint.find("origin") is None):
        write_pose(joint, pose)

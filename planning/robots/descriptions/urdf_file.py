"""Checks of the joints of a URDF file, and detection of its flange link."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree.ElementTree import Element

from planning.bounds import FARTHEST, FASTEST_DESCRIBED, SLOWEST
from planning.cell.robot_model import ToolGrip
from planning.errors import FittingError, RobotModelError
from planning.robots.descriptions.urdf_geometry import joint_axis, joint_link
from planning.robots.descriptions.xml_files import (
    check_meshes,
    check_numbers,
    parse_number,
    required_attribute,
    search_folders,
)
from planning.transforms import Transform, identity

_MOVING = ("revolute", "continuous", "prismatic")
_CONTINUOUS_LIMIT = 2.0 * math.pi


BY_JOINT = ("velocity", "acceleration", "jerk", "effort")
"""Limits with one value per joint."""

_FLANGES = ("tool0", "flange")
"""Names of flanges, best first. On ROS-Industrial robots z points out of the flange in ``tool0``,
and x does in ``flange``; on others ``flange`` is all there is."""

_TIP = re.compile(
    r"(^|[_./-])(tcp|tool_cent(er|re)_point|grasp_?target|grasp(_frame)?|pinch|tool_tip)$",
    re.IGNORECASE,
)


@dataclass(frozen=True, kw_only=True)
class GivenLimits:
    """Joint limits that override those of a description.

    Attributes:
        velocity: one value for all joints, or one for each [rad/s or m/s].
        acceleration: likewise [rad/s^2 or m/s^2].
        jerk: likewise [rad/s^3 or m/s^3].
        effort: likewise [N m or N].
        payload: the most that it may carry, its tool included [kg].
    """

    velocity: tuple[float, ...] | None = None
    acceleration: tuple[float, ...] | None = None
    jerk: tuple[float, ...] | None = None
    effort: tuple[float, ...] | None = None
    payload: float | None = None

    def by_joint(self) -> Mapping[str, tuple[float, ...]]:
        """Return the given limits of joints, by their URDF attribute names."""
        given = {key: getattr(self, key) for key in BY_JOINT}
        return {key: values for key, values in given.items() if values is not None}


@dataclass(frozen=True, kw_only=True)
class UrdfOptions(GivenLimits):
    """Properties of a robot that its description leaves open, or that replace it.

    Attributes:
        name: of the robot type; the file's stem by default.
        home: HOME, joint by joint; by default zero, clamped to the limits [rad or m].
        frozen: joints to hold still, such as gripper fingers, and their values [rad or m].
        flange_link: link whose frame is the flange; by default the link called ``flange`` or
            ``tool0``, else the last moved link.
        flange_offset: pose of the flange in that link.
        tool_links: links that are the tool; by default those that hang on the flange.
        frames: tool frames in the flange frame; by default ``tool``, the frame of the last
            link that hangs on the flange.
        grip: how the tool holds; None where nothing is known.
        ignored: pairs of links that self-collision checks skip, each with the reason.
    """

    name: str | None = None
    home: tuple[float, ...] | None = None
    frozen: Mapping[str, float] = field(default_factory=dict)
    flange_link: str | None = None
    flange_offset: Transform = field(default_factory=identity)
    tool_links: tuple[str, ...] | None = None
    frames: Mapping[str, Transform] | None = None
    grip: ToolGrip | None = None
    ignored: Mapping[tuple[str, str], str] = field(default_factory=dict)


@dataclass(frozen=True)
class UrdfJoint:
    """A moving joint as written: limits [rad or m] and speed [rad/s or m/s].

    Acceleration, jerk and effort are those of its drive in SI units, infinite where the file
    does not tell them.
    """

    name: str
    kind: str
    axis: tuple[float, float, float]
    lower: float
    upper: float
    velocity: float
    acceleration: float = math.inf
    jerk: float = math.inf
    effort: float = math.inf


@dataclass(frozen=True)
class LinkTree:
    """The links of a description and the joints between them.

    Attributes:
        root: the link that hangs on no other.
        parents: link to (parent link, joint between them), the root left out.
        moving: the joints that move, as written.
        fixed: names of the joints that do not, the frozen ones among them.
    """

    root: str
    parents: Mapping[str, tuple[str, str]]
    moving: Mapping[str, Element]
    fixed: frozenset[str]

    def fixed_below(self, link: str) -> tuple[str, ...]:
        """Return the links connected to ``link`` by fixed joints only, itself included."""
        out = [link]
        for other in out:  # grows while it is walked
            out += [
                child
                for child, (parent, joint) in self.parents.items()
                if parent == other and joint in self.fixed
            ]
        return tuple(out)

    def child_of(self, joint: str) -> str:
        """Return the link that a joint moves."""
        return next(c for c, (_, name) in self.parents.items() if name == joint)

    def joints_to(self, link: str) -> tuple[str, ...]:
        """Return the names of the joints between the root and a link, the link's own first."""
        out = []
        while link in self.parents:
            link, joint = self.parents[link]
            out.append(joint)
        return tuple(out)


@dataclass(frozen=True)
class UrdfFile(LinkTree):
    """The serial chain of a description.

    Attributes:
        path: the file.
        package_dirs: where ``package://`` and relative paths are looked up.
        joints: the moving joints, base to tip; frozen ones left out.
    """

    path: Path
    package_dirs: tuple[Path, ...]
    joints: tuple[UrdfJoint, ...]


def serial_chain(
    root: Element,
    path: Path,
    package_dirs: tuple[Path, ...] = (),
    frozen: frozenset[str] = frozenset(),
) -> UrdfFile:
    """Check a description of an arm and return its serial chain.

    Args:
        root: of its XML.
        path: its file, for messages and for its folder.
        package_dirs: searched for meshes after the file's own folder.
        frozen: names of joints to treat as fixed.

    Raises:
        RobotModelError: it is not URDF, has no moving joint, branches, lacks a limit or a speed,
            or names a mesh that is not there.
    """
    dirs = search_folders(path, package_dirs)
    if root.tag == "robot" and not root.findall("joint"):
        raise RobotModelError(f"{path} has no joints")
    tree = checked_tree(root, path, dirs, frozen)
    if not tree.moving:
        raise RobotModelError(f"{path} has no moving joint")
    order = _chain_order(tree.parents, tree.moving, path)
    joints = tuple(_joint(tree.moving[name], name, path) for name in order)
    return UrdfFile(**vars(tree), path=path, package_dirs=dirs, joints=joints)


def checked_tree(
    root: Element, path: Path, dirs: Sequence[Path], frozen: frozenset[str]
) -> LinkTree:
    """Check what descriptions of arms and of tools have in common, and return the links.

    Args:
        root: of the XML.
        path: its file, for messages.
        dirs: where meshes are looked up.
        frozen: names of joints to treat as fixed.

    Raises:
        RobotModelError: it is not URDF, no tree, or names a mesh that is not there.
    """
    if root.tag != "robot":
        raise RobotModelError(f"{path} is not URDF: its root element is <{root.tag}>")
    _reject_xacro(root, path)
    check_numbers(root, path)
    check_meshes(root, path, dirs)
    names = [
        required_attribute(element, "name", path) for element in root.findall("link")
    ]
    links = set(_unique(names, "link", path))
    _unique([str(e.get("name")) for e in root.findall("joint")], "joint", path)
    parents: dict[str, tuple[str, str]] = {}
    moving: dict[str, Element] = {}
    fixed: set[str] = set()
    for element in root.findall("joint"):
        name = required_attribute(element, "name", path)
        parent, child = (
            _joined(element, tag, links, f"{path}: joint {name!r}")
            for tag in ("parent", "child")
        )
        if child in parents:
            raise RobotModelError(f"{path}: link {child!r} has two parent joints")
        parents[child] = (parent, name)
        kind = element.get("type")
        if kind == "fixed" or name in frozen:
            fixed.add(name)
        elif kind in _MOVING:
            moving[name] = element
        else:
            raise RobotModelError(
                f"{path}: joint {name!r} is of type {kind!r}; hold it at 0 with 'joints', or make it"
                " another one",
                choices=(*_MOVING, "fixed"),
            )
    missing = sorted(frozen - fixed)
    if missing:
        raise RobotModelError(f"{path} has no joint {missing[0]!r} to freeze")
    roots = links - set(parents)
    if len(roots) != 1:
        raise RobotModelError(
            f"{path} needs one root link, has {', '.join(sorted(roots)) or 'none'}"
        )
    _require_rooted(parents, path)
    return LinkTree(roots.pop(), parents, moving, frozenset(fixed))


def moving_order(root: Element, path: Path) -> tuple[str, ...]:
    """Return the names of the moving joints of a checked description, base to tip."""
    tree = checked_tree(root, path, search_folders(path), frozenset())
    return tuple(_chain_order(tree.parents, tree.moving, path))


def _unique(names: Sequence[str], what: str, path: Path) -> Sequence[str]:
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise RobotModelError(f"{path} has two {what}s called {twice!r}")
    return names


def _joined(element: Element, tag: str, links: Collection[str], where: str) -> str:
    """Return the link at one end of a joint."""
    found = joint_link(element, tag)
    if found not in links:
        raise RobotModelError(
            f"{where} has no valid {tag} link", choices=tuple(sorted(links))
        )
    return found


def _require_rooted(parents: Mapping[str, tuple[str, str]], path: Path) -> None:
    rooted: set[str] = set()
    for link in parents:
        seen: list[str] = []
        while link in parents and link not in rooted:
            if link in seen:
                raise RobotModelError(f"{path}: link {link!r} is its own ancestor")
            seen.append(link)
            link = parents[link][0]
        rooted.update(seen)


def _reject_xacro(root: Element, path: Path) -> None:
    macros = [child for child in root if child.tag.startswith("xacro:")]
    parts = [*root.findall("link"), *root.findall("joint")]
    values = [v for part in parts for e in part.iter() for v in e.attrib.values()]
    if macros or any("${" in value or "$(" in value for value in values):
        raise RobotModelError(
            f"{path} still holds xacro macros; a file whose name ends in .xacro is expanded"
        )


def _chain_order(
    parents: Mapping[str, tuple[str, str]],
    moving: Mapping[str, Element],
    path: Path,
) -> list[str]:
    above: dict[str, str | None] = {}
    for parent, joint in parents.values():
        if joint not in moving:
            continue
        while parent in parents and parents[parent][1] not in moving:
            parent = parents[parent][0]
        above[joint] = parents[parent][1] if parent in parents else None
    order: list[str] = []
    last: str | None = None
    while len(order) < len(above):
        following = [joint for joint, upper in above.items() if upper == last]
        if len(following) > 1:
            bearing = {parent for parent, _ in parents.values()}
            raise RobotModelError(
                f"{path}: the chain branches at joints "
                + " and ".join(repr(joint) for joint in following[:2])
                + "; hold what is not of the arm, such as fingers, with 'joints', or name its 'flange',"
                " and all that does not lead there stands still",
                choices=tuple(link for link in parents if link not in bearing),
            )
        last = following[0]
        order.append(last)
    return order


def _joint(element: Element, name: str, path: Path) -> UrdfJoint:
    kind = str(element.get("type"))
    where = f"{path}: joint {name!r}"
    if element.find("mimic") is not None:
        raise RobotModelError(
            f"{where} mimics another joint, which an arm cannot do here; hold the joint that it"
            " mimics with 'joints', and it follows"
        )
    x, y, z = joint_axis(element, where).tolist()
    limit = element.find("limit")
    if limit is None:
        remedy = "the robot 'limits: {velocity: ...}'"
        if kind != "continuous":
            remedy = "it one with lower, upper and velocity"
        message = f"{where} has no <limit>: give {remedy}"
        if kind != "continuous":
            raise RobotModelError(message)
        raise FittingError(message, key="limits")
    velocity = parse_number(limit.get("velocity", "0"), f"{where}, velocity limit")
    if velocity <= 0.0:
        raise FittingError(
            f"{where} needs a velocity limit above zero, has {velocity:g}; give the robot"
            " 'limits: {velocity: ...}'",
            key="limits",
        )
    if not SLOWEST <= velocity <= FASTEST_DESCRIBED:
        raise FittingError(
            f"{where} has a velocity limit of {velocity:g}, must be {SLOWEST:g} to {FASTEST_DESCRIBED:g};"
            " give the robot 'limits: {velocity: ...}'",
            key="limits",
        )
    lower, upper = -_CONTINUOUS_LIMIT, _CONTINUOUS_LIMIT
    if kind != "continuous":
        # Some files write 1e16 for a joint without limits.
        lower = max(
            parse_number(limit.get("lower", "0"), f"{where}, lower limit"), -FARTHEST
        )
        upper = min(
            parse_number(limit.get("upper", "0"), f"{where}, upper limit"), FARTHEST
        )
    if not lower < upper:
        raise RobotModelError(f"{where} has an empty range: {lower:g} to {upper:g}")
    drive = [_drive(limit, key, where) for key in ("acceleration", "jerk", "effort")]
    return UrdfJoint(name, kind, (x, y, z), lower, upper, velocity, *drive)


def _drive(limit: Element, key: str, where: str) -> float:
    """Return the drive limits, infinite where none are stated; any prefix is accepted."""
    for name, text in limit.items():
        if name.rpartition(":")[2] == key:
            value = parse_number(text, f"{where}, {key} limit")
            if key != "effort" and 0.0 < value < SLOWEST:
                raise RobotModelError(
                    f"{where} has {key} limit {value:g}, must be at least {SLOWEST:g}"
                )
            return value if 0.0 < value <= FASTEST_DESCRIBED else math.inf
    return math.inf


def flange_link(
    description: UrdfFile, wanted: str | None, proposed: Collection[str] = ()
) -> str:
    """Return the link whose frame is the flange.

    That is what is asked for; else the link called ``tool0``, with or without a prefix such as
    ``left_``; else the first of the proposed ones on the last joint on which others hang; else the link called
    ``flange``, likewise; else the link that the last joint moves.

    Raises:
        RobotModelError: what is asked for does not hang on the last joint.
    """
    last = description.child_of(description.joints[-1].name)
    below = description.fixed_below(last)
    if wanted is not None:
        if wanted not in below:
            raise RobotModelError(
                f"{description.path}: {wanted!r} is no link on the last joint",
                choices=below,
            )
        return wanted
    best, other = (
        [link for link in below if link == name]
        + [link for link in below if re.search(rf"[_./-]{name}$", link)]
        for name in _FLANGES
    )
    said = [
        link
        for link in proposed
        if link in below and len(description.fixed_below(link)) > 1
    ]
    return (*best, *said, *other, last)[0]


def links_on_flange(description: UrdfFile, flange: str) -> tuple[str, ...]:
    """Return the links beyond the flange: the tool, unless stated otherwise.

    What hangs on ``flange`` hangs on ``tool0`` too: they are two frames of one face.
    """
    top = flange
    while top in description.parents:
        parent, joint = description.parents[top]
        if joint not in description.fixed or not _is_flange(parent):
            break
        top = parent
    hanging = description.fixed_below(top)[1:]
    return tuple(link for link in hanging if not _is_flange(link))


def tip_link(links: tuple[str, ...]) -> str | None:
    """Return the link named as the tool centre point, if there is one."""
    return next((link for link in links if _TIP.search(link)), None)


def _is_flange(link: str) -> bool:
    return any(re.search(rf"(^|[_./-]){name}$", link) for name in _FLANGES)

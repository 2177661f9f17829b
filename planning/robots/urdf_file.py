"""The joints of a URDF file, checked before anything is built from it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

from planning.errors import RobotModelError
from planning.files import is_file, read_file
from planning.transforms import Transform, identity

_MOVING = ("revolute", "continuous", "prismatic")
_CONTINUOUS_LIMIT = 2.0 * math.pi


@dataclass(frozen=True, kw_only=True)
class UrdfOptions:
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
        velocity: joint speed limits in place of the file's [rad/s or m/s].
    """

    name: str | None = None
    home: tuple[float, ...] | None = None
    frozen: Mapping[str, float] = field(default_factory=dict)
    flange_link: str | None = None
    flange_offset: Transform = field(default_factory=identity)
    tool_links: tuple[str, ...] | None = None
    frames: Mapping[str, Transform] | None = None
    velocity: tuple[float, ...] | None = None


@dataclass(frozen=True)
class UrdfJoint:
    """A moving joint as written: limits [rad or m] and speed [rad/s or m/s]."""

    name: str
    kind: str
    axis: tuple[float, float, float]
    lower: float
    upper: float
    velocity: float


@dataclass(frozen=True)
class UrdfFile:
    """The serial chain of a description.

    Attributes:
        path: the file.
        package_dirs: where ``package://`` and relative paths are looked up.
        joints: the moving joints, base to tip; frozen ones left out.
        parents: link to (parent link, joint between them), the root left out.
        fixed: names of the joints that do not move, the frozen ones among them.
    """

    path: Path
    package_dirs: tuple[Path, ...]
    joints: tuple[UrdfJoint, ...]
    parents: Mapping[str, tuple[str, str]]
    fixed: frozenset[str]

    def fixed_below(self, link: str) -> tuple[str, ...]:
        """Return the links that hang on ``link`` by fixed joints only, itself included."""
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


def read_urdf(
    path: Path,
    package_dirs: tuple[Path, ...] = (),
    frozen: frozenset[str] = frozenset(),
) -> UrdfFile:
    """Read and check a URDF file.

    Args:
        path: the file.
        package_dirs: searched for meshes after the file's own folder.
        frozen: names of joints to treat as fixed.

    Raises:
        RobotModelError: the file is missing, is not URDF, has no moving joint, branches, lacks
            a limit or a speed, or names a mesh that is not there.
    """
    if not is_file(path):
        raise RobotModelError(f"robot description {path} does not exist")
    try:
        root = ElementTree.fromstring(read_file(path))
    except OSError as error:
        raise RobotModelError(f"{path} cannot be read: {error.strerror}") from None
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise RobotModelError(f"{path} is not XML: {error}") from error
    if root.tag != "robot":
        raise RobotModelError(f"{path} is not URDF: its root element is <{root.tag}>")
    _reject_xacro(root, path)
    if not root.findall("joint"):
        raise RobotModelError(f"{path} has no joints")
    dirs = (path.parent, *package_dirs, *list(path.resolve().parents)[1:3])
    _check_numbers(root, path)
    _check_meshes(root, path, dirs)

    links = {_attribute(e, "name", path) for e in root.findall("link")}
    parents: dict[str, tuple[str, str]] = {}
    moving: dict[str, ElementTree.Element] = {}
    fixed: set[str] = set()
    for element in root.findall("joint"):
        name = _attribute(element, "name", path)
        ends = []
        for tag in ("parent", "child"):
            found = element.find(tag)
            if found is None or found.get("link") not in links:
                raise RobotModelError(
                    f"{path}: joint {name!r} has no valid {tag} link",
                    choices=tuple(sorted(links)),
                )
            ends.append(str(found.get("link")))
        if ends[1] in parents:
            raise RobotModelError(f"{path}: link {ends[1]!r} has two parent joints")
        parents[ends[1]] = (ends[0], name)
        kind = element.get("type")
        if kind == "fixed" or name in frozen:
            fixed.add(name)
        elif kind in _MOVING:
            moving[name] = element
        else:
            raise RobotModelError(
                f"{path}: joint {name!r} is of type {kind!r}",
                choices=(*_MOVING, "fixed"),
            )
    missing = sorted(frozen - fixed)
    if missing:
        raise RobotModelError(f"{path} has no joint {missing[0]!r} to freeze")
    roots = links - set(parents)
    if len(roots) != 1:
        raise RobotModelError(f"{path} needs one root link, has {sorted(roots)}")
    if not moving:
        raise RobotModelError(f"{path} has no moving joint")
    order = _chain_order(parents, moving, path)
    joints = tuple(_joint(moving[name], name, path) for name in order)
    return UrdfFile(path, dirs, joints, parents, frozenset(fixed))


def _reject_xacro(root: ElementTree.Element, path: Path) -> None:
    for element in root.iter():
        left_in = "{http" in element.tag and "xacro" in element.tag
        if left_in or any("${" in value for value in element.attrib.values()):
            raise RobotModelError(
                f"{path} still holds xacro macros; expand it to plain URDF first "
                "(xacro robot.urdf.xacro > robot.urdf)"
            )


# What a link may measure and how far from its joint it may be [m], [rad]: libraries crash,
# or never end, on bodies of 1e300 m and of no size at all.
_SIZES = {
    "size": (1e-6, 1000.0, 3),
    "radius": (1e-6, 1000.0, 1),
    "length": (1e-6, 1000.0, 1),
    "scale": (1e-9, 1e6, 3),
}
_PLACES = {"xyz": (0.0, 1000.0, 3), "rpy": (0.0, 1e4, 3)}


def _check_numbers(root: ElementTree.Element, path: Path) -> None:
    """Require every number of the geometry to be one, and of a magnitude that bodies have."""
    for joint in root.findall("joint"):
        _check_values(joint.find("origin"), _PLACES, path)
        _check_values(joint.find("axis"), _PLACES, path)
    for body in root.findall(".//collision"):
        _check_values(body.find("origin"), _PLACES, path)
        for shape in body.findall("geometry/*"):
            _check_values(shape, _SIZES, path)


def _check_values(
    element: ElementTree.Element | None,
    ranges: Mapping[str, tuple[float, float, int]],
    path: Path,
) -> None:
    if element is None:
        return
    for key in sorted(ranges.keys() & set(element.keys())):
        least, most, count = ranges[key]
        where, text = f"{path}: {key} of a <{element.tag}>", element.get(key, "")
        values = [_number(part, where) for part in text.split()]
        if len(values) != count:
            raise RobotModelError(f"{where} must be {count} numbers, is {text[:60]!r}")
        for value in values:
            # A mirrored mesh has a negative scale.
            size = abs(value) if key in ("scale", "xyz", "rpy") else value
            if not least <= size <= most:
                raise RobotModelError(
                    f"{where} must be {least:g} to {most:g}, is {value:g}"
                )


def _check_meshes(
    root: ElementTree.Element, path: Path, dirs: tuple[Path, ...]
) -> None:
    for element in root.findall(".//collision//mesh"):
        name = _attribute(element, "filename", path)
        if find_mesh(name, dirs) is None:
            raise RobotModelError(
                f"{path}: mesh {name!r} was not found in "
                + ", ".join(str(place) for place in dict.fromkeys(dirs))
            )


def find_mesh(name: str, dirs: Sequence[Path]) -> Path | None:
    """Return the first file that a mesh's name may mean, None where there is none."""
    bare = name.removeprefix("file://").removeprefix("package://")
    places = (folder / bare for folder in dirs)  # an absolute path stays as it is
    return next((place for place in places if is_file(place)), None)


def _chain_order(
    parents: Mapping[str, tuple[str, str]],
    moving: Mapping[str, ElementTree.Element],
    path: Path,
) -> list[str]:
    above: dict[str, str | None] = {}
    for child, (parent, joint) in parents.items():
        if joint not in moving:
            continue
        seen = {child}
        while parent in parents and parents[parent][1] not in moving:
            if parent in seen:
                raise RobotModelError(f"{path}: link {parent!r} is its own ancestor")
            seen.add(parent)
            parent = parents[parent][0]
        above[joint] = parents[parent][1] if parent in parents else None
    order: list[str] = []
    last: str | None = None
    while len(order) < len(above):
        following = [joint for joint, upper in above.items() if upper == last]
        if len(following) > 1:
            raise RobotModelError(
                f"{path}: the chain branches at joints {following[0]!r} and "
                f"{following[1]!r}; only serial arms are supported (make gripper fingers "
                "fixed joints)"
            )
        if not following:
            raise RobotModelError(f"{path}: joints {sorted(above)} form a loop")
        last = following[0]
        order.append(last)
    return order


def _joint(element: ElementTree.Element, name: str, path: Path) -> UrdfJoint:
    kind = str(element.get("type"))
    where = f"{path}: joint {name!r}"
    if element.find("mimic") is not None:
        raise RobotModelError(f"{where} mimics another joint, which is not supported")
    axis_element = element.find("axis")
    text = "1 0 0" if axis_element is None else axis_element.get("xyz", "1 0 0")
    axis = [_number(part, f"{where}, axis") for part in text.split()]
    norm = math.hypot(*axis)
    if len(axis) != 3 or norm == 0.0:
        raise RobotModelError(f"{where} has no direction: axis {text!r}")
    limit = element.find("limit")
    if limit is None:
        raise RobotModelError(f"{where} has no <limit>")
    velocity = _number(limit.get("velocity", "0"), f"{where}, velocity limit")
    if velocity <= 0.0:
        raise RobotModelError(
            f"{where} needs a velocity limit above zero, has {velocity:g}"
        )
    lower, upper = -_CONTINUOUS_LIMIT, _CONTINUOUS_LIMIT
    if kind != "continuous":
        lower = _number(limit.get("lower", "0"), f"{where}, lower limit")
        upper = _number(limit.get("upper", "0"), f"{where}, upper limit")
    if not lower < upper:
        raise RobotModelError(f"{where} has an empty range: {lower:g} to {upper:g}")
    x, y, z = (value / norm for value in axis)
    return UrdfJoint(name, kind, (x, y, z), lower, upper, velocity)


def _number(text: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise RobotModelError(f"{where} must be a finite number, is {text!r}")
    return value


def _attribute(element: ElementTree.Element, key: str, path: Path) -> str:
    value = element.get(key)
    if not value:
        raise RobotModelError(f"{path}: a <{element.tag}> has no {key}")
    return value

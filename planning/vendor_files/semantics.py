"""Semantics of a robot: named poses, end effectors and pairs of links without collision checks, of SRDF and MJCF.

SRDF is the format of MoveIt for what a URDF does not say. MJCF files say the same by ``<contact>`` and ``<keyframe>``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from xml.etree.ElementTree import Element

from planning.errors import RobotModelError
from planning.files import is_file
from planning.robots.descriptions.read_description import mjcf_to_urdf
from planning.robots.descriptions.xml_files import parse_number, parse_vector, read_xml

_FOLDERS = (".", "srdf", "config", "../srdf", "../config")
"""Folders, seen from a description, in which its SRDF file is looked for."""

_MOST_FILES = 1000
"""Number of files of a folder that are looked at."""

_LONGEST_REASON = 40
"""Longest reason of a pair that is kept [characters]."""

_SINGLE = {"revolute", "continuous", "prismatic"}
"""Types of joints with one value."""


@dataclass(frozen=True)
class Semantics:
    """What the vendor of a robot says in a file besides its description.

    Attributes:
        ignored: pairs of links that need no collision check, each with the reason.
        poses: named poses: values by joint [rad or m].
        hands: links that end effectors hang on.
    """

    path: Path
    ignored: Mapping[tuple[str, str], str]
    poses: Mapping[str, Mapping[str, float]]
    hands: tuple[str, ...]


def find_srdf(description: Path, robot: str) -> Path | None:
    """Return the SRDF file of a description of a robot, None for none.

    That is a file of the same name in its folder, or in a folder ``srdf`` or ``config`` in or beside that; else the only
    SRDF file in its folder, if that is for a robot of the same name.
    """
    stem, folder = description.name.partition(".")[0], description.parent
    for place in _FOLDERS:
        if is_file(path := folder / place / f"{stem}.srdf"):
            return path.resolve()
    try:
        names = list(islice(folder.iterdir(), _MOST_FILES))
    except OSError:
        return None
    files = [path for path in names if path.suffix == ".srdf" and is_file(path)]
    if len(files) == 1 and read_xml(files[0]).get("name") == robot:
        return files[0]
    return None


def srdf_semantics(path: Path, root: Element | None = None) -> Semantics:
    """Return the semantics of an SRDF file, given its content where it is not read from the file.

    Raises:
        RobotModelError: it cannot be read, or an element of it lacks something.
    """
    root = read_xml(path) if root is None else root
    if root.tag != "robot":
        raise RobotModelError(f"{path} is not SRDF: its root element is <{root.tag}>")
    ignored, poses = dict[tuple[str, str], str](), dict[str, dict[str, float]]()
    for where, item in _numbered(root, "disable_collisions", path):
        first, second = (_required(item, key, where) for key in ("link1", "link2"))
        ignored[first, second] = item.get("reason", "")[:_LONGEST_REASON]
    for where, item in _numbered(root, "group_state", path):
        pose = poses.setdefault(_required(item, "name", where), {})
        for joint in item.findall("joint"):
            name = _required(joint, "name", f"{where}: a <joint>")
            text = _required(joint, "value", f"{where}: joint {name!r}")
            place = f"{where}: value of joint {name!r}"
            values = [parse_number(part, place) for part in text.split()]
            if len(values) == 1:  # others are of planar and floating joints
                pose.setdefault(name, values[0])
    hands = tuple(
        _required(item, "parent_link", where)
        for where, item in _numbered(root, "end_effector", path)
    )
    return Semantics(path, ignored, poses, hands)


def _numbered(root: Element, tag: str, path: Path) -> Iterator[tuple[str, Element]]:
    """Yield the elements of a kind, each with its place for messages."""
    for number, item in enumerate(root.findall(tag), 1):
        name = item.get("name")
        yield f"{path}: <{tag}> {number if name is None else repr(name)}", item


def _required(item: Element, key: str, where: str) -> str:
    value = item.get(key)
    if not value or not value.strip():
        raise RobotModelError(f"{where} has no {key}")
    return value


def mjcf_semantics(root: Element, path: Path) -> Semantics:
    """Return the semantics of an MJCF file, given its XML, which is changed.

    Raises:
        RobotModelError: it cannot be read, or an element of it lacks something.
    """
    urdf = mjcf_to_urdf(root, path)  # also includes files and merges sections
    ignored = {}
    for number, item in enumerate(root.findall("contact/exclude"), 1):
        where = f"{path}: <exclude> {number}"
        first, second = (_required(item, key, where) for key in ("body1", "body2"))
        ignored[first, second] = "exclude"
    joints = [joint for joint in urdf.findall("joint") if joint.get("type") != "fixed"]
    poses = {}
    names = [str(joint.get("name")) for joint in joints]
    single = all(joint.get("type") in _SINGLE for joint in joints)
    for number, key in enumerate(root.findall("keyframe/key"), 1):
        name, text = key.get("name") or str(number), key.get("qpos")
        # Free and ball joints take several values, as those of things that stand around.
        if text is None or not single or len(text.split()) != len(joints):
            continue
        values = parse_vector(text, f"{path}: qpos of <key> {name!r}", len(joints))
        poses[name] = dict(zip(names, values, strict=True))
    return Semantics(path, ignored, poses, ())

"""Reading of robot and tool descriptions in URDF or MJCF format; the result is URDF.

MJCF is the format of MuJoCo. Its bodies become links, and its joints become URDF joints. pinocchio can read
MJCF too, but it treats ranges of slide joints as angles, mixes default classes, and ignores both
``limited: false`` and the joint value of the initial model configuration.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from planning.errors import RobotModelError
from planning.files import is_file, read_file
from planning.robots.descriptions.empty_shapes import (
    find_empty_shapes,
    remove_empty_shapes,
)
from planning.robots.descriptions.mjcf_settings import MjcfSettings, turn_from_z
from planning.robots.descriptions.urdf_geometry import (
    format_numbers,
    joint_motion,
    origin_pose,
    write_pose,
)
from planning.robots.descriptions.xml_files import (
    find_mesh,
    parse_number,
    parse_vector,
    read_xml,
    search_folders,
)
from planning.transforms import Transform, identity, translation

_MOST_INCLUDES = 100
"""Depth of files that include files: a deeper one includes itself."""

_NUMBERS = {"pos", "quat", "axisangle", "euler", "xyaxes", "zaxis", "axis", "size"}
_NUMBERS |= {"fromto", "range", "scale", "polycoef", "ref"}
_LARGEST = 1e5
"""Largest number that a body is believed to have."""

_LOOKS = 3
"""Geoms of groups from this one on are not drawn where they can be touched."""

_URDF_KINDS = {"slide": "prismatic", "hinge": "revolute"}


def mjcf_to_urdf(root: Element, path: Path) -> Element:
    """Return the bodies, joints and geoms of an MJCF file as URDF.

    A joint that an equality ties to another mimics it. Planes are left out: they are floors.
    Speeds are not known: MJCF has none.

    Args:
        root: of its XML, changed.
        path: the file.

    Raises:
        RobotModelError: it cannot be read, or holds what URDF has no words for.
    """
    _include(root, path, 0)
    _check_values(root, path)
    _check_references(root, path)
    settings = MjcfSettings(root, path)
    world = root.find("worldbody")
    if world is None or world.find("body") is None:
        raise RobotModelError(f"{path} has no <body> in its <worldbody>")
    urdf = Element("robot", name=root.get("model", path.stem))
    writer = _UrdfWriter(urdf, settings, _meshes(root, settings), {}, path)
    link = SubElement(urdf, "link", name="world")
    writer.fill(link, world, identity(), "main")
    writer.tie(root)
    return urdf


def _include(root: Element, path: Path, depth: int) -> None:
    """Insert the content of included files at their references."""
    for element in list(root.iter()):
        for at, child in reversed(list(enumerate(element))):
            if child.tag != "include":
                continue
            if depth >= _MOST_INCLUDES:
                raise RobotModelError(f"{path} includes itself")
            content = read_xml(path.parent / child.get("file", ""))
            _include(content, path, depth + 1)
            element[at : at + 1] = list(content)


def _check_values(root: Element, path: Path) -> None:
    """Check that numbers are plausible in magnitude, and directions not zero."""
    for element in root.iter():
        for key in _NUMBERS & element.attrib.keys():
            name = element.get("name") or element.get("class") or ""
            where = f"{path}: {key} of <{element.tag}> {name!r}"
            text = element.get(key, "")
            values = [parse_number(part, where) for part in text.split()]
            if not values or any(abs(value) > _LARGEST for value in values):
                raise RobotModelError(
                    f"{where} must be numbers of at most {_LARGEST:g}, is {text[:60]!r}"
                )
            if key in ("quat", "axis", "zaxis") and not any(values):
                raise RobotModelError(f"{where} must not be zero")


def _check_references(root: Element, path: Path) -> None:
    """Check that referenced classes and meshes exist."""
    classes = {item.get("class", "main") for item in root.iter("default")} | {"main"}
    meshes = {_mesh_name(item) for item in root.findall("asset/mesh")}
    for key, valid in (("class", classes), ("childclass", classes), ("mesh", meshes)):
        for element in root.iter():
            name = element.get(key)
            if name is None or (element.tag == "default" or name in valid):
                continue
            raise RobotModelError(
                f"{path}: {key} {name!r} of a <{element.tag}> is not there",
                choices=tuple(sorted(valid)),
            )


def _mesh_name(mesh: Element) -> str:
    return mesh.get("name") or Path(mesh.get("file", "")).stem


def _meshes(root: Element, settings: MjcfSettings) -> dict[str, dict[str, str]]:
    """Return the URDF attributes of each mesh, by its name."""
    found = {}
    for mesh in root.findall("asset/mesh"):
        given, name = settings.attributes(mesh, "main"), mesh.get("file", "")
        file = settings.mesh_folder / name
        if not name or not is_file(file):
            raise RobotModelError(
                f"{settings.path}: mesh {name or mesh.get('name')!r} was not found in"
                f" {settings.mesh_folder}"
            )
        where = f"{settings.path}: scale of mesh {name!r}"
        scale = format_numbers(parse_vector(given.get("scale", "1 1 1"), where))
        found[_mesh_name(mesh)] = {"filename": str(file.resolve()), "scale": scale}
    return found


@dataclass(frozen=True)
class _UrdfWriter:
    """Converts bodies to links and joints of a URDF.

    Attributes:
        urdf: what is written.
        settings: of the file.
        meshes: by name, see ``_meshes``.
        drawn: values of joints as they are drawn, where these are not 0 [rad or m].
        path: the file, for messages.
    """

    urdf: Element
    settings: MjcfSettings
    meshes: Mapping[str, dict[str, str]]
    drawn: dict[str, float]
    path: Path

    def fill(self, link: Element, body: Element, pose: Transform, around: str) -> None:
        """Write the content of a body, or of a frame in it.

        Args:
            link: of the body.
            body: the body or frame.
            pose: of its frame in the frame of the link.
            around: class of all in it that name none.
        """
        around = body.get("childclass", around)
        for index, child in enumerate(body):
            given = self.settings.attributes(child, around)
            if child.tag == "geom":
                self._geom(link, given, pose)
            elif child.tag == "body":
                name = child.get("name") or f"{link.get('name')}.body{index}"
                self._body(link, child, name, pose @ self._pose(child, given), around)
            elif child.tag == "frame":
                if child.find("joint") is not None:
                    raise RobotModelError(
                        f"{self.path}: a <frame> of body {link.get('name')!r} has a joint; put the"
                        " joint into the body"
                    )
                self.fill(link, child, pose @ self._pose(child, given), around)

    def _body(
        self, parent: Element, body: Element, name: str, pose: Transform, around: str
    ) -> None:
        joints = [child for child in body if child.tag in ("joint", "freejoint")]
        own = body.get("childclass", around)
        given = [self.settings.attributes(joint, own) for joint in joints]
        for joint, keys in zip(joints, given, strict=True):
            if joint.tag == "freejoint":
                keys["type"] = "free"
        if parent.get("name") == "world":  # a thing that may be anywhere is put here
            given = [keys for keys in given if keys.get("type") != "free"]
        if len(given) > 1:
            raise RobotModelError(
                f"{self.path}: body {name!r} has several joints; give each a body of its own"
            )
        if given:
            parent, pose = self._joint(parent, given[0], name, pose)
        if parent.get("name") != name:
            parent = self._hang(parent, f"{name}.fixed", name, pose, "fixed")
        self.fill(parent, body, identity(), around)

    def _joint(
        self, parent: Element, given: Mapping[str, str], name: str, pose: Transform
    ) -> tuple[Element, Transform]:
        """Write the joint of a body; return its child link, and the pose of the body in that."""
        joint = self.settings.joint(given, f"{name}Joint_0")
        pivot = parse_vector(
            given.get("pos", "0 0 0"), f"{self.path}: joint {joint.name!r}"
        )
        moved = name if not any(pivot) else f"{name}.moved"
        placed = pose @ translation(*pivot)
        kind = _URDF_KINDS.get(joint.kind, "floating")
        if kind == "revolute" and joint.limits is None:
            kind = "continuous"
        link = self._hang(parent, joint.name, moved, placed, kind)
        element = self.urdf[-1]
        if kind != "floating":
            axis = parse_vector(
                given.get("axis", "0 0 1"), f"{self.path}: {joint.name!r}"
            )
            unit = np.array(axis) / np.linalg.norm(axis)
            SubElement(element, "axis", xyz=format_numbers(unit))
        if kind != "floating" and joint.limits is not None:
            low, high = joint.limits
            SubElement(element, "limit", lower=repr(low), upper=repr(high))
        if joint.drawn:
            self.drawn[joint.name] = joint.drawn
            write_pose(
                element, placed @ joint_motion(element, -joint.drawn, str(self.path))
            )
        return link, translation(*(-value for value in pivot))

    def _hang(
        self, parent: Element, joint: str, name: str, pose: Transform, kind: str
    ) -> Element:
        """Write a link on a joint of its own, which comes last."""
        link = SubElement(self.urdf, "link", name=name)
        element = SubElement(self.urdf, "joint", name=joint, type=kind)
        SubElement(element, "parent", link=str(parent.get("name")))
        SubElement(element, "child", link=name)
        write_pose(element, pose)
        return link

    def _pose(self, element: Element, given: Mapping[str, str]) -> Transform:
        return self.settings.pose(given, f"<{element.tag}> {element.get('name', '')!r}")

    def _geom(self, link: Element, given: Mapping[str, str], pose: Transform) -> None:
        where = f"{self.path}: geom {given.get('name', '')!r}"
        group, *masks = (
            parse_number(given.get(key, usual), f"{where}, {key}")
            for key, usual in (("group", "0"), ("contype", "1"), ("conaffinity", "1"))
        )
        touched = any(masks)
        seen = not touched or group < _LOOKS
        kind = given.get("type", "sphere")
        if kind == "plane":
            return
        if kind not in ("box", "sphere", "cylinder", "capsule", "mesh"):
            if touched:
                raise RobotModelError(
                    f"{where} is of a kind that cannot be read ({kind}); give it another, or"
                    " contype and conaffinity 0",
                    choices=("box", "sphere", "cylinder", "capsule", "mesh"),
                )
            return
        place, keys = self._shape(kind, given, where)
        for tag, wanted in (("collision", touched), ("visual", seen)):
            if not wanted:
                continue
            element = SubElement(link, tag)
            write_pose(element, pose @ place)
            SubElement(SubElement(element, "geometry"), kind, keys)
            if tag == "visual":
                rgba = parse_vector(given.get("rgba", "1 1 1 1"), f"{where}, rgba", 4)
                material = SubElement(element, "material", name="")
                SubElement(material, "color", rgba=format_numbers(rgba))

    def _shape(
        self, kind: str, given: Mapping[str, str], where: str
    ) -> tuple[Transform, dict[str, str]]:
        """Return the pose of a geom, and the URDF attributes of its shape."""
        if kind == "mesh":
            if given.get("mesh") not in self.meshes:
                raise RobotModelError(f"{where} has no mesh")
            return self.settings.pose(given, where), self.meshes[given["mesh"]]
        size = [
            parse_number(part, f"{where}, size")
            for part in given.get("size", "").split()
        ]
        if "fromto" in given and kind != "sphere":
            ends = np.array(parse_vector(given["fromto"], f"{where}, fromto", 6))
            axis = ends[3:] - ends[:3]
            pose = translation(*(ends[:3] + 0.5 * axis)) @ turn_from_z(axis)
            half = 0.5 * float(np.linalg.norm(axis))
            size = [*size[:1] * (2 if kind == "box" else 1), half]
        else:
            pose = self.settings.pose(given, where)
        count = {"sphere": 1, "box": 3}.get(kind, 2)
        if len(size) < count:
            raise RobotModelError(
                f"{where}: a {kind} needs {count} sizes, has {len(size)}"
            )
        if kind == "box":
            return pose, {"size": format_numbers(2.0 * np.array(size[:3]))}
        keys = {"radius": repr(size[0])}
        return pose, keys if kind == "sphere" else keys | {
            "length": repr(2.0 * size[1])
        }

    def tie(self, root: Element) -> None:
        """Write equality constraints between joints as joints that mimic another one.

        It ties what they have moved since they were drawn.
        """
        joints = {str(joint.get("name")): joint for joint in self.urdf.findall("joint")}
        for tie in root.findall("equality/joint"):
            first, second = tie.get("joint1", ""), tie.get("joint2", "")
            if second not in joints or first not in joints:
                continue
            factors = [*map(float, tie.get("polycoef", "0 1 0 0 0").split())]
            if any(factors[2:]):
                raise RobotModelError(
                    f"{self.path}: joint {first!r} follows {second!r} along a curve; only straight"
                    " lines can be followed"
                )
            offset, factor = (*factors, 0.0, 0.0)[:2]
            offset += self.drawn.get(first, 0.0) - factor * self.drawn.get(second, 0.0)
            keys = {"multiplier": repr(factor), "offset": repr(offset)}
            SubElement(joints[first], "mimic", {"joint": second} | keys)


def read_description(path: Path) -> Element:
    """Return a URDF or MJCF description as URDF, not checked yet.

    Raises:
        RobotModelError: the file cannot be read, or is neither.
    """
    root = read_xml(path)
    if root.tag == "mujoco":
        root = mjcf_to_urdf(root, path)
    if root.tag != "robot":
        raise RobotModelError(
            f"{path} is neither URDF nor MJCF: its root element is <{root.tag}>",
            choices=("robot", "mujoco"),
        )
    _take_capsules_apart(root, path)
    remove_empty_shapes(root, search_folders(path))
    return root


def _take_capsules_apart(root: Element, path: Path) -> None:
    """Replace capsules, which not every program reads, by a cylinder and two spheres."""
    for link in root.findall("link"):
        for shape in (*link.findall("collision"), *link.findall("visual")):
            capsule = shape.find("geometry/capsule")
            if capsule is None or not capsule.get("radius"):
                continue
            where = f"{path}: link {link.get('name')!r}: a <capsule>"
            radius, length = capsule.get("radius", ""), capsule.get("length", "0")
            place = origin_pose(shape.find("origin"), where)
            half = 0.5 * parse_number(length, where)
            link.remove(shape)
            for kind, at in (("cylinder", 0.0), ("sphere", -half), ("sphere", half)):
                if half == 0.0 and at == 0.0 and kind == "cylinder":
                    continue  # a capsule without a length is a ball
                part = copy.deepcopy(shape)
                part.attrib.pop("name", None)
                geometry = part.find("geometry")
                assert geometry is not None
                geometry.clear()
                keys = {"radius": radius}
                if kind == "cylinder":
                    keys["length"] = length
                SubElement(geometry, kind, keys)
                write_pose(part, place @ translation(0.0, 0.0, at))
                link.append(part)


def is_plain_urdf(path: Path) -> bool:
    """Tell whether every program can read a description as it is, with its meshes."""
    root = read_xml(path)
    try:
        ElementTree.fromstring(read_file(path))
    except ElementTree.ParseError:  # prefixes that stand for nothing
        return False
    dirs = search_folders(path)
    return (
        root.tag == "robot"
        and root.find("link/collision/geometry/capsule") is None
        and not find_empty_shapes(root, dirs)
        and all(
            find_mesh(mesh.get("filename", ""), dirs) is not None
            for mesh in root.findall("link/collision//mesh")
        )
        # pinocchio wants these, whether they are of use or not.
        and all(
            {"effort", "velocity"} <= limit.attrib.keys()
            for limit in root.findall("joint/limit")
        )
        and all(
            inertial.find("mass") is not None and inertial.find("inertia") is not None
            for inertial in root.findall("link/inertial")
        )
    )

"""Descriptions in MJCF, the format of MuJoCo, rewritten as URDF; pinocchio reads them."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio
from scipy.spatial.transform import Rotation

from planning.errors import RobotModelError
from planning.files import is_file
from planning.robots.descriptions import xml_files
from planning.robots.descriptions.mjcf_settings import write_settings_out
from planning.robots.descriptions.read_description import write_pose
from planning.robots.descriptions.xml_files import read_xml, vector
from planning.transforms import Array, Transform, inverse, translation

_MOST_INCLUDES = 100
"""Depth of files that include files: a deeper one includes itself."""

_UNLIMITED = 1e6
"""A joint with a limit beyond this has none [rad or m]."""

_NUMBERS = {"pos", "quat", "axisangle", "euler", "xyaxes", "zaxis", "axis", "size"}
_NUMBERS |= {"fromto", "range", "scale", "polycoef", "ref"}
_LARGEST = 1e5
"""Largest number that a body is believed to have."""

_WORLD, _ORIGIN = "world", "world.origin"
_FRAMES = pinocchio.FrameType


def urdf_of_mjcf(root: Element, path: Path) -> Element:
    """Return the bodies, joints and geoms of an MJCF file as URDF.

    A joint that an equality ties to another mimics it. Planes are left out: they are floors.
    Speeds are not known: MJCF has none.

    Args:
        root: of its XML.
        path: the file.

    Raises:
        RobotModelError: it cannot be read, or holds what URDF has no words for.
    """
    _include(root, path, 0)
    _check_values(root, path)
    _check_references(root, path)
    drawn = write_settings_out(root, path)
    _prepare(root, path)
    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder, "plain.xml")
        plain.write_bytes(ElementTree.tostring(root))
        try:
            model = pinocchio.buildModelFromMJCF(str(plain))
            shapes = {
                tag: pinocchio.buildGeomFromMJCF(model, str(plain), kind)
                for tag, kind in (
                    ("collision", pinocchio.GeometryType.COLLISION),
                    ("visual", pinocchio.GeometryType.VISUAL),
                )
            }
        except (ValueError, RuntimeError, IndexError, KeyError) as error:
            said = str(error).partition("message:")[2] or str(error)
            raise RobotModelError(
                f"{path} cannot be read as MJCF: {' '.join(said.split())}"
            ) from None
    urdf = Element("robot", name=root.get("model", path.stem))
    frames = _links(urdf, model, drawn, path)
    for tag, geometry in shapes.items():
        for item in geometry.geometryObjects:
            link, frame = frames[item.parentFrame]
            pose = inverse(frame) @ item.placement.homogeneous
            _write_shape(link, tag, item, pose, path)
    _tie(urdf, root, drawn, path)
    return urdf


def _include(root: Element, path: Path, depth: int) -> None:
    """Put the content of included files where they are named."""
    for element in list(root.iter()):
        for at, child in reversed(list(enumerate(element))):
            if child.tag != "include":
                continue
            if depth >= _MOST_INCLUDES:
                raise RobotModelError(f"{path} includes itself")
            other = path.parent / child.get("file", "")
            content = read_xml(other)
            _include(content, path, depth + 1)
            element.remove(child)
            for number, part in enumerate(content):
                element.insert(at + number, part)


def _check_values(root: Element, path: Path) -> None:
    """Require numbers to be numbers of a magnitude that bodies have, and directions to have one."""
    for element in root.iter():
        for key in _NUMBERS & element.attrib.keys():
            name = element.get("name") or element.get("class") or ""
            where = f"{path}: {key} of <{element.tag}> {name!r}"
            text = element.get(key, "")
            values = [xml_files.number(part, where) for part in text.split()]
            if not values or any(abs(value) > _LARGEST for value in values):
                raise RobotModelError(
                    f"{where} must be numbers of at most {_LARGEST:g}, is {text[:60]!r}"
                )
            if key in ("quat", "axis", "zaxis") and not any(values):
                raise RobotModelError(f"{where} must not be zero")


def _check_references(root: Element, path: Path) -> None:
    """Require classes and meshes that are named to be there."""
    classes = {item.get("class", "main") for item in root.iter("default")} | {"main"}
    meshes = {
        item.get("name") or Path(item.get("file", "")).stem
        for item in root.findall("asset/mesh")
    }
    for key, valid in (("class", classes), ("childclass", classes), ("mesh", meshes)):
        for element in root.iter():
            name = element.get(key)
            if name is None or (element.tag == "default" or name in valid):
                continue
            raise RobotModelError(
                f"{path}: {key} {name!r} of a <{element.tag}> is not there",
                choices=tuple(sorted(valid)),
            )


def _prepare(root: Element, path: Path) -> None:
    """Take out what is looks only, and name meshes by where they are."""
    bodies = root.findall("worldbody/body")
    if not bodies:
        raise RobotModelError(f"{path} has no <body> in its <worldbody>")
    for body in bodies:  # a thing that may be anywhere is put somewhere here
        for joint in (*body.findall("freejoint"), *body.findall("joint")):
            if joint.tag == "freejoint" or joint.get("type") == "free":
                body.remove(joint)
    # pinocchio takes the first body for the world, wherever it is.
    for world in root.findall("worldbody"):
        content = list(world)
        for child in content:
            world.remove(child)
        SubElement(world, "body", name=_ORIGIN).extend(content)
    for element in root.iter():
        if element.tag in ("geom", "site"):
            element.attrib.pop("material", None)
    folder = path.parent
    for compiler in root.findall("compiler"):
        place = compiler.get("meshdir") or compiler.get("assetdir") or ""
        folder = folder / place
        for key in ("meshdir", "assetdir", "texturedir"):
            compiler.attrib.pop(key, None)
    for asset in root.findall("asset"):
        for child in list(asset):
            if child.tag in ("texture", "material"):
                asset.remove(child)
            elif child.tag == "mesh":
                _complete(child, folder, path)


def _complete(mesh: Element, folder: Path, path: Path) -> None:
    name = mesh.get("file", "")
    file = folder / name
    if not name or not is_file(file):
        raise RobotModelError(
            f"{path}: mesh {name or mesh.get('name')!r} was not found in {folder}"
        )
    mesh.attrib.setdefault("name", Path(name).stem)
    mesh.set("file", str(file.resolve()))


def _links(
    urdf: Element, model: Any, drawn: Mapping[str, float], path: Path
) -> dict[int, tuple[Element, Array]]:
    """Write links and joints.

    Args:
        urdf: what is written.
        model: of pinocchio, in which every joint is at 0 as it is drawn.
        drawn: values of joints as they are drawn, where these are others [rad or m].
        path: the file, for messages.

    Returns:
        By the number of pinocchio's frame: the link, and the pose of its frame in the frame of the
        joint that moves it.
    """
    at_rest = np.eye(4)
    out = {0: (SubElement(urdf, "link", name=_WORLD), at_rest)}
    for number, frame in enumerate(model.frames):
        if frame.type != _FRAMES.BODY:
            continue
        pose, name = frame.placement.homogeneous, frame.name
        parent, joint = _above(model, number)
        carrier, offset = out[parent]
        if joint is not None:
            level = bool(np.allclose(pose, at_rest))
            link = SubElement(urdf, "link", name=name if level else f"{name}.moved")
            index = joint.parentJoint
            placed = model.jointPlacements[index].homogeneous
            element = _add_joint(
                urdf, joint.name, carrier, link, inverse(offset) @ placed
            )
            _describe(element, model, index, path)
            if joint.name in drawn:
                moved = _moved(element, -drawn[joint.name])
                write_pose(element, inverse(offset) @ placed @ moved)
            carrier, offset = link, at_rest
            if level:
                out[number] = link, at_rest
                continue
        link = SubElement(urdf, "link", name=name)
        element = _add_joint(
            urdf, f"{name}.fixed", carrier, link, inverse(offset) @ pose
        )
        element.set("type", "fixed")
        out[number] = link, pose
    return out


def _above(model: Any, number: int) -> tuple[int, Any]:
    """Return the frame of the body above a body, and the frame of the joint in between, if any."""
    joint, at = None, model.frames[number].parentFrame
    while at != 0 and model.frames[at].type != _FRAMES.BODY:
        if model.frames[at].type == _FRAMES.JOINT:
            joint = model.frames[at]
        at = model.frames[at].parentFrame
    return at, joint


def _add_joint(
    urdf: Element, name: str, parent: Element, child: Element, pose: Transform
) -> Element:
    joint = SubElement(urdf, "joint", name=name)
    SubElement(joint, "parent", link=str(parent.get("name")))
    SubElement(joint, "child", link=str(child.get("name")))
    write_pose(joint, pose)
    return joint


def _describe(joint: Element, model: Any, index: int, path: Path) -> None:
    """Write kind, axis and range of a joint."""
    own = model.joints[index]
    kind = own.shortname()
    if "Composite" in kind:
        raise RobotModelError(
            f"{path}: a body has several joints ({joint.get('name')}); give each a body of its own"
        )
    if own.nv != 1:
        joint.set("type", "floating")
        return
    data = own.createData()
    own.calc(data, pinocchio.neutral(model)[own.idx_q : own.idx_q + own.nq])
    column = np.asarray(data.S, dtype=np.float64).reshape(6)
    slides = bool(np.any(column[:3] != 0.0))
    axis = column[:3] if slides else column[3:]
    SubElement(joint, "axis", xyz=_text(axis))
    low, high = (
        float(limits[own.idx_q])
        for limits in (model.lowerPositionLimit, model.upperPositionLimit)
    )
    limited = own.nq == 1 and low > -_UNLIMITED and high < _UNLIMITED
    joint.set(
        "type", "prismatic" if slides else "revolute" if limited else "continuous"
    )
    if limited:
        SubElement(joint, "limit", lower=repr(low), upper=repr(high))


def _moved(joint: Element, value: float) -> Transform:
    """Return what a joint of a URDF moves by [rad or m]."""
    axis = joint.find("axis")
    if axis is None:
        return np.eye(4)
    along = value * np.array(vector(axis.get("xyz", ""), str(joint.get("name"))))
    if joint.get("type") == "prismatic":
        return translation(*along)
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(along).as_matrix()
    return pose


def _write_shape(
    link: Element, tag: str, item: Any, pose: Transform, path: Path
) -> None:
    for shape, keys, at in _primitives(item, path, tag):
        element = SubElement(link, tag)
        write_pose(element, pose @ at)
        SubElement(SubElement(element, "geometry"), shape, keys)
        if tag == "visual":
            red, green, blue, alpha = (float(v) for v in item.meshColor)
            material = SubElement(element, "material", name="")
            SubElement(material, "color", rgba=f"{red} {green} {blue} {alpha}")


def _primitives(
    item: Any, path: Path, tag: str
) -> Iterator[tuple[str, dict[str, str], Transform]]:
    """Yield the URDF shapes of a geom, each with its pose in the geom's frame."""
    shape, here = item.geometry, np.eye(4)
    kind = type(shape).__name__
    if kind == "Box":
        yield "box", {"size": _text(2.0 * np.asarray(shape.halfSide))}, here
    elif kind == "Sphere":
        yield "sphere", {"radius": repr(float(shape.radius))}, here
    elif kind in ("Cylinder", "Capsule"):
        radius, half = repr(float(shape.radius)), float(shape.halfLength)
        yield "cylinder", {"radius": radius, "length": repr(2.0 * half)}, here
        for end in (-half, half) if kind == "Capsule" else ():
            yield "sphere", {"radius": radius}, translation(0.0, 0.0, end)
    elif hasattr(shape, "vertices"):
        scale = _text(np.asarray(item.meshScale))
        yield "mesh", {"filename": item.meshPath, "scale": scale}, here
    elif kind not in ("Halfspace", "Plane") and tag == "collision":
        raise RobotModelError(
            f"{path}: geom {item.name!r} is of a kind that cannot be read ({kind}); give it another, or"
            " contype and conaffinity 0",
            choices=("box", "sphere", "cylinder", "capsule", "mesh"),
        )


def _tie(urdf: Element, root: Element, drawn: Mapping[str, float], path: Path) -> None:
    """Write the joints that an equality ties to another one as joints that mimic it.

    It ties what they have moved since they were drawn.
    """
    joints = {str(joint.get("name")): joint for joint in urdf.findall("joint")}
    for tie in root.findall("equality/joint"):
        first, second = tie.get("joint1", ""), tie.get("joint2", "")
        if second not in joints or first not in joints:
            continue
        factors = [*map(float, tie.get("polycoef", "0 1 0 0 0").split())]
        if any(factors[2:]):
            raise RobotModelError(
                f"{path}: joint {first!r} follows {second!r} along a curve; only straight lines can be"
                " followed"
            )
        offset, factor = (*factors, 0.0, 0.0)[:2]
        offset += drawn.get(first, 0.0) - factor * drawn.get(second, 0.0)
        SubElement(
            joints[first],
            "mimic",
            joint=second,
            multiplier=repr(factor),
            offset=repr(offset),
        )


def _text(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)

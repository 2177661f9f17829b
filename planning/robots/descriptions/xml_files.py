"""Robot descriptions as XML files: read leniently, their meshes found, their numbers checked.

The files of a robot's description: their hash, a copy for a plan, and those that are made here.
"""

from __future__ import annotations

import atexit
import hashlib
import math
import os
import re
import shutil
import tempfile
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache, lru_cache
from hashlib import sha256
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement, TreeBuilder
from xml.parsers import expat

import numpy as np
from scipy.spatial.transform import Rotation

from planning.cell.robot_model import RobotModel
from planning.errors import OutputError, RobotModelError
from planning.files import is_file, read_file, ros_folders
from planning.transforms import Array, Transform, from_rpy

# Some files begin with comments, and say only then that they are XML.
_DECLARATION = re.compile(rb"\A((?:\s+|<!--.*?-->)+)<\?xml[^>]*\?>", re.DOTALL)


def read_xml(path: Path) -> Element:
    """Return the root of an XML file, prefixes of names left as they are written.

    Files of vendors name elements such as ``drake:member`` and attributes such as
    ``drake:acceleration`` without saying what the prefix stands for.

    Raises:
        RobotModelError: the file is missing, cannot be read, or is not XML.
    """
    if not is_file(path):
        raise RobotModelError(f"robot description {path} does not exist")
    try:
        content = read_file(path)
    except OSError as error:
        raise RobotModelError(f"{path} cannot be read: {error.strerror}") from None
    builder, parser = TreeBuilder(), expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    try:
        # Some files end with a byte that is nought.
        content = content.rstrip(b"\0 \t\r\n")
        parser.Parse(_DECLARATION.sub(rb"\1", content, count=1), True)
        return builder.close()
    except (expat.ExpatError, ValueError, LookupError, AssertionError) as error:
        raise RobotModelError(f"{path} is not XML: {error}") from None


def without_prefixes(root: Element) -> None:
    """Take elements and attributes with a prefix out: they are notes to other programs."""
    for element in list(root.iter()):
        for child in list(element):
            if ":" in child.tag:
                element.remove(child)
        for key in [key for key in element.attrib if ":" in key]:
            del element.attrib[key]


_ABOVE = 3
"""So many folders above that of a description are searched."""


def search_folders(path: Path, package_dirs: Sequence[Path] = ()) -> tuple[Path, ...]:
    """Return where the meshes of a description are looked up, its own folder first.

    Where ROS is set up, its packages are searched too.
    """
    above = list(path.resolve().parents)[1 : _ABOVE + 1]
    return tuple(dict.fromkeys((path.parent, *package_dirs, *above, *ros_folders())))


def find_mesh(name: str, dirs: Sequence[Path]) -> Path | None:
    """Return the first file that a mesh's name may mean, None where there is none."""
    bare = bare_name(name)
    places = (folder / bare for folder in dirs)  # an absolute path stays as it is
    return next((place for place in places if is_file(place)), None)


def find_mesh_of_package(name: str, dirs: Sequence[Path]) -> Path | None:
    """Return the file that a mesh's name may mean where its package's folder is called otherwise.

    A package that was downloaded is often in a folder such as ``arm_description-main``.
    """
    found = find_mesh(name, dirs)
    if found is None and name.startswith(("package://", "model://")):
        found = find_mesh(bare_name(name).partition("/")[2], dirs)
    return found


def bare_name(name: str) -> str:
    """Return the name of a mesh without the scheme in front of it."""
    for scheme in ("file://", "package://", "model://"):
        name = name.removeprefix(scheme)
    return name


# What a link may measure and how far from its joint it may be [m], [rad]: libraries crash,
# or never end, on bodies of 1e300 m and of no size at all.
SIZES = {
    "size": (1e-6, 1000.0, 3),
    "radius": (1e-6, 1000.0, 1),
    "length": (1e-6, 1000.0, 1),
    "scale": (1e-9, 1e6, 3),
}
_PLACES = {"xyz": (0.0, 1000.0, 3), "rpy": (0.0, 1e4, 3)}

SHAPES = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}
SHAPES |= {"mesh": ("filename",)}


def check_numbers(root: Element, path: Path) -> None:
    """Require every number of the geometry to be one, and of a magnitude that bodies have."""
    for joint in root.findall("joint"):
        where = f"{path}: joint {joint.get('name')!r}"
        # Also of a second one, though only the first counts.
        for element in (*joint.findall("origin"), *joint.findall("axis")):
            _check_values(element, _PLACES, where)
    for link in root.findall("link"):
        where = f"{path}: link {link.get('name')!r}"
        for body in link.findall("collision"):
            for origin in body.findall("origin"):
                _check_values(origin, _PLACES, where)
            for shape in body.findall("geometry/*"):
                _require_keys(shape, where)
                _check_values(shape, SIZES, where)


def check_meshes(root: Element, path: Path, dirs: Sequence[Path]) -> None:
    """Require the mesh of every collision shape to be there."""
    for link in root.findall("link"):
        for element in link.findall("collision//mesh"):
            name = attribute(element, "filename", path)
            if find_mesh_of_package(name, dirs) is None:
                raise RobotModelError(
                    f"{path}: link {link.get('name')!r}: mesh {name!r} was not found in "
                    + ", ".join(str(place) for place in dict.fromkeys(dirs))
                )


def _require_keys(shape: Element, where: str) -> None:
    if shape.tag not in SHAPES:
        raise RobotModelError(
            f"{where}: collision shape <{shape.tag}> is not supported",
            choices=tuple(SHAPES),
        )
    for key in SHAPES[shape.tag]:
        if not shape.get(key):
            raise RobotModelError(f"{where}: a <{shape.tag}> has no {key}")


def _check_values(
    element: Element,
    ranges: Mapping[str, tuple[float, float, int]],
    owner: str,
) -> None:
    for key in sorted(ranges.keys() & set(element.keys())):
        least, most, count = ranges[key]
        where, text = f"{owner}: {key} of a <{element.tag}>", element.get(key, "")
        for value in vector(text, where, count):
            # A mirrored mesh has a negative scale.
            size = abs(value) if key in ("scale", "xyz", "rpy") else value
            if not least <= size <= most:
                raise RobotModelError(
                    f"{where} must be {least:g} to {most:g}, is {value:g}"
                )


def number(text: str, where: str) -> float:
    """Return a number of a description; ``where`` says which one, for messages."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise RobotModelError(f"{where} must be a finite number, is {text!r}")
    return value


def vector(text: str, where: str, count: int = 3) -> tuple[float, ...]:
    """Return so many numbers of a description."""
    values = tuple(number(part, where) for part in text.split())
    if len(values) != count:
        raise RobotModelError(f"{where} must be {count} numbers, is {text[:60]!r}")
    return values


def numbers_text(values: Iterable[float]) -> str:
    """Return numbers as descriptions have them."""
    return " ".join(repr(float(value)) for value in values)


def pose_of(element: Element | None, where: str) -> Transform:
    """Return the pose that an ``<origin>`` stands for; none stands for no offset."""
    if element is None:
        return np.eye(4)
    xyz = vector(element.get("xyz", "0 0 0"), f"{where}, xyz of <origin>")
    rpy = vector(element.get("rpy", "0 0 0"), f"{where}, rpy of <origin>")
    return from_rpy(xyz, rpy)


def write_pose(parent: Element, pose: Transform) -> None:
    """Give an element an ``<origin>`` in place of what it has."""
    for old in parent.findall("origin"):
        parent.remove(old)
    turned = np.asarray(pose)[:3, :3]
    level = np.array_equal(turned, np.eye(3))
    with warnings.catch_warnings(action="ignore"):  # where two angles say the same
        rpy = np.zeros(3) if level else Rotation.from_matrix(turned).as_euler("xyz")
    xyz = np.asarray(pose)[:3, 3]
    SubElement(parent, "origin", xyz=numbers_text(xyz), rpy=numbers_text(rpy))


TURNING = ("revolute", "continuous")
"""Kinds of joints that turn; others that move slide."""


def joint_axis(joint: Element, where: str) -> Array:
    """Return the unit axis of a joint in its own frame, shape (3,)."""
    element = joint.find("axis")
    text = "1 0 0" if element is None else element.get("xyz", "1 0 0")
    axis = np.array(vector(text, f"{where}, axis"))
    length = math.hypot(*axis)
    if length == 0.0:
        raise RobotModelError(f"{where} has no direction: axis {text!r}")
    return axis / length


def joint_motion(joint: Element, value: float, where: str) -> Transform:
    """Return what a joint that turns or slides moves its link by, at a value [rad or m]."""
    along, move = joint_axis(joint, where) * value, np.eye(4)
    if joint.get("type") in TURNING:
        move[:3, :3] = Rotation.from_rotvec(along).as_matrix()
    else:
        move[:3, 3] = along
    return move


def joint_link(joint: Element, tag: str) -> str:
    """Return the link at an end of a joint, ``parent`` or ``child``; empty where it names none."""
    end = joint.find(tag)
    return "" if end is None else str(end.get("link"))


def pose_in_root(
    link: str, above: Mapping[str, Element], values: Mapping[str, float], where: str
) -> Transform:
    """Return the pose of a link in the frame of the root of its description.

    Args:
        link: its name.
        above: the joint that each link hangs on.
        values: of the joints that are not at zero [rad or m].
        where: description, for messages.
    """
    pose = np.eye(4)
    while link in above:
        joint = above[link]
        name = str(joint.get("name"))
        if name in values:
            pose = joint_motion(joint, values[name], f"{where}: joint {name!r}") @ pose
        pose = pose_of(joint.find("origin"), f"{where}: joint {name!r}") @ pose
        link = joint_link(joint, "parent")
    return pose


def attribute(element: Element, key: str, path: Path) -> str:
    """Return an attribute that an element must have."""
    value = element.get(key)
    if not value:
        raise RobotModelError(f"{path}: a <{element.tag}> has no {key}")
    return value


MESH_BYTES = 1 << 30
"""Bytes of a mesh of a description."""


def description_sha256(model: RobotModel) -> str | None:
    """Return a hash of a robot's URDF and of all meshes that it collides with.

    Returns:
        None where the description is not in files, or not there any more.
    """
    if not is_file(model.urdf):
        return None
    stamps = tuple(path.stat().st_mtime_ns for _, path in _meshes(model, "collision"))
    return _sha256(model, (model.urdf.stat().st_mtime_ns, *stamps))


@lru_cache(maxsize=64)
def _sha256(model: RobotModel, stamps: tuple[int, ...]) -> str:
    """Hash what the files hold; ``stamps`` makes an edited file be read anew."""
    digest = hashlib.sha256(read_file(model.urdf))
    for _, path in _meshes(model, "collision"):
        digest.update(hashlib.sha256(read_file(path, MESH_BYTES)).digest())
    return digest.hexdigest()


def copy_description(model: RobotModel, folder: Path) -> Path:
    """Copy a robot's URDF and meshes to where they are found without the rest of the disk.

    Args:
        model: the robot, whose URDF stays as it is.
        folder: where the files go, made where it is missing.

    Returns:
        The copy of the URDF.

    Raises:
        OutputError: a file cannot be copied.
    """
    target = folder / model.urdf.name
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _copy(model.urdf, target)
        for name, path in _meshes(model, ""):
            place = folder / name
            # What is named by its place on this disk, or above the URDF, is not brought along.
            if place.resolve().is_relative_to(folder.resolve()):
                place.parent.mkdir(parents=True, exist_ok=True)
                _copy(path, place)
    except OSError as error:
        raise OutputError(f"{target}: cannot be written: {error}") from error
    return target


def _copy(source: Path, target: Path) -> None:
    if source.resolve() != target.resolve():
        shutil.copyfile(source, target)


def _meshes(model: RobotModel, purpose: str) -> Iterator[tuple[str, Path]]:
    """Yield the meshes of a description by their names without a scheme, each once."""
    root = ElementTree.fromstring(read_file(model.urdf))
    seen = set()
    for mesh in root.findall(f".//{purpose}//mesh" if purpose else ".//mesh"):
        name = mesh.get("filename", "")
        found = find_mesh(name, model.package_dirs)
        if found is not None and name not in seen:
            seen.add(name)
            yield name.removeprefix("file://").removeprefix("package://"), found


def keep_description(root: Element, name: str) -> Path:
    """Write a description to a file, with its meshes beside it; the same goes to the same file.

    Args:
        root: of a URDF whose meshes have absolute names; they are named anew here.
        name: of the file, without a suffix.

    Returns:
        The file; it is gone when the program ends.
    """
    meshes: dict[str, str] = {}
    for mesh in root.iter("mesh"):
        source = mesh.get("filename", "")
        number = len(meshes)
        target = meshes.setdefault(source, f"meshes/{number:02d}-{Path(source).name}")
        mesh.set("filename", target)
    text = ElementTree.tostring(root)
    digest = sha256(text)
    for source in meshes:
        stat = os.stat(source)
        digest.update(f"{source} {stat.st_mtime_ns} {stat.st_size}".encode())
    folder = kept_folder() / digest.hexdigest()[:16]
    path = folder / f"{name}.urdf"
    if not path.exists():
        (folder / "meshes").mkdir(parents=True, exist_ok=True)
        for source, target in meshes.items():
            _link(Path(source), folder / target)
        # Written last, and at once: who finds it finds its meshes too.
        draft = folder / f"{name}.{os.getpid()}"
        draft.write_bytes(text)
        draft.replace(path)
    return path


@cache
def kept_folder() -> Path:
    """Return a folder that is there as long as the program runs."""
    folder, owner = Path(tempfile.mkdtemp(prefix="assembly-twin-")), os.getpid()

    def remove() -> None:
        if os.getpid() == owner:  # a process that was forked has the same folder
            shutil.rmtree(folder, ignore_errors=True)

    atexit.register(remove)
    return folder


def _link(source: Path, target: Path) -> None:
    """Put a file in a second place, without a copy where the file system can do that."""
    try:
        target.symlink_to(source)
    except FileExistsError:
        return
    except OSError:
        shutil.copyfile(source, target)

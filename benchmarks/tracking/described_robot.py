"""What a plant is told of robots and parts: descriptions, bases, masses, and where parts are held."""

import xml.etree.ElementTree as ElementTree
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pinocchio.rpy import matrixToRpy
from scipy.spatial.transform import Rotation

from planning.cell.workcell import CellObject, PlacedRobot
from planning.robots.descriptions.xml_files import find_mesh
from planning.robots.registry import ROBOTS
from planning.transforms import Array, Transform, from_quat_wxyz
from twin.trial.run_result import RunResult

PLACE = "payload//"
"""How the links are called at which parts are held."""


@dataclass(frozen=True)
class Payload:
    """A part as it is held: a box of its size and mass.

    Attributes:
        place: number of the link that carries it.
        mass: [kg].
        inertia: about its centre, along the axes of the link, shape (3,) [kg m^2].
    """

    place: int
    mass: float
    inertia: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class DescribedRobot:
    """A robot as its own file describes it.

    Attributes:
        name: in the cell.
        urdf: text of its description; parts are held at links of it that weigh nothing.
        joints: names of the joints that are driven.
        effort: what each joint can do at most, shape (n,) [N m or N].
        sliding: whether each joint slides, shape (n,).
        base: pose of its base in the world.
        holds: payloads by part, in the order in which the robot takes hold of it.
    """

    name: str
    urdf: str
    joints: tuple[str, ...]
    effort: tuple[float, ...]
    sliding: tuple[bool, ...]
    base: Transform
    holds: Mapping[str, tuple[Payload, ...]]


def described_robots(folder: Path) -> tuple[DescribedRobot, ...]:
    """Return the robots of a run's folder, and how they hold its parts.

    Of the plan only the list of robots and parts is read: which URDF file, where its base stands,
    where its flange is, what its joints can do, what a part weighs and how large it is; of the run, how
    parts lay in the hands of robots (``objects.parquet``). A tool that is changed is a part with
    the mass that its own description tells.
    """
    run = RunResult(folder)
    parts = {part.name: part for part in run.tpg.cell.objects}
    for robot in run.tpg.cell.robots:
        for tool in robot.tools:
            mass = _mass(tool.model.urdf) - _mass(robot.model.urdf)
            parts[tool.item.name] = replace(tool.item, mass=mass)
    rows = run.objects.to_pylist()
    return tuple(described_robot(robot, parts, rows) for robot in run.tpg.cell.robots)


def described_robot(
    robot: PlacedRobot,
    parts: Mapping[str, CellObject],
    rows: Sequence[Mapping[str, Any]],
) -> DescribedRobot:
    """Return a robot, with a link for each way in which it ever holds a part.

    Args:
        robot: as it stands in the cell.
        parts: by name.
        rows: of ``objects.parquet``.
    """
    model = robot.model
    assert model.drives is not None
    places: list[Transform] = []
    holds: dict[str, list[Payload]] = defaultdict(list)
    for row in rows:
        if row["parent"] == f"{robot.name}/flange":
            held = np.array(from_quat_wxyz(row["xyz"], row["quat_wxyz"]))
            holds[row["object"]].append(_payload(parts[row["object"]], held, places))
    root = _stiffened(model.urdf, model.joint_names, model.name)
    for mesh in root.iter("mesh"):
        found = find_mesh(str(mesh.get("filename")), model.package_dirs)
        mesh.set("filename", str(found))
    joints = {str(joint.get("name")): joint for joint in root.findall("joint")}
    carrier = joints[model.joint_names[-1]].find("child")
    assert carrier is not None
    for number, place in enumerate(places):
        _add_place(root, number, str(carrier.get("link")), model.flange @ place)
    # Bullet breaks lines of more than 8 kB, in the midst of a word.
    ElementTree.indent(root)
    kinds = [joints[name].get("type") for name in model.joint_names]
    return DescribedRobot(
        robot.name,
        ElementTree.tostring(root, encoding="unicode"),
        model.joint_names,
        tuple(model.drives.effort.tolist()),
        tuple(kind == "prismatic" for kind in kinds),
        robot.base,
        {part: tuple(found) for part, found in holds.items()},
    )


def _mass(urdf: Path) -> float:
    """Return the mass of all links of a description [kg]."""
    masses = ElementTree.parse(urdf).getroot().findall("link/inertial/mass")
    return sum(float(str(mass.get("value"))) for mass in masses)


def _payload(part: CellObject, held: Transform, places: list[Transform]) -> Payload:
    """Return a part as it is held; a hold unlike all others so far gets a place of its own."""
    centre = held.copy()
    centre[:3, 3] += held[:3, :3] @ part.shape.centre_of_mass
    like = [
        k for k, known in enumerate(places) if np.allclose(known, centre, atol=1e-4)
    ]
    place = like[0] if like else len(places)
    if not like:
        places.append(centre)
    x, y, z = (part.mass / 12.0 * float(edge) ** 2 for edge in part.shape.size)
    return Payload(place, part.mass, (y + z, x + z, x + y))


def _stiffened(urdf: Path, driven: tuple[str, ...], model: str) -> ElementTree.Element:
    """Return a description in which joints that nobody drives are fixed where they are held."""
    root = ElementTree.parse(urdf).getroot()
    for link in root.findall("link"):
        if link.find("inertial") is None:
            link.append(_weightless())
    entry = ROBOTS.get(model)
    held = dict(entry.frozen) if entry else {}
    for joint in root.findall("joint"):
        name = str(joint.get("name"))
        if joint.get("type") == "fixed" or name in driven:
            continue
        axis = np.array(_numbers(joint.find("axis"), "xyz", (1.0, 0.0, 0.0)))
        value = held.get(name, 0.0)
        origin = joint.find("origin")
        if origin is None:
            origin = ElementTree.SubElement(joint, "origin")
        turn = Rotation.from_euler("xyz", _numbers(origin, "rpy", (0.0, 0.0, 0.0)))
        if joint.get("type") == "prismatic":
            shift = np.array(_numbers(origin, "xyz", (0.0, 0.0, 0.0)))
            origin.set("xyz", _text(shift + turn.apply(axis * value)))
        else:
            turned = turn * Rotation.from_rotvec(axis * value)
            origin.set("rpy", _text(turned.as_euler("xyz")))
        joint.set("type", "fixed")
        for child in ("mimic", "limit", "axis", "dynamics"):
            found = joint.find(child)
            if found is not None:
                joint.remove(found)
    return root


def _add_place(
    root: ElementTree.Element, number: int, carrier: str, pose: Transform
) -> None:
    """Add a link without mass, fixed at a pose in the frame of a link."""
    name = f"{PLACE}{number}"
    link = ElementTree.SubElement(root, "link", name=name)
    link.append(_weightless())
    joint = ElementTree.SubElement(root, "joint", name=name, type="fixed")
    ElementTree.SubElement(joint, "parent", link=carrier)
    ElementTree.SubElement(joint, "child", link=name)
    turn = matrixToRpy(pose[:3, :3])
    ElementTree.SubElement(joint, "origin", xyz=_text(pose[:3, 3]), rpy=_text(turn))


def _weightless() -> ElementTree.Element:
    """Return what a link without mass says: without a word Bullet gives it 1 kg and 1 kg m^2."""
    inertial = ElementTree.Element("inertial")
    ElementTree.SubElement(inertial, "mass", value="0")
    nothing = dict.fromkeys(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), "0")
    ElementTree.SubElement(inertial, "inertia", nothing)
    return inertial


def _numbers(
    element: ElementTree.Element | None, key: str, default: tuple[float, ...]
) -> tuple[float, ...]:
    text = None if element is None else element.get(key)
    return default if text is None else tuple(map(float, text.split()))


def _text(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)

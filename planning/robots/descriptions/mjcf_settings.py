"""MJCF defaults and compiler settings: element classes, angle units and joint limits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from planning.errors import RobotModelError
from planning.robots.descriptions.xml_files import parse_vector
from planning.transforms import Transform, from_quat_wxyz, identity

_TURNS = ("quat", "axisangle", "euler", "xyaxes", "zaxis")
"""Notations of an orientation; an element has one of them."""

_KINDS = ("hinge", "slide", "ball", "free")

_Attributes = dict[str, dict[str, str]]
"""Attributes by kind of element."""


@dataclass(frozen=True)
class MjcfJoint:
    """A joint with the attributes of its element and class.

    Attributes:
        name: of the joint.
        kind: ``hinge``, ``slide``, ``ball`` or ``free``.
        limits: of a hinge or slide that is limited [rad or m].
        drawn: value of a hinge or slide as it is drawn [rad or m].
    """

    name: str
    kind: str
    limits: tuple[float, float] | None
    drawn: float


class MjcfSettings:
    """Compiler settings and class defaults of an MJCF file.

    Sections that are there several times, as in files that include others, become one.

    Args:
        root: of the XML of a file, changed.
        path: the file, for messages.

    Attributes:
        path: the file.
        mesh_folder: where meshes are.

    Raises:
        RobotModelError: settings contradict each other, or are none.
    """

    def __init__(self, root: Element, path: Path) -> None:
        _merge_sections(root)
        found = root.find("compiler")
        given = {} if found is None else found.attrib
        self.path = path
        folder = given.get("meshdir") or given.get("assetdir") or ""
        self.mesh_folder = path.parent / folder
        angle = given.get("angle", "degree")
        if angle not in ("degree", "radian"):
            raise RobotModelError(
                f"{path}: angle of <compiler> is {angle!r}",
                choices=("degree", "radian"),
            )
        self._angle = 1.0 if angle == "radian" else math.pi / 180.0
        self._auto = given.get("autolimits", "true") == "true"
        self._sequence = given.get("eulerseq", "xyz")
        if len(self._sequence) != 3 or self._sequence.strip("xyzXYZ"):
            raise RobotModelError(
                f"{path}: eulerseq of <compiler> is {self._sequence!r}: must be three of x, y, z, X,"
                " Y and Z"
            )
        self._classes: dict[str, _Attributes] = {"main": {}}
        for default in root.findall("default"):
            self._collect(default, {}, top=True)

    def _collect(self, default: Element, around: _Attributes, *, top: bool) -> None:
        """Collect the attributes of a class and of its nested classes, which override those around them."""
        own = dict(around)
        for child in default:
            if child.tag != "default":
                own[child.tag] = _on_top(own.get(child.tag, {}), child.attrib)
        name = default.get("class", "main")
        for key in (name, "main") if top else (name,):
            self._classes[key] = own
        for child in default.findall("default"):
            self._collect(child, own, top=False)

    def attributes(self, element: Element, around: str) -> dict[str, str]:
        """Return the attributes of an element, with the defaults of its class.

        Args:
            element: of the file.
            around: class of all that name none.
        """
        known = self._classes.get(element.get("class", around), {})
        return _on_top(known.get(element.tag, {}), element.attrib)

    def pose(self, given: Mapping[str, str], where: str) -> Transform:
        """Return the pose given by the attributes of an element."""
        where = f"{self.path}: {where}"
        out = self._turned(given, where)
        out[:3, 3] = parse_vector(given.get("pos", "0 0 0"), f"{where}, pos")
        return out

    def _turned(self, given: Mapping[str, str], where: str) -> Transform:
        key = next((key for key in _TURNS if key in given), "")
        text = given.get(key, "")
        if key == "quat":
            return from_quat_wxyz((0, 0, 0), parse_vector(text, f"{where}, quat", 4))
        if key == "zaxis":
            return turn_from_z(np.array(parse_vector(text, f"{where}, zaxis")))
        if key == "xyaxes":
            sides = np.array(parse_vector(text, f"{where}, xyaxes", 6)).reshape(2, 3)
            if np.linalg.matrix_rank(sides) < 2:
                raise RobotModelError(f"{where}, xyaxes are along one line: {text!r}")
            x = sides[0] / np.linalg.norm(sides[0])
            y = sides[1] - (sides[1] @ x) * x
            y /= np.linalg.norm(y)
            return _with_axes(np.column_stack([x, y, np.cross(x, y)]))
        turned = Rotation.identity()
        if key == "euler":
            angles = parse_vector(text, f"{where}, euler")
            for axis, angle in zip(self._sequence, angles, strict=True):
                step = Rotation.from_euler(axis.lower(), angle * self._angle)
                # Small letters turn with the frame, capital ones do not.
                turned = turned * step if axis.islower() else step * turned
        elif key == "axisangle":
            *along, angle = parse_vector(text, f"{where}, axisangle", 4)
            length = float(np.linalg.norm(along))
            if length == 0.0:
                raise RobotModelError(f"{where}, axisangle has no axis: {text!r}")
            turned = Rotation.from_rotvec(
                np.array(along) * (angle * self._angle / length)
            )
        return _with_axes(turned.as_matrix())

    def joint(self, given: Mapping[str, str], name: str) -> MjcfJoint:
        """Return a joint from its attributes; ``name`` is used for one without a name."""
        name, kind = given.get("name", name), given.get("type", "hinge")
        where = f"{self.path}: joint {name!r}"
        if kind not in _KINDS:
            raise RobotModelError(f"{where} is of type {kind!r}", choices=_KINDS)
        if kind not in ("hinge", "slide"):
            return MjcfJoint(name, kind, None, 0.0)
        # What slides is in metres, whatever angles are in.
        unit = self._angle if kind == "hinge" else 1.0
        drawn = parse_vector(given.get("ref", "0"), f"{where}, ref", 1)[0] * unit
        limited, text = given.get("limited", "auto"), given.get("range")
        if limited == "auto" and text is not None and not self._auto:
            raise RobotModelError(
                f'{where} has a range, and with autolimits="false" nothing says whether it is limited;'
                ' give it limited="true" or limited="false"'
            )
        if limited != "true" and (limited != "auto" or text is None):
            return MjcfJoint(name, kind, None, drawn)
        low, high = parse_vector(text or "", f"{where} is limited: its range", 2)
        if low >= high:
            raise RobotModelError(
                f"{where} is limited: its range must rise, is {text!r}"
            )
        return MjcfJoint(name, kind, (low * unit, high * unit), drawn)


def _merge_sections(root: Element) -> None:
    """Merge all sections of a kind into the first of them."""
    first: dict[str, Element] = {}
    for section in list(root):
        kept = first.setdefault(section.tag, section)
        if kept is not section:
            kept.extend(list(section))
            kept.attrib.update(section.attrib)
            root.remove(section)


def _on_top(low: Mapping[str, str], high: Mapping[str, str]) -> dict[str, str]:
    """Return attributes with overrides; an orientation is overridden as a whole."""
    turned = any(key in high for key in _TURNS)
    kept = {k: v for k, v in low.items() if not (turned and k in _TURNS)}
    return kept | dict(high)


def turn_from_z(direction: npt.NDArray[np.float64]) -> Transform:
    """Return the least rotation that maps the z axis to a direction, shape (3,)."""
    x, y, z = (direction / max(float(np.linalg.norm(direction)), 1e-300)).tolist()
    flat = math.hypot(x, y)
    axis = np.array([-y, x, 0.0]) / flat if flat > 0.0 else np.array([1.0, 0.0, 0.0])
    return _with_axes(Rotation.from_rotvec(math.atan2(flat, z) * axis).as_matrix())


def _with_axes(axes: npt.NDArray[np.float64]) -> Transform:
    out = identity()
    out[:3, :3] = axes
    return out

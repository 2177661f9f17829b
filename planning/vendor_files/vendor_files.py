"""Robot models made of a description and of what its vendor says in further files."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal
from xml.etree.ElementTree import Element

from planning.cell.robot_model import RobotModel
from planning.errors import FittingError, RobotModelError
from planning.files import is_file, resolve_file_name
from planning.robots.descriptions.fitting import Fitting, ignored_pairs
from planning.robots.descriptions.read_description import read_description
from planning.robots.descriptions.urdf_geometry import joint_link
from planning.robots.descriptions.xml_files import parse_number, read_xml
from planning.robots.registry import ROBOTS, robot_model
from planning.vendor_files.semantics import (
    Semantics,
    find_srdf,
    mjcf_semantics,
    srdf_semantics,
)
from planning.vendor_files.xacro_file import (
    NO_ARGUMENTS,
    is_xacro,
    stored_xacro,
    xacro_root,
)

_HOMES = ("home", "ready")
"""Names of poses that are HOME where the cell names none, best first; in any case of letters."""

_SLACK = 1e-3
"""Excess over a joint limit that is taken for rounding [rad or m]."""


def described_robot(
    model: str,
    folder: Path,
    fitting: Fitting,
    **given: str | Literal[False] | Mapping[str, str | float | bool],
) -> RobotModel:
    """Return a registered robot, or one made of a description and of what its vendor says.

    Arguments and errors are as of ``with_vendor_files``.
    """
    if model in ROBOTS:
        for key in given:
            raise FittingError(f"{model!r} is a registered robot: no {key}", key=key)
        return robot_model(model, folder, fitting)
    file, fitting = with_vendor_files(model, folder, fitting, **given)  # type: ignore[arg-type]
    try:
        return robot_model(file, folder, fitting)
    except RobotModelError as error:  # in words of the source
        raise error.with_message(error.message.replace(file, model)) from None


def with_vendor_files(
    model: str,
    folder: Path,
    fitting: Fitting,
    *,
    srdf: str | Literal[False] | None = None,
    home: str | None = None,
    xacro: Mapping[str, str | float | bool] = NO_ARGUMENTS,
) -> tuple[str, Fitting]:
    """Return the path of a description as URDF or MJCF, and the changes that a cell makes to it.

    Args:
        model: path of the description.
        folder: where relative paths start.
        fitting: changes so far; what they say goes before what the vendor says.
        srdf: path of the SRDF file; None for the one that lies with the description, False for none of
            what the vendor says.
        home: name of the pose that is HOME; None for the one called home, else ready.
        xacro: arguments of a description in xacro.

    Raises:
        RobotModelError: a file cannot be used.
        FittingError: a key of the robot does not fit; the message names it.
    """
    path = resolve_file_name(model, folder, RobotModelError)
    if not is_file(path):
        return model, fitting  # which is reported by whoever reads it
    source = path = path.resolve()
    if is_xacro(source):
        path = stored_xacro(source, xacro)
    elif xacro:
        raise FittingError(f"{path} is no xacro file", key="xacro")
    said = None if srdf is False else _semantics(path, source, folder, srdf, xacro)
    if said is None:
        if home is not None:
            raise FittingError(f"{path} comes with no named poses", key="home")
        return str(path), fitting
    root = read_description(path)
    if ignored_pairs(root):  # of a stored description, which has all of it
        return str(path), fitting
    links = {str(link.get("name")) for link in root.findall("link")}
    ignored = {
        pair: f"{said.path.name}: {why}" if why else said.path.name
        for pair, why in said.ignored.items()
        if set(pair) <= links
    }
    return str(path), replace(
        fitting,
        ignored={**ignored, **fitting.ignored},
        home=_home(said, root, fitting, home),
        proposed=tuple(link for link in said.hands if link in links),
    )


def _semantics(
    path: Path,
    source: Path,
    folder: Path,
    srdf: str | None,
    xacro: Mapping[str, str | float | bool],
) -> Semantics | None:
    """Return what the vendor says of a description that was made of a source."""
    if srdf is None:
        root = read_xml(path)
        if root.tag == "mujoco":
            return mjcf_semantics(root, path)
        found = find_srdf(source, root.get("name", ""))
        return None if found is None else srdf_semantics(found)
    try:
        file = resolve_file_name(srdf, folder, RobotModelError).resolve()
        return srdf_semantics(file, xacro_root(file, xacro) if is_xacro(file) else None)
    except RobotModelError as error:
        raise FittingError(error.message, key="srdf", choices=error.choices) from None


def _home(
    said: Semantics, root: Element, fitting: Fitting, wanted: str | None
) -> dict[str, float]:
    """Return HOME by joint; empty if there is no pose of that name, or it is out of limits.

    Raises:
        FittingError: the wanted pose is not there, or not one for the robot.
    """
    if wanted is None:
        for home in _HOMES:
            for name, pose in said.poses.items():
                if name.lower() == home and not _fault(_chain(root, fitting), pose):
                    return dict(pose)
        return {}
    if wanted not in said.poses:
        words = f"{said.path} has no pose {wanted!r}"
        raise FittingError(words, key="home", choices=tuple(said.poses))
    if fault := _fault(_chain(root, fitting), said.poses[wanted]):
        raise FittingError(f"{said.path}: pose {wanted!r} {fault}", key="home")
    return dict(said.poses[wanted])


def _chain(root: Element, fitting: Fitting) -> list[Element]:
    """Return the joints that move, up to the flange where the cell names it."""
    joints = root.findall("joint")
    if fitting.flange is not None:
        above = {joint_link(joint, "child"): joint for joint in joints}
        joints, link = [], fitting.flange
        while link in above:
            joints.append(above.pop(link))
            link = joint_link(joints[-1], "parent")
    return [
        joint
        for joint in joints
        if joint.get("type") != "fixed"
        and joint.get("name") not in fitting.held
        and joint.find("mimic") is None
    ]


def _fault(joints: Iterable[Element], pose: Mapping[str, float]) -> str:
    """Return what keeps a pose from being HOME of a chain of joints; empty for nothing."""
    for joint in joints:
        name, limit = str(joint.get("name")), joint.find("limit")
        if name not in pose:
            return f"has no value of joint {name!r}"
        if limit is None or joint.get("type") == "continuous":
            continue
        least, most = (
            parse_number(limit.get(key, "0"), f"joint {name!r}, {key} limit")
            for key in ("lower", "upper")
        )
        if not least - _SLACK <= pose[name] <= most + _SLACK:
            return f"has joint {name!r} at {pose[name]:g}, beyond {least:g} to {most:g}"
    return ""

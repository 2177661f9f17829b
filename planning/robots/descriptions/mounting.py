"""Mounting of a tool on an arm: one robot description in which only the arm joints move.

All readers of descriptions, such as the engines of the audit and the recorder, read the result like the
description of a vendor.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from scipy.spatial import ConvexHull

from planning.cell.shape import Box, Capsule, Cylinder, Form, Mesh, Shape
from planning.cell.shape import Element as PlacedForm
from planning.errors import FittingError, RobotModelError, ShapeError
from planning.robots.descriptions.description_files import session_folder
from planning.robots.descriptions.fitting import (
    Fitting,
    Tool,
    free_kinds,
    hold_all_joints,
    hold_joints,
    set_total_mass,
    write_options,
    written_options,
)
from planning.robots.descriptions.read_description import read_description
from planning.robots.descriptions.urdf_file import (
    GivenLimits,
    UrdfOptions,
    checked_tree,
    flange_link,
    moving_order,
    serial_chain,
    tip_link,
)
from planning.robots.descriptions.urdf_geometry import (
    format_numbers,
    joint_link,
    origin_pose,
    pose_in_root,
    write_pose,
)
from planning.robots.descriptions.xml_files import (
    find_mesh_of_package,
    search_folders,
    strip_prefixes,
)
from planning.transforms import (
    Array,
    Indices,
    Transform,
    identity,
    rotation,
    translation,
)

_COLOUR = "0.35 0.37 0.40 1"

Piece = tuple[str, dict[str, str], Transform]
"""Tag and attributes of a shape of URDF, and its pose in the frame of the form."""

_KEPT = ("link", "joint", "material")


def _shapes_to_urdf(name: str, shapes: Sequence[PlacedForm]) -> Element:
    """Return the description of a body with one link.

    Args:
        name: of the thing and of its link.
        shapes: its shapes, each at its pose in the frame of the link.
    """
    root = Element("robot", name=name)
    link = SubElement(root, "link", name=name)
    for shape in shapes:
        for tag, keys, pose in _collisions(shape.form):
            _write(link, "collision", (tag, keys, shape.pose @ pose))
        for tag, keys, pose in _visuals(shape.form):
            _write(link, "visual", (tag, keys, shape.pose @ pose))
    return root


def _cut_meshes(root: Element, within: float) -> None:
    """Replace the collision meshes of a description by their convex pieces.

    Args:
        root: of a URDF whose meshes have absolute names, changed.
        within: how deep a hollow may be that a piece fills [m].

    Raises:
        ShapeError: a mesh cannot be cut.
    """
    from planning.meshes.mesh_loading import load_mesh

    for link in root.findall("link"):
        for collision in link.findall("collision"):
            mesh = collision.find("geometry/mesh")
            if mesh is None:
                continue
            scale = [float(factor) for factor in mesh.get("scale", "1 1 1").split()]
            if len(set(scale)) > 1:
                continue  # a hull is what is left for what is stretched
            form = load_mesh(Path(mesh.get("filename", "")), scale[0], within)
            where = f"link {link.get('name')!r}"
            pose = origin_pose(collision.find("origin"), where)
            link.remove(collision)
            for tag, keys, own in _collisions(form):
                _write(link, "collision", (tag, keys, pose @ own))


def _collisions(form: Form) -> Iterator[Piece]:
    here = np.eye(4)
    if isinstance(form, Mesh):
        for hull in form.hulls:
            faces = ConvexHull(hull).simplices.astype(np.int64)
            yield "mesh", {"filename": _obj(hull, faces)}, here
        return
    if isinstance(form, Box):
        yield "box", {"size": format_numbers(form.size)}, here
        return
    radius = repr(float(form.radius))
    if isinstance(form, Cylinder) or form.length > 0.0:
        keys = {"radius": radius, "length": repr(float(form.length))}
        yield "cylinder", keys, here
    if isinstance(form, Capsule):
        for end in (-0.5, 0.5) if form.length > 0.0 else (0.0,):
            at = translation(0.0, 0.0, end * form.length)
            yield "sphere", {"radius": radius}, at


def _visuals(form: Form) -> Iterator[Piece]:
    if isinstance(form, Mesh):
        yield "mesh", {"filename": _obj(form.vertices, form.faces)}, np.eye(4)
    else:
        yield from _collisions(form)


def _write(link: Element, tag: str, piece: Piece) -> None:
    kind, keys, pose = piece
    element = SubElement(link, tag)
    write_pose(element, pose)
    SubElement(SubElement(element, "geometry"), kind, keys)
    if tag == "visual":
        SubElement(SubElement(element, "material", name=""), "color", rgba=_COLOUR)


def _obj(vertices: Array, faces: Indices | Array) -> str:
    """Write triangles to a cached file; return its path."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in np.asarray(vertices).tolist()]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in np.asarray(faces).tolist()]
    text = "\n".join(lines) + "\n"
    path = session_folder() / f"{sha256(text.encode()).hexdigest()[:16]}.obj"
    if not path.exists():
        draft = path.with_suffix(".new")
        draft.write_text(text)
        draft.replace(path)
    return str(path)


def fitted_description(
    path: Path, options: UrdfOptions, fitting: Fitting, package_dirs: tuple[Path, ...]
) -> Element:
    """Return one description of an arm with the changes that a cell makes.

    Args:
        path: description of the arm.
        options: its other known properties.
        fitting: what the cell adds.
        package_dirs: where its meshes are looked up, besides the usual places.

    Raises:
        RobotModelError: the arm or the tool cannot be used, or they do not fit each other.
    """
    root = read_description(path)
    dirs = search_folders(path, package_dirs)
    known = written_options(root) or options
    checked_tree(root, path, dirs, free_kinds(root))
    links_before = _link_names(root)
    _take_off(root, fitting.removed, "", path)
    _empty(root, fitting.emptied, looks=fitting.looks)
    with _located_errors("joints", bool(fitting.held)):
        hold_joints(root, path, {**known.frozen, **fitting.held})
    if fitting.flange is not None:
        _hold_branches(root, path, dirs, fitting.flange)
    with _located_errors("limits", fitting.limits != GivenLimits()):
        _write_limits(root, path, known, fitting.limits)
    _complete_limits(root)
    arm = serial_chain(root, path, package_dirs)
    with _located_errors("flange", fitting.flange is not None):
        flange = flange_link(arm, fitting.flange or known.flange_link, fitting.proposed)
    if fitting.flange in (None, known.flange_link):
        flange = _with_offset(root, flange, known.flange_offset)
    else:  # what is known of the tool is given in the frame of another flange
        known = replace(known, frames=None)
    write_mesh_paths(root, dirs)
    if fitting.tool is not None:
        with _located_errors("tool", True):
            _take_off(root, frozenset(known.tool_links or ()), flange, path)
            links, frames = _mount(root, flange, fitting.tool)
        grip = fitting.tool.grip
        known = replace(known, tool_links=links, frames=frames, grip=grip)
    if fitting.bare:
        _take_off(root, frozenset(known.tool_links or ()), flange, path)
        left = {str(link.get("name")) for link in root.findall("link")}
        last = arm.fixed_below(arm.child_of(arm.joints[-1].name))
        links = tuple(link for link in last if link in left)
        frames = {"changer": identity()}
        known = replace(known, tool_links=links, frames=frames, grip=None)
    if known.home is not None and len(known.home) != len(arm.joints):
        known = replace(known, home=None)
    if fitting.limits.payload is not None:
        known = replace(known, payload=fitting.limits.payload)
    if known.home is None and fitting.home.keys() >= {j.name for j in arm.joints}:
        known = replace(known, home=tuple(fitting.home[j.name] for j in arm.joints))
    ignored = _ignored_pairs(root, links_before, fitting.ignored)
    known = replace(known, ignored={**known.ignored, **ignored})
    _tidy(root)
    write_options(root, replace(known, flange_link=flange))
    return root


def _empty(root: Element, links: Collection[str], *, looks: bool) -> None:
    """Remove the shapes of some links; what shows is kept for looks."""
    for link in (own for own in root.findall("link") if own.get("name") in links):
        visuals = link.findall("visual")
        for shape in link.findall("collision"):
            if looks and not visuals:
                shape.tag = "visual"
            else:
                link.remove(shape)
        for shape in () if looks else visuals:
            link.remove(shape)


def _hold_branches(
    root: Element, path: Path, dirs: Sequence[Path], flange: str
) -> None:
    """Fix the joints that do not lead to the flange.

    Raises:
        FittingError: nothing moves such a link, or a joint beside the chain follows one of it.
    """
    tree = checked_tree(root, path, dirs, free_kinds(root))
    moved = [k for k in tree.parents if tree.moving.keys() & tree.joints_to(k)]
    if flange not in moved:
        words = f"{path}: {flange!r} is no link that a joint moves"
        raise FittingError(words, key="flange", choices=tuple(moved))
    with _located_errors("joints", True):
        hold_all_joints(root, path, {}, tree.joints_to(flange))


def _link_names(root: Element) -> list[str]:
    return [str(link.get("name")) for link in root.findall("link")]


def _ignored_pairs(
    root: Element, before: Sequence[str], given: Mapping[tuple[str, str], str]
) -> dict[tuple[str, str], str]:
    """Return the given pairs of links that are there; ``before`` are those before a tool was mounted.

    Raises:
        FittingError: a pair names a link that neither the robot nor its tool has.
    """
    now = _link_names(root)
    for name in (name for pair in given for name in pair):
        if name not in now and name not in before:
            raise FittingError(
                f"there is no link {name!r}", key="ignore_contacts", choices=tuple(now)
            )
    return {pair: why for pair, why in given.items() if set(pair) <= set(now)}


@contextmanager
def _located_errors(key: str, given: bool) -> Iterator[None]:
    """Add the key of the cell at fault to errors, where it is given."""
    try:
        yield
    except RobotModelError as error:
        if not given:
            raise
        raise FittingError(error.message, key=key, choices=error.choices) from None


def _tidy(root: Element) -> None:
    """Remove elements of other programs, and incomplete inertias."""
    for child in list(root):
        if child.tag not in _KEPT:
            root.remove(child)
    for link in root.findall("link"):
        inertial = link.find("inertial")
        if inertial is not None and (
            inertial.find("mass") is None or inertial.find("inertia") is None
        ):
            link.remove(inertial)
    strip_prefixes(root)


def _write_limits(
    root: Element, path: Path, options: UrdfOptions, limits: GivenLimits
) -> None:
    own = limits.by_joint()
    given = {**own, **options.by_joint(), **own}  # in this order in the file
    if not given:
        return
    order = moving_order(root, path)
    joints = {str(joint.get("name")): joint for joint in root.findall("joint")}
    for key, values in given.items():
        if len(values) not in (1, len(order)):
            raise RobotModelError(
                f"{path}: limits of {key} are {len(values)} values; the robot has {len(order)} joints"
                f" ({', '.join(order)}): give one for each, or one for all"
            )
        each = values * len(order) if len(values) == 1 else values
        for name, value in zip(order, each, strict=True):
            limit = joints[name].find("limit")
            if limit is None:
                limit = SubElement(joints[name], "limit")
            for old in [k for k in limit.attrib if k.rpartition(":")[2] == key]:
                del limit.attrib[old]
            limit.set(key, repr(float(value)))


def _complete_limits(root: Element) -> None:
    """Rename prefixed limits, such as drake:acceleration, to their URDF names.

    Those that URDF demands are there in any case; 0 says that they are not known.
    """
    for limit in root.findall("joint/limit"):
        for key in ("effort", "velocity"):
            limit.attrib.setdefault(key, "0")
        for key in [key for key in limit.attrib if ":" in key]:
            limit.set(key.rpartition(":")[2], limit.attrib.pop(key))


def _with_offset(root: Element, flange: str, offset: Transform) -> str:
    """Return a link whose frame is the flange, created where an offset requires it."""
    if np.array_equal(offset, np.eye(4)):
        return flange
    name = f"{flange}.flange"
    SubElement(root, "link", name=name)
    _join(root, flange, name, offset)
    return name


def write_mesh_paths(root: Element, dirs: Sequence[Path]) -> None:
    """Replace mesh names by absolute paths; visual meshes may be missing."""
    for link in root.findall("link"):
        for shape in (*link.findall("collision"), *link.findall("visual")):
            mesh = shape.find(".//mesh")
            if mesh is None:
                continue
            found = find_mesh_of_package(mesh.get("filename", ""), dirs)
            if found is not None:
                mesh.set("filename", str(found.resolve()))
            else:
                link.remove(shape)


def _take_off(root: Element, links: frozenset[str], flange: str, path: Path) -> None:
    """Remove the tool that a robot comes with, and everything mounted on it."""
    below = set(links)
    joints = root.findall("joint")
    grown = True
    while grown:
        hanging = {
            joint_link(j, "child") for j in joints if joint_link(j, "parent") in below
        }
        grown = not hanging <= below
        below |= hanging
    if flange in below:
        raise RobotModelError(
            f"{path}: {flange!r} is of the tool that the robot comes with, which the other tool replaces"
        )
    for element in list(root):
        name = str(element.get("name"))
        joint = element.tag == "joint" and joint_link(element, "child") in below
        if joint or (element.tag == "link" and name in below):
            root.remove(element)


def _mount(
    root: Element, flange: str, tool: Tool
) -> tuple[tuple[str, ...], dict[str, Transform]]:
    """Add a tool to an arm; return its links and its frames in the frame of the flange."""
    path = tool.description or Path(tool.name)
    if tool.description is None:
        body = _shapes_to_urdf(tool.name, tool.shapes)
    else:
        body = read_description(path)
    dirs = search_folders(path)
    tree = checked_tree(body, path, dirs, free_kinds(body))
    hold_all_joints(body, path, tool.held)
    write_mesh_paths(body, dirs)
    if tool.within is not None:
        _cut(body, path, tool.within)
    strip_prefixes(body)
    tcp = _tcp(body, tree.root, tool)
    if tool.mass is not None:
        centre = 0.5 * tcp[:3, 3]
        if tool.shapes:
            centre = Shape(tool.shapes, ()).centre_of_mass
        set_total_mass(
            body, tree.root, tool.mass, centre, float(np.linalg.norm(tcp[:3, 3]))
        )
    _rename(body, f"{tool.name}.")
    for child in body:
        if child.tag in ("link", "joint", "material"):
            root.append(child)
    links = tuple(str(link.get("name")) for link in body.findall("link"))
    if not body.findall("link/collision"):
        raise RobotModelError(
            f"{path}: the tool {tool.name!r} has no collision geometry: nothing would keep it from"
            " other things"
        )
    _join(root, flange, f"{tool.name}.{tree.root}", tool.mount)
    quarter = rotation("z", np.pi / 2) if tool.closing == "x" else np.eye(4)
    frames = {"tool": tool.mount @ tcp @ quarter}
    frames |= {name: tool.mount @ pose for name, pose in tool.frames.items()}
    return links, frames


def _cut(body: Element, path: Path, within: float) -> None:
    try:
        _cut_meshes(body, within)
    except ShapeError as error:
        raise RobotModelError(f"{path}: {error}") from None


def _tcp(body: Element, top: str, tool: Tool) -> Transform:
    """Return the tool centre point, in the frame of the tool's root link."""
    if tool.tcp is not None:
        return tool.tcp
    names = tuple(str(link.get("name")) for link in body.findall("link"))
    tip = tip_link(names)
    if tip is None:
        raise RobotModelError(
            f"the tool {tool.name!r} needs a 'tcp', the point between its fingers or at its end as seen"
            f" from link {top!r}: no link of it is named as one"
        )
    joints = {joint_link(joint, "child"): joint for joint in body.findall("joint")}
    return pose_in_root(tip, joints, {}, str(tool.description))


def _rename(body: Element, prefix: str) -> None:
    """Prefix all names, so that they differ from those of the arm."""
    shared = {material.get("name") for material in body.findall("material")}
    for link in body.findall("link"):
        link.set("name", prefix + str(link.get("name")))
    for joint in body.findall("joint"):
        joint.set("name", prefix + str(joint.get("name")))
        for tag in ("parent", "child"):
            end = joint.find(tag)
            if end is not None:
                end.set("link", prefix + str(end.get("link")))
    for material in body.iter("material"):
        if material.get("name") in shared:
            material.set("name", prefix + str(material.get("name")))


def _join(root: Element, parent: str, child: str, pose: Transform) -> None:
    joint = SubElement(root, "joint", name=f"{child}.mount", type="fixed")
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    write_pose(joint, pose)

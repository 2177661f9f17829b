"""What a fitted description says of itself that URDF has no words for: flange, tool, frames, grip.

It is an element of its own under ``<robot>``, which other programs pass over.
"""

from __future__ import annotations

from xml.etree.ElementTree import Element, SubElement

from planning.cell.robot_model import ToolGrip
from planning.robots.descriptions.held_joints import pose_of, write_pose
from planning.robots.descriptions.urdf_checks import number, vector
from planning.robots.descriptions.urdf_file import UrdfOptions
from planning.transforms import readonly

_ELEMENT = "assembly_twin"


def write_options(root: Element, options: UrdfOptions) -> None:
    """Add what is known of a robot besides its links and joints to its description."""
    assert options.flange_link is not None
    notes = SubElement(root, _ELEMENT, flange=options.flange_link)
    if options.home is not None:
        notes.set("home", " ".join(repr(float(value)) for value in options.home))
    if options.payload is not None:
        notes.set("payload_kg", repr(float(options.payload)))
    if options.tool_links is not None:
        tool = SubElement(notes, "tool")
        for link in options.tool_links:
            SubElement(tool, "part", link=link)
    if options.grip is not None:
        grip = SubElement(notes, "grip", tool=options.grip.tool)
        if options.grip.opening is not None:
            least, most = options.grip.opening
            grip.set("opening_m", f"{least!r} {most!r}")
    for name, pose in (options.frames or {}).items():
        write_pose(SubElement(notes, "frame", name=name), pose)


def written_options(root: Element) -> UrdfOptions | None:
    """Return what ``write_options`` wrote into a description, None where it did not.

    Raises:
        RobotModelError: a number is none.
    """
    notes = root.find(_ELEMENT)
    if notes is None:
        return None
    tool, grip = notes.find("tool"), notes.find("grip")
    payload, home = notes.get("payload_kg"), notes.get("home")
    frames = {
        frame.get("name", ""): readonly(pose_of(frame.find("origin"), "a <frame>"))
        for frame in notes.findall("frame")
    }
    return UrdfOptions(
        home=None
        if home is None
        else vector(home, "home of a description", len(home.split())),
        flange_link=notes.get("flange"),
        tool_links=None
        if tool is None
        else tuple(part.get("link", "") for part in tool.findall("part")),
        frames=frames or None,
        grip=None if grip is None else _grip(grip),
        payload=None if payload is None else number(payload, "payload_kg"),
    )


def _grip(element: Element) -> ToolGrip:
    text, tool = element.get("opening_m"), element.get("tool", "tool")
    if text is None:
        return ToolGrip(None, tool)
    least, most = vector(text, "opening_m of a <grip>", 2)
    return ToolGrip((least, most), tool)

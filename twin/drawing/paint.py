"""Paint of robots: each of a team in its own colour, so that they can be told apart."""

from __future__ import annotations

from xml.etree import ElementTree

TEAM, TINTED = "team", "team-tint"
"""Names of the materials of what is painted, and of what is tinted."""

_PAINTED = 0.6
"""Parts of a robot as saturated as this are painted in the team's colour."""

_LIGHT = 0.75
"""Meshes with all channels as light as this are tinted by it."""

_TINT = 0.55
"""Share of the team's colour in the tint."""

_WHITE = (1.0, 1.0, 1.0)


def paint(urdf: ElementTree.Element, colour: tuple[int, int, int]) -> None:
    """Give a robot its colour: what is coloured takes it, white meshes are tinted.

    Parts that are grey or black stay as they are.

    Args:
        urdf: root of the description, changed in place.
        colour: red, green and blue, 0 to 255.
    """
    coats = {
        material.get("name"): channels
        for material in urdf.iter("material")
        if (channels := _channels(material)) is not None
    }
    full = " ".join(f"{c / 255.0:.4f}" for c in colour) + " 1"
    light = (1.0 - _TINT * (1.0 - c / 255.0) for c in colour)
    tint = " ".join(f"{c:.4f}" for c in light) + " 1"
    for visual in urdf.iter("visual"):
        material = visual.find("material")
        own = None if material is None else _channels(material)
        if own is None and material is not None:
            own = coats.get(material.get("name"))
        if own is not None and _saturation(own) >= _PAINTED:
            _coat(visual, TEAM, full)
        elif visual.find("geometry/mesh") is not None and min(own or _WHITE) >= _LIGHT:
            _coat(visual, TINTED, tint)


def _coat(visual: ElementTree.Element, name: str, rgba: str) -> None:
    for material in visual.findall("material"):
        visual.remove(material)
    coat = ElementTree.SubElement(visual, "material", name=name)
    ElementTree.SubElement(coat, "color", rgba=rgba)


def _channels(material: ElementTree.Element) -> tuple[float, ...] | None:
    """Return the colour that a material gives itself, red, green and blue from 0 to 1."""
    coat = material.find("color")
    try:
        return (
            None
            if coat is None
            else tuple(map(float, coat.get("rgba", "").split()))[:3]
        )
    except ValueError:
        return None


def _saturation(channels: tuple[float, ...]) -> float:
    """Return how far from grey a colour is, 0 to 1; what is nearly black counts as grey."""
    bright = max(channels, default=0.0)
    return (bright - min(channels)) / bright if bright > 0.2 else 0.0

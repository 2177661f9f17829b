"""Colours of descriptions as the viewer takes them."""

from __future__ import annotations

from xml.etree import ElementTree

from twin.drawing.paint import TEAM, TINTED


def make_linear(urdf: ElementTree.Element) -> None:
    """Turn the colours that a robot was painted with into the intensities that they stand for.

    Args:
        urdf: root of the description, changed in place.
    """
    for material in urdf.iter("material"):
        coat = material.find("color")
        if coat is not None and material.get("name") in (TEAM, TINTED):
            *channels, alpha = map(float, coat.get("rgba", "").split())
            intensities = [*map(_linear, channels), alpha]
            coat.set("rgba", " ".join(f"{value:.4f}" for value in intensities))


def _linear(channel: float) -> float:
    """Return the intensity that a channel, 0 to 1, stands for: what the viewer takes it for."""
    return channel / 12.92 if channel <= 0.04045 else ((channel + 0.055) / 1.055) ** 2.4

"""Times, poses and colours of descriptions as Rerun takes them."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt
import rerun as rr

from planning.transforms import Array, quat_wxyz
from twin.drawing.paint import TEAM, TINTED
from twin.run.viewer import TIMELINE


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


def time_column(t_ns: npt.ArrayLike) -> rr.TimeColumn:
    """Return simulated times [ns] as the recording's only timeline."""
    exact = np.asarray(t_ns, dtype=np.int64).astype("timedelta64[ns]")
    return rr.TimeColumn(TIMELINE, duration=exact)


def quat_xyzw(pose: Array) -> Array:
    """Return a rotation as Rerun wants it: (x, y, z, w)."""
    return np.roll(quat_wxyz(pose), -1)


def fixed_pose(pose: Array, parent: str, child: str) -> rr.Transform3D:
    """Return the pose of a frame in another as a whole transform."""
    return rr.Transform3D(
        translation=pose[:3, 3],
        quaternion=rr.Quaternion(xyzw=quat_xyzw(pose)),
        parent_frame=parent,
        child_frame=child,
    )

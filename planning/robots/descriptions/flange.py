"""Which link of an arm is its flange, and which of the links on it are its tool."""

from __future__ import annotations

import re

from planning.errors import RobotModelError
from planning.robots.descriptions.urdf_file import UrdfFile

_FLANGES = ("tool0", "flange")
"""Names of flanges, best first. On ROS-Industrial robots z points out of the flange in ``tool0``,
and x does in ``flange``; on others ``flange`` is all there is."""

_TIP = re.compile(
    r"(^|[_./-])(tcp|tool_cent(er|re)_point|grasp_?target|grasp(_frame)?|pinch|tool_tip)$",
    re.IGNORECASE,
)


def flange_link(description: UrdfFile, wanted: str | None) -> str:
    """Return the link whose frame is the flange.

    That is what is asked for; else the link called ``tool0``, else the one called ``flange``,
    with or without a prefix such as ``left_``; else the link that the last joint moves.

    Raises:
        RobotModelError: what is asked for does not hang on the last joint.
    """
    last = description.child_of(description.joints[-1].name)
    below = description.fixed_below(last)
    if wanted is not None:
        if wanted not in below:
            raise RobotModelError(
                f"{description.path}: {wanted!r} is no link on the last joint",
                choices=below,
            )
        return wanted
    for name in _FLANGES:
        if name in below:
            return name
        prefixed = [link for link in below if re.search(rf"[_./-]{name}$", link)]
        if prefixed:
            return prefixed[0]
    return last


def links_on(description: UrdfFile, flange: str) -> tuple[str, ...]:
    """Return the links that hang on the flange: the tool, where nobody says otherwise.

    What hangs on ``flange`` hangs on ``tool0`` too: they are two frames of one face.
    """
    top = flange
    while top in description.parents:
        parent, joint = description.parents[top]
        if joint not in description.fixed or not _is_flange(parent):
            break
        top = parent
    hanging = description.fixed_below(top)[1:]
    return tuple(link for link in hanging if not _is_flange(link))


def tip_link(links: tuple[str, ...]) -> str | None:
    """Return the link that is named as the point at which a tool works, if there is one."""
    return next((link for link in links if _TIP.search(link)), None)


def _is_flange(link: str) -> bool:
    return any(re.search(rf"(^|[_./-]){name}$", link) for name in _FLANGES)

"""Colours of the robots of a team, the same in recordings and Gantt charts.

Seven of the eight colours are from the palette of Okabe and Ito, which colour-blind people can distinguish. From the
ninth robot on, the colours repeat in a darker shade.
"""

from __future__ import annotations

from collections.abc import Sequence

_COLOURS = (
    "#0072b2",
    "#e69f00",
    "#009e73",
    "#cc79a7",
    "#d55e00",
    "#56b4e9",
    "#f0e442",
    "#6b6b6b",
)
_DARKER = 0.62
"""Factor by which the colours of a round are darker than those of the round before."""


def team_colours(robots: Sequence[str]) -> dict[str, str]:
    """Return the colour of each robot, #rrggbb, in the order of the cell."""
    return {robot: _colour(k) for k, robot in enumerate(robots)}


def _colour(k: int) -> str:
    rounds, own = divmod(k, len(_COLOURS))
    return "#" + "".join(
        f"{round(channel * _DARKER**rounds):02x}"
        for channel in parse_rgb(_COLOURS[own])
    )


def parse_rgb(colour: str) -> tuple[int, int, int]:
    """Return red, green and blue of a colour #rrggbb, 0 to 255."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue

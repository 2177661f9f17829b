"""Fits of parts at their goals, and the probability that a robot with a given repeatability misses a place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from planning.parts.part_steps import PartFit, part_fits
from twin.kinds.parts.ordered_parts import OrderedParts
from twin.scenario.sections.cell import RobotSection

_NEGLIGIBLE = 1e-9
"""Smaller probabilities of a miss are neglected."""


@dataclass(frozen=True)
class KnownFit:
    """Fit of a part, with the success probability of each robot.

    Attributes:
        fit: the part, and its play.
        chances: by robot whose repeatability is stated, the probability that it meets the place.
    """

    fit: PartFit
    chances: Mapping[str, float] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Name of the part in the file, without the number of a product."""
        base, _, number = self.fit.part.rpartition(".")
        return base if base and number.isdigit() else self.fit.part

    @property
    def step(self) -> int:
        """Number of the step, from 1."""
        return self.fit.step

    @property
    def words(self) -> str:
        """Description, for people."""
        by = ", ".join(f"{100 * p:.3g} % by {name}" for name, p in self.chances.items())
        return self.fit.words + (f"; fits in {by}" if by else "")

    def content(self) -> dict[str, Any]:
        """Return it for JSON."""
        play = self.fit.play
        return {
            "step": self.fit.step,
            "part": self.fit.part,
            "in": list(play.guides),
            "play_m": 0.0 if play.pressed else play.least,
            "pressed_m": play.pressed,
            "chances": dict(self.chances),
            "words": self.words,
        }


def miss_probabilities(
    parts: OrderedParts, robots: Sequence[RobotSection]
) -> dict[str, float]:
    """Return the probability of missing a place, by ROBOT/PART, for robots with a repeatability.

    For a part that is put down in several places, it is the greatest of their probabilities.

    Args:
        parts: the assembly in order.
        robots: of the cell, as the file describes them.
    """
    out: dict[str, float] = {}
    for fit in known_fits(parts, robots):
        for robot, chance in fit.chances.items():
            name = f"{robot}/{fit.name}"
            out[name] = max(out.get(name, 0.0), 1.0 - chance)
    return {name: miss for name, miss in out.items() if miss > _NEGLIGIBLE}


def known_fits(
    parts: OrderedParts, robots: Sequence[RobotSection]
) -> tuple[KnownFit, ...]:
    """Return the fits of parts at their places, in the order of the steps.

    Of parts of several products, which fit alike, only those of the first one are there. See ``miss_probabilities``
    for the arguments.
    """
    if isinstance(parts.found, str):
        return ()
    stated = {
        robot.name: robot.repeatability_m
        for robot in robots
        if robot.repeatability_m is not None
    }
    out, seen = [], set()
    for fit in part_fits(parts.cell, parts.found):
        alike = KnownFit(fit).name, fit.play.words
        if alike in seen:
            continue
        seen.add(alike)
        chances = {
            name: chance
            for name in fit.robots
            if name in stated and (chance := fit.play.chance(stated[name])) is not None
        }
        out.append(KnownFit(fit, chances))
    return tuple(out)

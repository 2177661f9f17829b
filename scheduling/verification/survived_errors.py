"""Calibration and force-control errors that a plan provably tolerates without collision.

The errors are displacements of robot bases, and deviations of tools from reference paths in skills. Every robot
base has an independent, constant displacement. Objects at rest are at their planned poses, and held objects at
their planned grips. Allowed contacts of the plan, such as those of a gripping tool or of a part that is
put down, are assumed to absorb the error and are excluded. All other pairs of bodies must not touch. Deviations
in skills are treated alike, but displace only the moving parts during the skill.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from planning.cell.workcell import NO_ERROR, PoseError
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.verification.bodies import StillBodies, VerifiedRobot
from scheduling.verification.encounters import Encounter, Encounters
from scheduling.verification.graph_structure import Precedence
from scheduling.verification.object_places import Carried, Resting
from scheduling.verification.problems import Moment
from scheduling.verification.touching import allowed_depths
from scheduling.witness.measuring import Measuring
from scheduling.witness.parts import TOLERANCE
from scheduling.witness.robot import WitnessRobot

_SHARES = (2.0, 8.0)
"""Shares of the required error that are checked, one after the other."""

_LEFT = 1e-5
"""What must be left between two parts: motions that get no further are not looked into [m]."""


@dataclass(frozen=True)
class Limiting:
    """Two parts with the least margin under their errors.

    Attributes:
        first, second: the parts, and when.
        distance_m: as planned [m].
        taken_m: reduction of it by the required errors, at most [m].
    """

    first: Moment
    second: Moment
    distance_m: float
    taken_m: float

    @property
    def margin_m(self) -> float:
        """Remaining distance, negative where they may overlap [m]."""
        return self.distance_m - self.taken_m

    def __str__(self) -> str:
        """Describe it in one phrase."""
        return (
            f"{self.first} and {self.second}, planned {self.distance_m * 1e3:.2f} mm apart:"
            f" the errors may take {self.taken_m * 1e3:.2f} mm,"
            f" a margin of {self.margin_m * 1e3:+.2f} mm"
        )


@dataclass(frozen=True)
class SurvivedShare:
    """Tolerated share of an error, and what limits it.

    Attributes:
        share: proved share of the required error: the largest there is, to 0.04 mm of distance.
        limiting: None where nothing comes near enough: then more may be survived.
    """

    share: float
    limiting: Limiting | None = None


@dataclass(frozen=True)
class SurvivedErrors:
    """Tolerance of a plan to errors of one kind.

    Attributes:
        error: the required error of every robot.
        robots: tolerated share between robots with their loads.
        rest: tolerated share between robots with their loads, and objects and fixtures at rest.
    """

    error: PoseError
    robots: SurvivedShare
    rest: SurvivedShare

    @property
    def ok(self) -> bool:
        """True when the required error is tolerated."""
        return self.least.share >= 1.0

    @property
    def least(self) -> SurvivedShare:
        """The more restrictive of the two."""
        return min(self.robots, self.rest, key=lambda side: side.share)

    def largest(self, side: SurvivedShare) -> PoseError:
        """Return the largest tolerated error of one of the two, for the required ratio."""
        return PoseError(side.share * self.error.m, side.share * self.error.rad)


def survived_errors(
    tpg: TemporalPlanGraph,
    error: PoseError,
    precedence: Precedence,
    geometry: Mapping[str, WitnessRobot],
    histories: tuple[list[Carried], list[Resting]],
    *,
    of_skills: bool = False,
) -> SurvivedErrors:
    """Find the largest share of an error under which no forbidden contact occurs.

    Args:
        tpg: the plan.
        error: of the base of every robot, or of its flange in skills.
        precedence: what precedes what.
        geometry: of all robots.
        histories: of all objects.
        of_skills: whether tools deviate in all skills, and bases are where they should be; else no
            skill deviates.
    """
    carried, resting = histories
    search = _ShareSearch(tpg), _ShareSearch(tpg)
    for share in _SHARES:
        off = PoseError(share * error.m, share * error.rad)
        skills = {t.kind: off for t in tpg.tasks} if of_skills else {}
        base = NO_ERROR if of_skills else off
        robots = [
            VerifiedRobot(tpg, placed, geometry[placed.name], carried, base, skills)
            for placed in tpg.cell.robots
        ]
        still = StillBodies(resting, robots)
        met = Encounters(tpg.cell, robots, still, precedence)
        pairs = met.count - len(robots)
        open_sides = [side.limiting is None for side in search]
        for number, encounters in enumerate(met.all_within(_LEFT, _LEFT)):
            if open_sides[number >= pairs]:
                search[number >= pairs].check(encounters, share)
        if all(side.limiting is not None for side in search):
            break
    between, from_rest = (SurvivedShare(s.share, s.limiting) for s in search)
    return SurvivedErrors(error, between, from_rest)


class _ShareSearch:
    """Search for the largest tolerated share of an error.

    Args:
        tpg: the plan.

    Attributes:
        share: tolerated in all encounters so far.
        limiting: the encounter that limits it.
    """

    def __init__(self, tpg: TemporalPlanGraph) -> None:
        self._allowed = allowed_depths(tpg)
        self._measuring = Measuring()
        self.share = math.inf
        self.limiting: Limiting | None = None

    def check(self, encounters: Iterator[Encounter], share: float) -> None:
        """Check encounters of parts with a share of the error.

        With a smaller error, parts come near each other in fewer pieces, so one check of each encounter is enough.
        """
        if self.limiting is None:
            self.share = share
        for met in encounters:
            self._narrow(met, share)

    def _narrow(self, met: Encounter, whole: float) -> None:
        first, second = met.first, met.second
        if first.entity == second.entity:
            return
        # Pairs in which neither has an error do not limit the share.
        strayed = first.motion.strays(met.rows) + second.motion.strays(met.columns)
        free = strayed > 0.0
        for meant, _ in met.allowed_by(self._allowed):
            free[meant] = False
        rows, columns = met.rows[free], met.columns[free]
        one = np.zeros(len(rows), dtype=np.int64)
        while self.share > 0.0:
            a, b = (
                s.with_errors_scaled(self.share / whole).motion for s in (first, second)
            )
            found = next(
                self._measuring.too_close(a, b, (rows, columns), _LEFT, one), None
            )
            if found is None:
                return
            distance, unit = found.gap + found.strayed, found.strayed / self.share
            spare = distance - _LEFT - TOLERANCE
            self.share = min(self.share, max(0.0, spare / unit))
            self.limiting = Limiting(
                first.moment(int(rows[found.pair])),
                second.moment(int(columns[found.pair])),
                distance,
                unit,
            )

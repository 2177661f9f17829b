"""Independent, slow proof that a saved plan is safe for any delays (``twin verify``).

No code is shared with the construction of the graph. Precedence is computed from the first descendants of nodes.
pinocchio reads robot geometry from the URDF files, and coal computes distances with exact shapes. Occupancy comes
from dense samples, enlarged by a bound on the motion between them.

The structure of the graph is checked. Nodes must do what their tasks specify, without jumps of robots or objects.
The following pairs must be ordered if they come too close: (a) nodes of two robots, (b) a node and a robot at
rest, (c) a node and an object at rest. Allowed contacts have a largest penetration depth. The tolerated errors of
bases and skills are computed in the same pass, see ``survived_errors``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from planning.cell.workcell import NO_ERROR, PoseError
from planning.progress import Progress, no_progress
from planning.transforms import Transform
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.verification.bodies import StillBodies, VerifiedRobot
from scheduling.verification.encounters import Encounter, Encounters
from scheduling.verification.graph_structure import Precedence, check_structure
from scheduling.verification.object_places import (
    Carried,
    Resting,
    jumps,
    object_histories,
)
from scheduling.verification.problems import Moment, Problem
from scheduling.verification.survived_errors import SurvivedErrors, survived_errors
from scheduling.verification.task_deviations import not_as_said
from scheduling.verification.touching import (
    allowed_depths,
    self_contact_problems,
    too_deep_in_hand,
)
from scheduling.witness.measuring import Measuring
from scheduling.witness.parts import TOLERANCE
from scheduling.witness.robot import WitnessRobot

_Key = tuple[int, int]
"""Of both sides: 2 * node, and one more where the robot stands before it."""


@dataclass(frozen=True)
class VerificationReport:
    """Outcome of a verification.

    Attributes:
        pairs_checked: pairs of pieces that may be simultaneous (motions, stands, rests).
        min_distance_robots_m: least distance measured between two robots in such pairs;
            infinite if none came near enough to be measured [m].
        min_distance_objects_m: likewise between a robot or its load and anything else, where
            no contact is allowed [m].
        problems: empty for a plan that keeps its guarantee; cut off at ``limit``.
        survived: its tolerance to base errors, if requested and its structure is sound.
        deviated: its tolerance to deviations in skills, likewise.
    """

    pairs_checked: int
    min_distance_robots_m: float
    min_distance_objects_m: float
    problems: tuple[Problem, ...]
    survived: SurvivedErrors | None = None
    deviated: SurvivedErrors | None = None

    @property
    def ok(self) -> bool:
        """True when there is no problem, and all required errors are tolerated."""
        asked = (self.survived, self.deviated)
        return not self.problems and all(of is None or of.ok for of in asked)


def verify_plan(
    tpg: TemporalPlanGraph,
    *,
    base_error: PoseError = NO_ERROR,
    deviation: PoseError = NO_ERROR,
    limit: int = 100,
    progress: Progress = no_progress,
) -> VerificationReport:
    """Check a plan from scratch.

    Args:
        tpg: the plan.
        base_error: also tell whether it survives that every robot's base is off by up to this.
        deviation: also tell whether it survives that the flange is off its reference path by up to
            this in every skill.
        limit: stop after this number of problems.
        progress: called with the progress.
    """
    precedence, problems = check_structure(tpg)
    geometry = {robot.name: WitnessRobot(robot) for robot in tpg.cell.robots}
    speeds = {name: robot.speeds for name, robot in geometry.items()}
    problems += not_as_said(tpg, speeds)

    def flange(chain: int, node: int, waypoint: int) -> Transform:
        c = tpg.chains[chain]
        before = int(c.first[node]) + waypoint - 1
        q = c.start if before < 0 else c.waypoints[before]
        return geometry[c.robot].flange_pose(q)

    problems += jumps(tpg, flange)
    check = _ClearanceCheck(tpg, limit - len(problems), progress)
    survived = deviated = None
    if precedence is not None and len(problems) < limit:
        histories = object_histories(tpg, flange)
        check.run(precedence, geometry, histories)
        if base_error:
            survived = survived_errors(tpg, base_error, precedence, geometry, histories)
        if deviation:
            deviated = survived_errors(
                tpg, deviation, precedence, geometry, histories, of_skills=True
            )
    return VerificationReport(
        check.pairs,
        check.robots.least,
        check.objects.least,
        tuple([*problems, *check.problems][:limit]),
        survived,
        deviated,
    )


class _ClearanceCheck:
    """Checks all pairs of pieces that may be simultaneous.

    Args:
        tpg: the plan.
        limit: stop after this number of problems.
        progress: called with the progress.

    Attributes:
        problems: found so far.
        pairs: pairs of pieces looked at.
        robots, objects, contacts: measure between two robots, between other things, and where
            these may touch.
    """

    def __init__(self, tpg: TemporalPlanGraph, limit: int, progress: Progress) -> None:
        self.tpg, self.limit, self.progress = tpg, limit, progress
        self.problems: list[Problem] = []
        self.pairs = 0
        self.robots, self.objects = Measuring(), Measuring()
        self.contacts = Measuring()
        self.allowed = allowed_depths(tpg)

    def run(
        self,
        precedence: Precedence,
        geometry: Mapping[str, WitnessRobot],
        histories: tuple[list[Carried], list[Resting]],
    ) -> None:
        """Check all pairs of robots, then every robot with objects and fixtures at rest.

        Args:
            precedence: precedence of the nodes.
            geometry: geometry of all robots.
            histories: histories of all objects.
        """
        tpg, cell = self.tpg, self.tpg.cell
        carried, resting = histories
        self.problems += too_deep_in_hand(tpg, geometry, carried, self.allowed)
        robots = [
            VerifiedRobot(tpg, placed, geometry[placed.name], carried)
            for placed in cell.robots
        ]
        met = Encounters(cell, robots, StillBodies(resting, robots), precedence)
        between, from_rest = cell.clearances.robot_robot, cell.clearances.robot_object
        pairs = met.count - len(robots)
        for done, encounters in enumerate(met.all_within(between, from_rest), 1):
            seen: dict[int, dict[_Key, Problem]] = {}
            for encounter in encounters:
                if len(self.problems) + sum(map(len, seen.values())) >= self.limit:
                    break
                limit, group = from_rest, encounter.at_rest
                if group is None:
                    limit, group = between, 0
                self._settle(encounter, limit, seen.setdefault(group, {}))
            for group in sorted(seen):
                self.problems += _without_repeats(seen[group])
            if done > pairs:
                robot = robots[done - pairs - 1]
                self.problems += self_contact_problems(robot, geometry[robot.name])
            self.progress(done, met.count)
        self.pairs = met.pairs

    def _settle(self, met: Encounter, limit: float, seen: dict[_Key, Problem]) -> None:
        """Record pairs of pieces that come too close, or too deep where they may touch."""
        a, b = met.first, met.second
        if a.entity == b.entity:
            return
        least = np.full(len(met.rows), limit)
        for now, depth in met.allowed_by(self.allowed):
            least[now] = np.minimum(least[now], -depth)
        keys = np.stack([a.keys(met.rows), b.keys(met.columns)])
        if seen:
            new = [key not in seen for key in zip(*keys.tolist(), strict=True)]
            least[~np.array(new)] = -np.inf
        for bound in np.unique(least[least > -np.inf]).tolist():
            some, how = least == bound, self.objects if met.loaded else self.robots
            x, y = a, b
            if bound != limit:  # allowed contacts absorb the errors
                x, y, how = (
                    a.with_errors_scaled(0.0),
                    b.with_errors_scaled(0.0),
                    self.contacts,
                )
            rows, columns = met.rows[some], met.columns[some]
            known = keys[:, some]
            alike = np.ravel_multi_index(tuple(known), tuple(known.max(axis=1) + 1))
            for k, distance, _ in how.too_close(
                x.motion, y.motion, (rows, columns), bound - TOLERANCE, alike
            ):
                first, second = a.moment(int(rows[k])), b.moment(int(columns[k]))
                seen[known[0, k], known[1, k]] = _conflict(first, second, distance)


def _conflict(first: Moment, second: Moment, distance: float) -> Problem:
    how = (
        f"overlap by {-distance * 1e3:.2f} mm"
        if distance < 0
        else f"come within {distance * 1e3:.2f} mm"
    )
    kind = "hold" if first.standing or second.standing else "nodes"
    return Problem(
        "rest" if second.robot is None else kind,
        f"{first} and {second} {how}, and nothing keeps them apart",
        first,
        second,
        distance,
    )


def _without_repeats(seen: dict[_Key, Problem]) -> list[Problem]:
    """Drop stands next to a reported motion, whose ends they share."""
    out = []
    for (u, v), problem in sorted(seen.items(), key=lambda p: p[0]):
        moving = [(n, v) for n in (u - 3, u - 1) if u % 2]
        moving += [(u, n) for n in (v - 3, v - 1) if v % 2]
        if not any(key in seen for key in moving):
            out.append(problem)
    return out

"""Reachability of parts by robots: a lower bound for the search (IV-D).

A part that nobody could pick or place even if nothing but the fixtures stood around will not be
built, whatever the search tries: other parts and robots are not looked at here. Reach is found by
drawing configurations: a robot counts as unable after many draws with many turns of its pad have
all failed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import lru_cache
from itertools import product

import numpy as np

from planning.cell.workcell import Attachment, PlacedRobot, WorldState
from planning.construction.problem.problem import ConstructionProblem, Part
from planning.construction.problem.reach_sampler import ReachSampler
from planning.errors import ConstructionError, listed
from planning.geometry.robot_bodies import entity
from planning.geometry.scene_checker import SceneChecker
from planning.kinematics.kinematics import frame_pose
from planning.transforms import Array, Transform, rotation

_TURNS = 12
"""Random turns of the tool for which a grip is tried."""

_STARTS = 12
"""Configurations asked for at each turn."""

_HANDOVERS = 150
"""Poses of a part that are tried for a handover."""

Handover = tuple[Array, Array, Transform]
"""Configurations of giver and taker, and the pose of the part's centre in the world."""


class ReachBounds:
    """Reachable parts of every robot, in the supply and in place, with grips.

    Answers do not depend on the order of questions: those of a kind draw numbers of their own.

    Attributes:
        problem: parts and team.
    """

    def __init__(self, problem: ConstructionProblem) -> None:
        self.problem = problem
        self._samplers: dict[str, ReachSampler] = {}
        self._known: dict[tuple[object, ...], bool] = {}
        self._kind = _firsts(
            (robot.name, (id(robot.model), robot.base.tobytes()))
            for robot in map(self._robot, problem.team)
        )
        self._likeness = _firsts(
            (part.name, (problem.object(part).size.tobytes(), _touches(part)))
            for part in problem.parts
        )

    def sampler(self, robot: str) -> ReachSampler:
        """Return the sampler of configurations of a robot."""
        if robot not in self._samplers:
            placed = self.problem.cell.robot(robot)
            self._samplers[robot] = ReachSampler(placed, self.problem.frame)
        return self._samplers[robot]

    def pick_grips(self, robot: str, part: Part) -> tuple[int, ...]:
        """Return the numbers of the grips by which a robot reaches a part in the supply."""
        start = self.problem.object(part).start
        return self._grips("pick", robot, part, start)

    def place_grips(self, robot: str, part: Part) -> tuple[int, ...]:
        """Return the numbers of the grips by which a robot reaches a part in its place."""
        return self._grips("place", robot, part, part.goal)

    def pickers(self, part: Part) -> tuple[str, ...]:
        """Return the robots that reach a part in the supply."""
        return tuple(r for r in self.problem.team if self.pick_grips(r, part))

    def placers(self, part: Part) -> tuple[str, ...]:
        """Return the robots that reach the place of a part."""
        return tuple(r for r in self.problem.team if self.place_grips(r, part))

    def alone(self, part: Part) -> tuple[str, ...]:
        """Return the robots that can pick and place a part by one grip."""
        return tuple(
            r
            for r in self.problem.team
            if set(self.pick_grips(r, part)) & set(self.place_grips(r, part))
        )

    def can_hand_over(self, giver: str, taker: str, part: Part) -> bool:
        """Tell whether there is a pose in which both reach a part.

        The giver holds it by a grip by which it could have picked it; the taker by any.
        """
        kinds = tuple(self._kind[r] for r in (giver, taker))
        key = (
            "handover",
            *kinds,
            self._likeness[part.name],
            self.pick_grips(giver, part),
        )
        if key not in self._known:
            rng = self._draws(key)
            found = self.draw_handover(giver, taker, part, rng)
            self._known[key] = found is not None
        return self._known[key]

    def draw_handover(
        self,
        giver: str,
        taker: str,
        part: Part,
        rng: np.random.Generator,
    ) -> Handover | None:
        """Return configurations in which two robots hold a part at once, None if none is found.

        Args:
            giver: who holds it first.
            taker: who takes it over.
            part: what is handed over.
            rng: what is drawn from.
        """
        pairs = list(self._grip_pairs(giver, part))
        if not pairs or giver == taker:
            return None
        # The robot that cannot drive leads: the other one comes to it.
        lead = 0 if not self.sampler(giver).mobile else 1
        robots = (giver, taker)
        half = 0.5 * float(np.max(self.problem.object(part).size))
        for _ in range(_HANDOVERS):
            pair = pairs[int(rng.integers(len(pairs)))]
            q_lead = self.sampler(robots[lead]).draw(rng)
            held = part.grips[pair[lead]].held(rng.uniform(-np.pi, np.pi))
            at = (
                frame_pose(self._robot(robots[lead]), q_lead, self.problem.frame) @ held
            )
            if at[2, 3] < half:
                continue
            other = part.grips[pair[1 - lead]].touch
            target = at @ other @ rotation("z", rng.uniform(-np.pi, np.pi))
            found = self.sampler(robots[1 - lead]).sample(target, rng, 4)
            if found:
                both = (q_lead, found[0]) if lead == 0 else (found[0], q_lead)
                return (*both, at)
        return None

    def chain(self, part: Part) -> tuple[str, ...] | None:
        """Return a shortest chain of robots that could bring a part to its place, or None."""
        alone = self.alone(part)
        if alone:
            return alone[:1]
        placers = set(self.placers(part))
        chains: list[tuple[str, ...]] = [(robot,) for robot in self.pickers(part)]
        seen = {chain[0] for chain in chains}
        for chain in chains:  # grows while it is gone through: breadth first
            for taker in self.problem.team:
                if taker in chain or (taker in seen and taker not in placers):
                    continue
                if self.can_hand_over(chain[-1], taker, part):
                    if taker in placers:
                        return (*chain, taker)
                    seen.add(taker)
                    chains.append((*chain, taker))
        return None

    def _grips(
        self, what: str, robot: str, part: Part, at: Transform
    ) -> tuple[int, ...]:
        return tuple(
            k
            for k in range(len(part.grips))
            if self._reaches(
                (what, self._kind[robot], part.name, k), robot, part, at, k
            )
        )

    def _reaches(
        self, key: tuple[object, ...], robot: str, part: Part, at: Transform, grip: int
    ) -> bool:
        if key not in self._known:
            sampler, scene = self.sampler(robot), self._scene(robot, part, at)
            rng = self._draws(key)
            turns = rng.uniform(-np.pi, np.pi, _TURNS)
            self._known[key] = any(
                scene.configuration_free(q)
                for turn in turns
                for q in sampler.sample(
                    self.problem.tool_pose(part, at, grip, turn), rng, _STARTS
                )
            )
        return self._known[key]

    def _scene(self, robot: str, part: Part, at: Transform) -> SceneChecker:
        """Return a checker of a robot with nothing around but the fixtures and a part."""
        placed, item = self._robot(robot), self.problem.object(part)
        cell = replace(self.problem.cell, robots=(placed,), objects=(item,))
        there = WorldState({robot: placed.home}, {item.name: Attachment(None, at)})
        pad = frozenset((entity(robot, "tool"), item.name))
        return SceneChecker(cell, robot, there, frozenset({pad}))

    def _grip_pairs(self, giver: str, part: Part) -> Iterator[tuple[int, int]]:
        for mine, yours in product(
            self.pick_grips(giver, part), range(len(part.grips))
        ):
            if part.grips_apart(mine, yours):
                yield mine, yours

    def _robot(self, name: str) -> PlacedRobot:
        return self.problem.cell.robot(name)

    def _draws(self, key: tuple[object, ...]) -> np.random.Generator:
        """Return what is drawn from to answer a question."""
        return np.random.default_rng([self.problem.seed, *repr(key).encode()])


def _touches(part: Part) -> tuple[bytes, ...]:
    return tuple(grip.touch.tobytes() for grip in part.grips)


def _firsts(named: Iterable[tuple[str, object]]) -> dict[str, int]:
    """Return for each name the number of the first one of the same kind."""
    first: dict[object, int] = {}
    return {
        name: first.setdefault(kind, number)
        for number, (name, kind) in enumerate(named)
    }


@lru_cache(maxsize=4)
def reach_bounds(problem: ConstructionProblem) -> ReachBounds:
    """Return the reachability of parts by robots, cached for checks and planning."""
    return ReachBounds(problem)


def require_reach(bounds: ReachBounds) -> None:
    """Check that every part can be brought to its place by someone, or by a chain.

    Raises:
        ConstructionError: names the parts, and the robots that were considered.
    """
    problem = bounds.problem
    team = listed(problem.team)
    for part in problem.parts:
        if not bounds.pickers(part):
            x, y, z = problem.object(part).start[:3, 3]
            raise ConstructionError(
                f"{part.name} cannot be picked: none of {team} reaches it where it lies, at "
                f"({x:.2f}, {y:.2f}, {z:.2f}) m"
            )
        if not bounds.placers(part):
            x, y, z = part.goal[:3, 3]
            raise ConstructionError(
                f"{part.name} cannot be placed: none of {team} reaches its place, at "
                f"({x:.2f}, {y:.2f}, {z:.2f}) m"
            )
    stuck = [part for part in problem.parts if bounds.chain(part) is None]
    if stuck:
        part = stuck[0]
        raise ConstructionError(
            f"the team cannot build {listed([p.name for p in stuck])}: "
            f"{listed(bounds.pickers(part))} can pick {part.name}, only "
            f"{listed(bounds.placers(part))} can place it, and no handover between them was "
            "found"
        )

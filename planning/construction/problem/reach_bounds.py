"""Reachability of parts by robots, used to prune the search (Hartmann et al. IV-D).

Only fixtures are obstacles here; other parts and robots are ignored. If no robot can pick or place a part even then,
the part can never be placed. Reachability is tested by sampling: a robot counts as unable to reach a part after many
sampled configurations have failed, with many rotations of its vacuum pad.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from planning.cell.workcell import Attachment, PlacedRobot, WorldState
from planning.construction.problem.problem import ConstructionProblem, Hold, Part
from planning.construction.problem.reach_sampler import ReachSampler
from planning.errors import ConstructionError, format_names
from planning.geometry.robot_bodies import entity_name
from planning.geometry.scene_checker import SceneChecker
from planning.grips.tool_grips import explain_overload
from planning.kinematics.kinematics import frame_pose
from planning.transforms import Array, Transform

_TURNS = 12
"""Random turns of the tool for which a grip is tried."""

_STARTS = 12
"""Configurations requested in each round."""

_HANDOVERS = 150
"""Poses of a part that are tried for a handover."""


class DrawnHandover(NamedTuple):
    """Configurations in which two robots hold a part simultaneously: first the giver's, then the receiver's.

    Attributes:
        q: their configurations, of shape (n,) each.
        tools: poses of their tools in the world.
    """

    q: tuple[Array, Array]
    tools: tuple[Transform, Transform]


class ReachBounds:
    """Reachable parts of every robot, in the supply and in place, with grips.

    A robot reaches no part that is heavier than what it may carry beside its tool.

    Answers do not depend on the order of questions: those of a kind draw numbers of their own.

    Attributes:
        problem: parts and team.
    """

    def __init__(self, problem: ConstructionProblem) -> None:
        self.problem = problem
        self._samplers: dict[str, ReachSampler] = {}
        self._known: dict[tuple[object, ...], bool] = {}
        self._chains: dict[str, tuple[str, ...] | None] = {}
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

    def serves(self, robot: str) -> Iterator[Part]:
        """Yield the parts that a robot reaches in the supply or in place, or passes on."""
        for part in self.problem.parts:
            ends = self.pick_grips(robot, part) or self.place_grips(robot, part)
            if ends or robot in (self.chain(part) or ()):
                yield part

    def pickers(self, part: Part) -> tuple[str, ...]:
        """Return the robots that reach a part in the supply."""
        return tuple(r for r in self.problem.team if self.pick_grips(r, part))

    def placers(self, part: Part) -> tuple[str, ...]:
        """Return the robots that reach the place of a part."""
        return tuple(r for r in self.problem.team if self.place_grips(r, part))

    def able_alone(self, part: Part) -> tuple[str, ...]:
        """Return the robots that can pick and place a part by one grip."""
        return tuple(
            r
            for r in self.problem.team
            if set(self.pick_grips(r, part)) & set(self.place_grips(r, part))
        )

    def may_bring(self, part: Part, robots: tuple[str, ...]) -> bool:
        """Tell whether robots could bring a part to its place; False is a proof that they cannot.

        Args:
            part: what is brought.
            robots: the robots that hold it, in order.
        """
        if len(robots) == 1:
            return robots[0] in self.able_alone(part)
        return (
            bool(self.pick_grips(robots[0], part))
            and bool(self.place_grips(robots[-1], part))
            and all(
                self.can_hand_over(giver, taker, part, first=giver == robots[0])
                for giver, taker in pairwise(robots)
            )
        )

    def can_hand_over(
        self, giver: str, taker: str, part: Part, *, first: bool = True
    ) -> bool:
        """Tell whether there is a pose in which both robots reach a part within their payloads.

        The first giver holds it by a grip by which it could have picked it; all others by any.
        """
        item = self.problem.object(part)
        if explain_overload(self._robot(taker), item) or explain_overload(
            self._robot(giver), item
        ):
            return False
        every = tuple(range(len(part.grips)))
        grips = self.pick_grips(giver, part) if first else every
        kinds = self._kind[giver], self._kind[taker]
        key = ("handover", *kinds, self._likeness[part.name], grips)
        if key not in self._known:
            rng = self._draws(key)
            found = self.draw_handover(giver, taker, part, rng, grips)
            self._known[key] = found is not None
        return self._known[key]

    def draw_handover(
        self,
        giver: str,
        taker: str,
        part: Part,
        rng: np.random.Generator,
        grips: Sequence[int],
    ) -> DrawnHandover | None:
        """Return configurations in which two robots hold a part simultaneously, None if none is found.

        Args:
            giver: the robot that holds it first.
            taker: the robot that receives it.
            part: what is handed over.
            rng: what is drawn from.
            grips: numbers of those by which the giver may hold it.
        """
        pairs = [
            (mine, yours)
            for mine in grips
            for yours in range(len(part.grips))
            if part.grips_apart(mine, yours)
        ]
        if not pairs or giver == taker:
            return None
        for _ in range(_HANDOVERS):
            mine, yours = pairs[int(rng.integers(len(pairs)))]
            turns = rng.uniform(-np.pi, np.pi, 2).tolist()
            holds = Hold(mine, turns[0]), Hold(yours, turns[1])
            found = self.draw_meeting((giver, taker), part, holds, rng)
            if found is not None:
                return found
        return None

    def draw_meeting(
        self,
        robots: tuple[str, str],
        part: Part,
        holds: tuple[Hold, Hold],
        rng: np.random.Generator,
    ) -> DrawnHandover | None:
        """Return configurations in which two robots hold a part with given holds, None if that failed.

        The robot that cannot drive is drawn first, and the other comes to it.

        Args:
            robots: giver and taker.
            part: what both hold, above the ground.
            holds: how each of them does.
            rng: what is drawn from.
        """
        problem, size = self.problem, self.problem.object(part).size
        lead = 0 if not self.sampler(robots[0]).mobile else 1
        # Two that drive meet somewhere on the way.
        ends = (problem.object(part).start[:2, 3], part.goal[:2, 3])
        q_lead = self.sampler(robots[lead]).draw(rng, ends)
        tool = frame_pose(self._robot(robots[lead]), q_lead, problem.frame)
        at = tool @ part.grips[holds[lead].grip].held(holds[lead].turn)
        if at[2, 3] - 0.5 * float(np.abs(at[2, :3]) @ size) < problem.approach:
            return None
        other = problem.tool_pose(part, at, *holds[1 - lead])
        found = self.sampler(robots[1 - lead]).sample(other, rng, 2)
        if not found:
            return None
        if lead == 0:
            return DrawnHandover((q_lead, found[0]), (tool, other))
        return DrawnHandover((found[0], q_lead), (other, tool))

    def chain(self, part: Part) -> tuple[str, ...] | None:
        """Return a shortest chain of robots that could bring a part to its place, or None."""
        if part.name not in self._chains:
            self._chains[part.name] = self._find_chain(part)
        return self._chains[part.name]

    def _find_chain(self, part: Part) -> tuple[str, ...] | None:
        for robot in self.able_alone(part):
            return (robot,)
        ends = self.placers(part)
        chains: list[tuple[str, ...]] = [(robot,) for robot in self.pickers(part)]
        reached: set[str] = set()
        while chains:
            longer = [
                (*chain, robot)
                for chain in chains
                for robot in self.problem.team
                if robot not in chain
                and self.can_hand_over(chain[-1], robot, part, first=len(chain) == 1)
            ]
            for chain in longer:
                if chain[-1] in ends:
                    return chain
            # How the part came to a robot makes no difference from there on.
            new = {chain[-1]: chain for chain in reversed(longer)}
            chains = [chain for robot, chain in new.items() if robot not in reached]
            reached |= new.keys()
        return None

    def _grips(
        self, what: str, robot: str, part: Part, at: Transform
    ) -> tuple[int, ...]:
        if explain_overload(self._robot(robot), self.problem.object(part)) is not None:
            return ()
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
        pad = frozenset((entity_name(robot, "tool"), item.name))
        return SceneChecker(cell, robot, there, frozenset({pad}))

    def _robot(self, name: str) -> PlacedRobot:
        return self.problem.cell.robot(name)

    def _draws(self, key: tuple[object, ...]) -> np.random.Generator:
        """Return the random generator for one query."""
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
    """Check that every part can be brought to its place by one robot or by a chain.

    Raises:
        ConstructionError: names the parts, and the robots that were considered.
    """
    problem = bounds.problem
    team = format_names(problem.team)
    for part in problem.parts:
        loads = [
            f"{robot.name}: {words}"
            for robot in problem.cell.robots
            if (words := explain_overload(robot, problem.object(part))) is not None
        ]
        if len(loads) == len(problem.team):
            raise ConstructionError(
                f"{part.name} is too heavy for everyone: {'; '.join(loads)}",
                parts=[part.name],
            )
        if not bounds.pickers(part):
            x, y, z = problem.object(part).start[:3, 3]
            raise ConstructionError(
                f"{part.name} cannot be picked: none of {team} reaches it where it lies, at "
                f"({x:.2f}, {y:.2f}, {z:.2f}) m",
                parts=[part.name],
            )
        if not bounds.placers(part):
            x, y, z = part.goal[:3, 3]
            raise ConstructionError(
                f"{part.name} cannot be placed: none of {team} reaches its place, at "
                f"({x:.2f}, {y:.2f}, {z:.2f}) m",
                parts=[part.name],
            )
    stuck = [part for part in problem.parts if bounds.chain(part) is None]
    if stuck:
        part = stuck[0]
        raise ConstructionError(
            f"the team cannot build {format_names([p.name for p in stuck])}: "
            f"{format_names(bounds.pickers(part))} can pick {part.name}, only "
            f"{format_names(bounds.placers(part))} can place it, and no handover between them was "
            "found",
            parts=[p.name for p in stuck],
        )

"""Candidates for the assignment of LEGO steps: robots, bricks and grips (APEX-MR App. B)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import permutations, product

from planning.cell.workcell import Workcell
from planning.handling.skill_trial import ResolvedSkill
from planning.kinematics.kinematics import inverse_kinematics
from planning.lego.bricks.assembly import LegoAssembly
from planning.lego.bricks.brick_world import BrickWorld, press_from_number
from planning.lego.skills.brick_skills import BrickSkills
from planning.steps.candidate_collector import CandidateCollector
from planning.steps.skill import Obstruction, joint_distance
from planning.tasks.assignment import (
    AssignmentProblem,
    PrimaryCandidate,
    SupportCandidate,
)

_SPARE = 2
"""Number of grips of a robot that are never pruned: alternatives where no motion is found."""


@dataclass(frozen=True)
class LegoCandidates:
    """The assignment problem of a LEGO assembly, and the joint paths behind its candidates.

    Attributes:
        world: cell and assembly.
        problem: what the solver needs.
        skills: picks, places, supports and handovers.
    """

    world: BrickWorld
    problem: AssignmentProblem
    skills: BrickSkills = field(repr=False)


def find_candidates(
    cell: Workcell, assembly: LegoAssembly, *, alternatives: int | None = None
) -> LegoCandidates:
    """Find every feasible candidate of every step, with its cost.

    A candidate's skills are reachable in one posture each, and free of contacts among the stock,
    the goals of the earlier steps, the other robots at HOME, and the cooperating robot at its
    post. Costs are L1 joint distances: HOME to pick plus HOME to place; for a place-up the
    giver's pick and handover, the receiver's receive and place. (The paper counts the handover
    with the support. It depends on both robots and the grip, so it is counted here; the sum is
    the same.)

    Args:
        cell: its objects are the stock of the assembly.
        assembly: the structure and its steps.
        alternatives: for each robot and step, at most this number of grips, and of supports, become
            candidates; by default all that may be in the cheapest plan, see ``BrickCollector``.
            Grips are tried in the order of their joint distance from HOME, supports in that of
            the step.

    Raises:
        ScenarioError: a step cannot be understood.
    """
    found = LazyBrickCandidates(cell, assembly, alternatives=alternatives)
    return found.first(len(assembly.steps))


class LazyBrickCandidates:
    """Candidates of the steps of a LEGO assembly, found on request, in order; see ``find_candidates``."""

    def __init__(
        self, cell: Workcell, assembly: LegoAssembly, *, alternatives: int | None = None
    ) -> None:
        self._skills = BrickSkills(BrickWorld(cell, assembly))
        self._alternatives = alternatives
        self._known = BrickCollector(self._skills, alternatives).candidates(0)

    def first(self, count: int) -> LegoCandidates:
        """Return the candidates of a number of first steps."""
        known, collector = (
            self._known.problem,
            BrickCollector(self._skills, self._alternatives),
        )
        for number in range(1, count + 1):
            if number <= len(known.steps):
                collector.keep(known, number)
            else:
                collector.add(number)
        found = collector.candidates(count)
        if count > len(known.steps):
            self._known = found
        return found


class BrickCollector(CandidateCollector):
    """Gathers the candidates of a LEGO assembly.

    All supports become candidates. A candidate is pruned where that provably leaves the optimum of (1)
    unchanged: let w be a candidate of the same step, robot, brick and giver,
    which waits for no brick to be gone, is compatible with every support of another robot, and costs no
    more. In any plan w can replace the pruned candidate: (2) to (8) ask for step, robot and brick
    only; nothing has to be used before w; no support is excluded by it; and the sum of costs does
    not grow. That a grip costs more than w is known before its collision checks, which take most of the
    time: a lower bound is the joint distance in the best of all postures, ignoring obstacles. For most
    grips the nearest posture at the place alone suffices.
    """

    def __init__(self, skills: BrickSkills, alternatives: int | None) -> None:
        super().__init__(skills.world.cell.robots)
        self._most = alternatives
        self.world, self.skills = skills.world, skills

    def candidates(self, count: int) -> LegoCandidates:
        """Return the candidates gathered for a number of first steps."""
        steps = self.world.assembly.steps[:count]
        problem = self.problem(
            [step.words for step in steps],
            [step.up or step.support is not None for step in steps],
            unlimited=self.world.stations,
        )
        return LegoCandidates(self.world, problem, self.skills)

    def keep(self, problem: AssignmentProblem, step: int) -> None:
        """Add the candidates that a step has in another problem."""
        primary, support = {}, {}
        for p in problem.primaries_of.get(step, []):
            primary[p] = len(self.primaries)
            self.primaries.append(problem.primaries[p])
        for s in problem.supports_of.get(step, []):
            support[s] = len(self.supports)
            self.supports.append(problem.supports[s])
        self.incompatible.update(
            (primary[p], support[s]) for p, s in problem.incompatible if p in primary
        )
        self.rejections += [item for item in problem.rejections if item.step == step]

    def add(self, step: int) -> None:
        """Add the candidates of a step: primary robot, giver for a place-up, brick and grip."""
        supports = self._add_supports(step)
        transfers: Iterable[tuple[str, str | None]] = (
            permutations(self.home, 2)
            if self.world.step(step).up
            else product(self.home, [None])
        )
        for robot, giver in transfers:
            count, picker = 0, giver or robot
            proven: dict[
                str, float
            ] = {}  # cost of what can stand in for any dearer grip
            for grasp in self._ordered_grasps(robot, step):
                if count == self._most:
                    break
                stocks = self.world.usable_stock(step)
                if count >= _SPARE:
                    for bound in (self.skills.near_place, self.skills.least_place):
                        least = bound(robot, step, grasp) if stocks else math.inf
                        stocks = self._competitive_bricks(
                            picker, grasp, stocks, least, proven
                        )
                    if not stocks:
                        continue
                place = self._place(robot, step, grasp, supports)
                if place is None:
                    continue
                cost = self.cost(place.path)
                if giver is not None:
                    what = f"{giver} hands it to {robot}, {_grip(grasp)}"
                    found = self.skills.handover(giver, robot, step, grasp)
                    handover = self.accept(step, what, found, giver)
                    if handover is None:
                        continue
                    cost += self.cost(handover.give)
                    cost += joint_distance(self.home[robot], handover.receive)
                first = len(self.primaries)
                if count >= _SPARE:
                    stocks = self._competitive_bricks(
                        picker, grasp, stocks, cost, proven
                    )
                for stock in stocks:
                    pick = self._pick(step, picker, stock, grasp)
                    if pick is not None:
                        whole = cost + self.cost(pick.path)
                        after = self.skills.after(place) | self.skills.after(pick)
                        after -= {stock}
                        self.primaries.append(
                            PrimaryCandidate(
                                step, robot, stock, grasp, whole, giver, after
                            )
                        )
                count += len(self.primaries) > first
                clashes = self._add_clashes(step, robot, grasp, supports, first)
                for item in () if clashes else self.primaries[first:]:
                    if not item.after:
                        known = proven.get(item.object, math.inf)
                        proven[item.object] = min(item.cost, known)

    def _competitive_bricks(
        self,
        picker: str,
        grasp: int,
        stocks: Iterable[str],
        cost: float,
        proven: Mapping[str, float],
    ) -> list[str]:
        """Return the bricks that a grip reaches at possibly less cost than the known alternatives.

        Args:
            picker: the picking robot.
            grasp: number of the grip.
            stocks: the bricks.
            cost: the least that all but the pick costs.
            proven: by brick, the cost of what can stand in.
        """
        return [
            stock
            for stock in stocks
            if cost + self.skills.least_pick(picker, stock, grasp)
            < proven.get(stock, math.inf)
        ]

    def _ordered_grasps(self, robot: str, step: int) -> list[int]:
        """Return the grips of a step, those with places near HOME first."""
        grasps = self.world.grasps(step)
        if len(grasps) <= 1:
            return grasps
        placed = self.world.cell.robot(robot)

        def away(grasp: int) -> float:
            goal = self.skills.placing(robot, step, grasp)
            near = inverse_kinematics(
                placed, goal.frame, goal.pose, placed.home, restarts=0
            )
            return joint_distance(placed.home, near[0]) if near else math.inf

        return sorted(grasps, key=away)

    def _add_supports(self, step: int) -> dict[int, SupportCandidate]:
        """Add the support candidates of a step; return the standing configurations by candidate index."""
        out: dict[int, SupportCandidate] = {}
        for robot in self.home:
            count = 0
            for choice in range(len(self.world.step(step).supports)):
                if count == self._most:
                    break
                option = self.skills.support(robot, step, choice)
                if isinstance(option, ResolvedSkill) and self.skills.after(option):
                    names = ", ".join(sorted(self.skills.after(option)))
                    option = Obstruction(f"blocked by {names}")
                support = self.accept(step, f"{robot} supports", option, robot)
                if support is None:
                    continue
                count += 1
                cost = self.cost(support.path)
                out[len(self.supports)] = SupportCandidate(step, robot, choice, cost)
                self.supports.append(out[len(self.supports)])
        return out

    def _place(
        self, robot: str, step: int, grasp: int, supports: dict[int, SupportCandidate]
    ) -> ResolvedSkill | None:
        """Return the cheapest place, alone or next to any of the supports."""
        choices: list[SupportCandidate | None] = [None]
        if self.world.step(step).up or self.world.step(step).supports:
            choices = [
                item
                for item in supports.values()
                if item.robot != robot
                and self.world.are_compatible(step, grasp, item.pose)
            ]
        found = [self.skills.place(robot, step, grasp, support) for support in choices]
        places = [option for option in found if isinstance(option, ResolvedSkill)]
        if places:
            return min(places, key=lambda option: self.cost(option.path))
        reasons = [option for option in found if isinstance(option, Obstruction)]
        alone = Obstruction("no other robot can support it")
        what = f"{robot} places, {_grip(grasp)}"
        self.reject(step, what, [*reasons, alone][0], robot)
        return None

    def _pick(
        self, step: int, robot: str, stock: str, grasp: int
    ) -> ResolvedSkill | None:
        """Return the pick of a stock brick by a robot in time for a step."""
        found = self.skills.pick(robot, stock, grasp)
        if isinstance(found, ResolvedSkill):
            latest = self.skills.latest(found)
            if latest is not None and step > latest:
                found = Obstruction(f"the brick of step {latest} is in the way")
        what = f"{robot} picks {stock}, {_grip(grasp)}"
        return self.accept(step, what, found, robot)

    def _add_clashes(
        self,
        step: int,
        robot: str,
        grasp: int,
        supports: dict[int, SupportCandidate],
        first: int,
    ) -> bool:
        """Record which supports exclude the newest primary candidates; return whether there are any."""
        newest, clashes = range(first, len(self.primaries)), False
        for index, item in supports.items():
            if item.robot == robot or not newest:
                continue
            if self.world.are_compatible(step, grasp, item.pose):
                option = self.skills.place(robot, step, grasp, item)
                words = f"{robot} places beside {item.robot}, {_grip(grasp)}"
                if self.accept(step, words, option, robot) is not None:
                    continue
            self.incompatible.update((p, index) for p in newest)
            clashes = True
        return clashes


def _grip(grasp: int) -> str:
    press = press_from_number(grasp)
    return f"grip {press.side}/{press.offset}"

"""Parts that are alike: which of them comes to which goal, as the integer program chooses (APEX-MR App. B).

A goal is a step of the program, and its objects are the parts of the group. Which part comes to which
goal matters by the way between the two, by who reaches either, and by what must be gone or there before;
cost is therefore the way of the arm from HOME to the part, on to the goal, and back. Goals of a group
have no order but for what touches or bars what: robots take turns, each at the goals that are best left
to it. What comes of it is an assembly in which each part has its goal, planned as any other.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import groupby, product
from math import inf, isinf

import numpy as np
from scipy.optimize import linear_sum_assignment

from planning.cell.workcell import PlacedRobot, Workcell
from planning.errors import InfeasibleStepError
from planning.parts.assembly import AnyStep, PartAssembly, PlacePart, Work
from planning.parts.candidates import PartCandidates
from planning.parts.goal_ends import AlikeEnd, GoalEnds, from_nowhere
from planning.steps.handovers import CandidateCollector
from planning.steps.skill import joint_distance
from planning.steps.tool_changes import (
    find_tool_changes,
    mounted_tool,
    with_each_tool,
)
from planning.tasks.assignment import AssignmentProblem, PrimaryCandidate
from planning.tasks.highs_solver import assign_steps

_MOST_TRIES = 8
"""So often parts are shared out anew where nobody can do a step of what came of it."""

_NOBODY = 1e6
"""What a goal costs a robot that cannot fill it: more than any way [rad]."""

Order = Callable[[Workcell, PartAssembly], PartAssembly]
"""Returns an assembly with its steps in an order in which they can be."""

Find = Callable[[Workcell, PartAssembly], PartCandidates]
"""Returns the candidates of an assembly in which every part has its own goal."""


def as_listed(_: Workcell, assembly: PartAssembly) -> PartAssembly:
    """Return an assembly with its steps as they are."""
    return assembly


def find_alike_candidates(
    cell: Workcell, assembly: PartAssembly, find: Find, order: Order = as_listed
) -> PartCandidates:
    """Return the candidates of an assembly once parts that are alike are shared out over their goals.

    Where nobody can do a step then, that part and that goal are kept apart, and parts are shared out
    anew. Where robots cannot take turns, goals are filled in their order.

    Args:
        cell: its objects are the parts.
        assembly: its groups of parts that are alike have goals for the first of them.
        find: of an assembly that is shared out.
        order: of steps in any order.

    Raises:
        InfeasibleStepError: there is no sharing out; says which goal nobody can fill, and why.
    """
    if not assembly.alike:
        return find(cell, assembly)
    assembly = order(from_nowhere(cell, assembly), assembly)
    for listed in (in_turns(cell, assembly), assembly):
        refused: set[tuple[str, str]] = set()
        try:
            sharing = Sharing(cell, order(from_nowhere(cell, listed), listed))
            for tried in range(1, _MOST_TRIES + 1):
                parts = sharing.parts(refused)
                found = find(cell, renamed(sharing.assembly, parts))
                goals = {part: goal for goal, part in parts.items()}
                steps = (found.assembly.steps[k - 1] for k in found.problem.impossible)
                stuck = {s.part for s in steps if isinstance(s, PlacePart)} & set(goals)
                if not stuck or tried == _MOST_TRIES:
                    return found
                refused |= {(goals[part], part) for part in stuck}
        except InfeasibleStepError:
            if listed is assembly:
                raise
    raise AssertionError("the last try returns")


class Sharing:
    """The choice of a part for every goal.

    Args:
        cell: its objects are the parts.
        assembly: with groups of parts that are alike, its steps in an order.

    Attributes:
        assembly: see there; goals have the names of the parts that are written out with them.

    Raises:
        InfeasibleStepError: a part would hang in the air, or goes where something is.
    """

    def __init__(self, cell: Workcell, assembly: PartAssembly) -> None:
        self.assembly = assembly
        self._cell = cell
        self._robots = tuple(with_each_tool(cell.robots))
        self._changes = find_tool_changes(cell, assembly.goals)
        self._ends = GoalEnds(cell, assembly)

    def parts(self, refused: Collection[tuple[str, str]] = ()) -> dict[str, str]:
        """Return which part comes to which goal in the cheapest plan, by the name of the goal.

        Args:
            refused: goals, each with a part that is not to come there.

        Raises:
            InfeasibleStepError: a goal cannot be filled, or not along with the others.
        """
        plan = assign_steps(self.problem(refused))
        pairs = zip(self._ends.steps, plan.choices, strict=True)
        return {step.part.name: choice.object for step, choice in pairs}

    def problem(self, refused: Collection[tuple[str, str]] = ()) -> AssignmentProblem:
        """Return the assignment problem whose steps are goals and whose objects are parts.

        Of the grips by which a robot takes a part to a goal the cheapest is a candidate, one for every
        set of parts that must be gone before.
        """
        found = CandidateCollector(self._cell.robots)
        for number, step in enumerate(self._ends.steps, start=1):
            goal, first = step.part.name, len(found.primaries)
            parts = [n for n in self._ends.group[goal] if (goal, n) not in refused]
            for robot in self._robots:
                if step.step.done_by(robot.name):
                    found.primaries += self._ways(number, robot, parts)
            if len(found.primaries) == first:
                self._explain(number, parts, found)
                found.primaries += self._relayed(number, parts)
        return found.problem(
            [f"fill {self._words(step.part.name)}" for step in self._ends.steps],
            [False] * len(self._ends.steps),
            mounted=self._changes.mounted,
            changes=self._changes.costs,
        )

    def _words(self, goal: str) -> str:
        number = self._ends.group[goal].index(goal) + 1
        return f"goal {number} of {goal.rpartition('.')[0]}"

    def _ways(
        self, number: int, robot: PlacedRobot, parts: Sequence[str]
    ) -> Iterator[PrimaryCandidate]:
        """Yield how a robot takes parts to a goal."""
        places = self._ends.placed(number, robot).by_grip
        for part in parts if places else ():
            picks = self._ends.picked(part, robot).by_grip
            gone = self._ends.in_the_way(number, part)
            least: dict[frozenset[str], float] = {}
            for grip in sorted(picks.keys() & places.keys()):
                pick, place = picks[grip], places[grip]
                if number <= pick.latest:
                    after = (gone | pick.after | place.after) - {part}
                    cost = _way(robot, pick, place)
                    least[after] = min(cost, least.get(after, inf))
            for after, cost in least.items():
                if not any(k < after and least[k] <= cost for k in least):
                    about = number, robot.name, part, 0, cost, None, after
                    yield PrimaryCandidate(*about, tools=mounted_tool(robot))

    def _relayed(self, number: int, parts: Sequence[str]) -> Iterator[PrimaryCandidate]:
        """Yield ways in which a part changes hands in between, which are twice as long."""
        step = self._ends.steps[number - 1].step
        able = [robot for robot in self._robots if step.done_by(robot.name)]
        for giver, robot in product(able, repeat=2):
            put = self._ends.placed(number, robot).least(robot)
            for part in parts if not isinf(put) else ():
                cost = 2.0 * (put + self._ends.picked(part, giver).least(giver))
                tools = mounted_tool(giver) | mounted_tool(robot)
                if isinf(cost) or len(dict(tools)) < len(tools):
                    continue
                other = None if giver.name == robot.name else giver.name
                gone = self._ends.in_the_way(number, part)
                about = number, robot.name, part, 0, cost, other, gone
                yield PrimaryCandidate(*about, tools=tools)

    def _explain(
        self, number: int, parts: Sequence[str], found: CandidateCollector
    ) -> None:
        """Note why nobody alone can fill a goal."""
        step = self._ends.steps[number - 1].step
        for robot in self._robots:
            if not step.done_by(robot.name):
                only = ", ".join(step.robots or ())
                found.reject(number, f"{robot.name} does it", f"it is for {only} only")
                continue
            ends = [self._ends.placed(number, robot)]
            if ends[0].by_grip:
                ends += [self._ends.picked(part, robot) for part in parts]
            for end in ends:
                for what, why in end.reasons:
                    found.reject(number, what, why)


def _way(robot: PlacedRobot, pick: AlikeEnd, place: AlikeEnd) -> float:
    """Return the joint distance from HOME to a part, on to its goal, and back [rad]."""
    stops = robot.home, pick.path.contact, place.path.contact, robot.home
    return sum(joint_distance(a, b) for a, b in zip(stops, stops[1:], strict=False))


def renamed(assembly: PartAssembly, parts: Mapping[str, str]) -> PartAssembly:
    """Return an assembly in which some parts are others.

    Args:
        assembly: the assembly.
        parts: who is in the place of whom, by name.
    """

    def new(name: str) -> str:
        return parts.get(name, name)

    def both(pair: frozenset[str]) -> frozenset[str]:
        return frozenset(map(new, pair))

    def step_of(step: AnyStep) -> AnyStep:
        if step.hold is not None:
            step = replace(step, hold=new(step.hold))
        if isinstance(step, Work):
            owner = step.spot.owner and new(step.spot.owner)
            return replace(step, spot=replace(step.spot, owner=owner))
        return replace(step, part=new(step.part))

    balance, overlaps = assembly.balance, assembly.overlaps
    if balance is not None:
        joints = (
            replace(joint, first=new(joint.first), second=new(joint.second))
            for joint in balance.joints
        )
        balance = replace(balance, joints=tuple(joints))
    return replace(
        assembly,
        goals={new(name): pose for name, pose in assembly.goals.items()},
        steps=tuple(map(step_of, assembly.steps)),
        balance=balance,
        overlaps=replace(
            overlaps,
            said={both(pair): deep for pair, deep in overlaps.said.items()},
            joined=frozenset(map(both, overlaps.joined)),
        ),
    )


def in_turns(cell: Workcell, assembly: PartAssembly) -> PartAssembly:
    """Return an assembly in which robots take turns at the goals of parts that are alike.

    Goals that are filled one after another are shared out over the robots so that the sum of ways and
    of loads is least; each robot fills its own as they are listed, so that robots that face each other
    keep their distance. What touches or bars what stays in the order of the list.

    Raises:
        InfeasibleStepError: a part would hang in the air, or goes where something is.
    """
    ends, robots = GoalEnds(cell, assembly), list(with_each_tool(cell.robots))
    outfits = [[own for own in robots if own.name == r.name] for r in cell.robots]
    numbers = {step.part.name: k for k, step in enumerate(ends.steps, start=1)}

    def group_of(step: AnyStep) -> tuple[str, ...]:
        return ends.group.get(step.part, ()) if isinstance(step, PlacePart) else ()

    steps: list[AnyStep] = []
    for group, run in groupby(assembly.steps, key=group_of):
        own = list(run)
        if not group:
            steps += own
            continue
        at = [numbers[step.part] for step in own if isinstance(step, PlacePart)]
        ways = [[min(ends.cheapest(k, r) for r in own) for own in outfits] for k in at]
        turn = _turns(np.array(ways))
        waiting = sorted(range(len(own)), key=lambda k: turn[k])
        while waiting:
            ready = next(
                k
                for k in waiting
                if not any(j < k and ends.interacting(at[j], at[k]) for j in waiting)
            )
            waiting.remove(ready)
            steps.append(own[ready])
    return replace(assembly, steps=tuple(steps))


def _turns(ways: np.ndarray) -> list[tuple[int, int]]:
    """Return for each goal when its robot fills it, by its own count, and the number of that robot.

    Args:
        ways: of each robot to each goal, infinite where it cannot fill it; shape (goals, robots).
    """
    goals, robots = ways.shape
    known = np.isfinite(ways)
    load = float(ways[known].mean()) if known.any() else 1.0
    cost = np.where(known, ways, _NOBODY)[:, :, None] + load * np.arange(goals)
    _, taken = linear_sum_assignment(cost.reshape(goals, robots * goals))
    counted = [0] * robots
    turns = []
    for robot in (taken // goals).tolist():
        turns.append((counted[robot], robot))
        counted[robot] += 1
    return turns

"""Assignment of interchangeable parts to goals by the integer program (APEX-MR App. B).

The program has one step per goal; the interchangeable parts are the objects of that step. The cost of a pair of part
and goal is the length of the path of the arm from HOME to the part, to the goal, and back to HOME. Pairs also differ
in the robots that reach them, and in the parts that must be removed first. A pick depends only on the part, and a
placement only on the goal, so each is computed once per part or goal and not once per pair. The order of the goals is
restricted only by contacts and blocked paths. Robots take turns, such that the sum of path lengths and workloads is
least. In the resulting assembly each part has one goal, and planning continues as usual.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import chain, combinations, groupby
from math import inf

import numpy as np
from scipy.optimize import linear_sum_assignment

from planning.cell.workcell import PlacedRobot, Workcell
from planning.contacts.interference import ROUNDING, sweeps_through
from planning.contacts.touching import PlacedObject, nearby_entities, standing_fixtures
from planning.errors import InfeasibleStepError
from planning.grips.fingers import firm_grips
from planning.grips.tool_grips import explain_overload, robot_grips
from planning.handling.tool_changes import (
    find_tool_changes,
    mounted_tool,
    with_each_tool,
    with_tools_in_racks,
)
from planning.parts.assembly import AnyStep, PartAssembly, PlacePart
from planning.parts.candidates import PartCandidates
from planning.parts.part_skills import SkillTry, ToolSkills
from planning.parts.part_steps import PartStep, part_steps
from planning.steps.candidate_collector import CandidateCollector
from planning.steps.skill import Obstruction, joint_distance
from planning.tasks.assignment import AssignmentProblem, PrimaryCandidate
from planning.tasks.highs_solver import assign_steps
from planning.transforms import Array, read_only_copy, translation

_MOST_TRIES = 4
"""Number of retries of the allocation where no robot can do a step of the result."""

_NOBODY, _NEVER = 100.0, 1e6
"""Cost of a goal for a robot that cannot fill it alone: more than any path or load [rad]."""

_AWAY = 1000.0
"""Distances in height of parts that come from nowhere in particular [m]."""

Order = Callable[[Workcell, PartAssembly], PartAssembly]
"""Returns an assembly with its steps in an order in which they can be."""

Find = Callable[[Workcell, PartAssembly], PartCandidates]
"""Returns the candidates of an assembly in which every part has its own goal."""

_Ends = Mapping[bytes, tuple[Array, frozenset[str]]]
"""Contact configuration of a pick or place, shape (n,), and the parts that must be gone before, by tool pose on the part."""


def _with_steps_as_listed(_: Workcell, assembly: PartAssembly) -> PartAssembly:
    """Return an assembly with its steps as they are."""
    return assembly


def find_alike_candidates(
    cell: Workcell,
    assembly: PartAssembly,
    find: Find,
    order: Order = _with_steps_as_listed,
) -> PartCandidates:
    """Return the candidates of an assembly after interchangeable parts are assigned to goals.

    Robots take turns at these where that does; else goals are filled as they are listed. What is
    impossible all the same is said by the assignment.

    Args:
        cell: its objects are the parts.
        assembly: its groups of parts that are alike have goals for the first of them.
        find: of an assembly that is shared out.
        order: of steps in any order.

    Raises:
        InfeasibleStepError: there is no sharing out; says which goals compete for what.
    """
    if not assembly.alike:
        return find(cell, assembly)
    nowhere = without_start_places(cell, assembly)
    listed = PartAllocation(cell, order(nowhere, assembly))
    try:
        found = PartAllocation(cell, order(nowhere, listed.in_turns())).planned(find)
    except InfeasibleStepError:
        return listed.planned(find)
    return listed.planned(find) if found.problem.impossible else found


def without_start_places(cell: Workcell, assembly: PartAssembly) -> Workcell:
    """Return a cell in which interchangeable parts with goals are far away, and others left out."""
    # Each far from the others, as what lies on what at the start says nothing of goals.
    away = {
        name: translation(0.0, 0.0, _AWAY * (1 + k))
        for k, name in enumerate(chain(*assembly.alike))
    }
    objects = (
        replace(item, start=read_only_copy(away[item.name] @ item.start))
        if item.name in away
        else item
        for item in cell.objects
        if item.name not in away or item.name in assembly.goals
    )
    return replace(cell, objects=tuple(objects))


class PartAllocation:
    """Assignment of a part to every goal, with goals filled in a fixed order.

    A goal has the name of the part that is written out with it. In scenes that part comes from
    nowhere in particular, and what lies at the start has another name.

    Args:
        cell: its objects are the parts.
        assembly: with groups of parts that are alike, its steps in order.

    Raises:
        InfeasibleStepError: a part would hang in the air, or goes where something is.
    """

    def __init__(self, cell: Workcell, assembly: PartAssembly) -> None:
        self._cell, self._assembly, around = cell, assembly, with_tools_in_racks(cell)
        self._robots = tuple(with_each_tool(cell.robots))
        self._changes = find_tool_changes(cell, assembly.goals)
        self._skills = ToolSkills(cell, assembly)
        self._ends = cache(self._find_ends)
        self._group = {name: group for group in assembly.alike for name in group}
        items = [item for item in around.objects if item.name in self._group]
        self._lying: dict[str, PlacedObject] = {i.name: (i, i.start) for i in items}
        self._in_goal = {
            i.name: frozenset(nearby_entities((i, goal), self._lying, -ROUNDING))
            for i in items
            if (goal := assembly.goals.get(i.name)) is not None
        }
        gone = frozenset[str]().union(*self._in_goal.values())
        start_of = {
            i.name: f"{i.name} where it starts" for i in items if i.name not in gone
        }
        there = [replace(i, name=start_of[i.name]) for i in items if i.name in start_of]
        self._starts = {start: name for name, start in start_of.items()}
        nowhere = without_start_places(around, assembly)
        scene = replace(nowhere, objects=(*nowhere.objects, *there))
        self._steps = tuple(
            step
            for step in part_steps(scene, assembly)
            if isinstance(step, PartStep) and step.part.name in self._group
        )

    def planned(self, find: Find) -> PartCandidates:
        """Return the candidates of the assembly for an assignment of parts, after some tries.

        Where no robot can do a step, its part and that goal are kept apart the next time.

        Args:
            find: of an assembly that is shared out.

        Raises:
            InfeasibleStepError: goals compete for parts.
        """
        refused: set[tuple[str, str]] = set()
        for _ in range(_MOST_TRIES):
            try:
                parts = self.parts(refused)
            except InfeasibleStepError:
                if not refused:
                    raise
                break  # why no robot can do a step is known of what was tried last
            found = find(self._cell, with_renamed_parts(self._assembly, parts))
            goals = {part: goal for goal, part in parts.items()}
            steps = (found.assembly.steps[k - 1] for k in found.problem.impossible)
            stuck = {s.part for s in steps if isinstance(s, PlacePart)} & goals.keys()
            if not stuck:
                break
            refused |= {(goals[part], part) for part in stuck}
        return found

    def parts(self, refused: Collection[tuple[str, str]] = ()) -> dict[str, str]:
        """Return the part of each goal in the cheapest plan, by the name of the goal.

        Args:
            refused: goals, each with a part that is not to come there.
        """
        try:
            plan = assign_steps(self.problem(refused))
        except InfeasibleStepError:  # then some change hands in between
            plan = assign_steps(self.problem(refused, relayed=True))
        pairs = zip(self._steps, plan.choices, strict=True)
        return {step.part.name: choice.object for step, choice in pairs}

    def problem(
        self, refused: Collection[tuple[str, str]] = (), *, relayed: bool = False
    ) -> AssignmentProblem:
        """Return the assignment problem whose steps are goals and whose objects are parts.

        Of the grips by which a robot takes a part to a goal the cheapest is a candidate, one for every
        set of parts that must be gone before.

        Args:
            refused: goals, each with a part that is not to come there.
            relayed: whether whatever somebody picks may come to any goal; in any case it may come to
                those to which nobody alone takes a part.
        """
        found = CandidateCollector(self._cell.robots)
        for number, step in enumerate(self._steps, start=1):
            goal, transports = step.part.name, list[PrimaryCandidate]()
            parts = [n for n in self._group[goal] if (goal, n) not in refused]
            able = [r for r in self._robots if step.step.done_by(r.name)]
            for robot in able:
                places = self._ends(robot, number, None)
                transports += self._transports(number, robot, parts, places)
            if relayed or not transports:
                for robot in able:
                    transports += self._transports(number, robot, parts, None)
            found.primaries += transports
        return found.problem(
            [f"fill the goal of {step.part.name}" for step in self._steps],
            [False] * len(self._steps),
            mounted=self._changes.mounted,
            changes=self._changes.costs,
        )

    def _transports(
        self,
        number: int,
        robot: PlacedRobot,
        parts: Sequence[str],
        places: _Ends | None,
    ) -> Iterator[PrimaryCandidate]:
        """Yield transports of parts to a goal by a robot, given its placement; picks alone for None."""
        goal, home = self._steps[number - 1].part.name, robot.home
        for part in parts:
            least: dict[frozenset[str], float] = {}
            for grip, (at, gone) in self._ends(robot, self._first(goal), part).items():
                to, barred = (places or {}).get(grip, (at, gone))
                if places is not None and grip not in places:
                    continue
                after = gone | barred | self._in_goal[goal]
                stops = home, at, to, home
                cost = sum(map(joint_distance, stops, stops[1:]))
                cost += _NOBODY if places is None else 0.0
                least[after - {part}] = min(cost, least.get(after - {part}, inf))
            for after, cost in least.items():
                if not any(k < after and least[k] <= cost for k in least):
                    about = number, robot.name, part, 0, cost, None, after
                    yield PrimaryCandidate(*about, tools=mounted_tool(robot))

    def _first(self, goal: str) -> int:
        """Return the number of the first step that fills a goal of a group, from 1."""
        group = self._group[goal]
        return 1 + next(k for k, s in enumerate(self._steps) if s.part.name in group)

    def _find_ends(self, robot: PlacedRobot, number: int, part: str | None) -> _Ends:
        """Return a robot's placement of a part at the goal of a step, or its pick of a given part for it."""
        step, found = (
            self._steps[number - 1],
            dict[bytes, tuple[Array, frozenset[str]]](),
        )
        if part is not None:
            step = self._picking(step, part)
        if explain_overload(robot, step.part) is not None:
            return found
        own, at = self._assembly, step.place if part is None else step.part.start
        barring = set() if part is None else self._barring(step)
        if not barring <= self._starts.keys():
            return found
        skills = self._skills(mounted_tool(robot))
        rules = own.handling(step.part.name).grips
        grips = dict(enumerate(robot_grips(robot, step.part.shape, at, at, rules)))
        about = grips, own.frame, (at,), own.friction
        for grip in firm_grips(robot, step.part, *about).values():
            if skills.misfit(robot, step.part, grip) is None:
                skill = skills.place if part is None else skills.pick
                end = self._free(
                    skill(robot, step, grip.pose), carried=part is not None
                )
                if end is not None:
                    gone = end[1] | {self._starts[name] for name in barring}
                    found[grip.pose.tobytes()] = end[0], gone
        return found

    def _barring(self, step: PartStep) -> set[str]:
        """Return the neighbours at the start that block the straight path of a part out of there."""
        own, placed = step.part.name, standing_fixtures(self._cell) | step.others
        handling, most = self._assembly.handling(own), self._assembly.overlaps.most
        out = -np.array(handling.extraction), handling.leave
        there = step.part, step.part.start
        return {
            name
            for name in step.at_start
            if sweeps_through(there, placed[name], *out, most(own, name))
        }

    def _picking(self, step: PartStep, part: str) -> PartStep:
        """Return a step with its part at the start pose of another one."""
        item, start = step.part, self._lying[part][1]
        around = {k: v for k, v in step.around.items() if self._starts.get(k) != part}
        step = replace(step, around=around, part=replace(item, start=start))
        placed = standing_fixtures(self._cell) | step.others
        touched = nearby_entities((item, start), placed, self._assembly.touch)
        return replace(step, at_start=touched)

    def _free(
        self, tried: SkillTry, *, carried: bool
    ) -> tuple[Array, frozenset[str]] | None:
        """Return the contact configuration of a skill, and the parts that must have left their starts before."""
        gone: set[str] = set()
        while True:
            found = tried.found()
            path = None if isinstance(found, Obstruction) else found
            wrong = found if path is None else tried.carried_home() if carried else None
            if path is not None and wrong is None:
                return path.contact, frozenset(self._starts[name] for name in gone)
            name = wrong.by if isinstance(wrong, Obstruction) else None
            if name not in self._starts or name in gone:
                return None
            gone.add(name)
            there = {k: at for k, at in tried.scene.objects.items() if k != name}
            tried = replace(tried, scene=replace(tried.scene, objects=there))

    def in_turns(self) -> PartAssembly:
        """Return the assembly with steps ordered so that robots take turns at goals.

        Goals that are filled one after another are shared out over the robots so that the sum of ways
        and of loads is least; each robot fills its own as they are listed, so that robots that face
        each other keep their distance. What touches or bars what stays in the order of the list.
        """
        numbers = {step.part.name: k for k, step in enumerate(self._steps, start=1)}

        def group_of(step: AnyStep) -> tuple[str, ...]:
            return self._group.get(step.part, ()) if isinstance(step, PlacePart) else ()

        steps: list[AnyStep] = []
        for group, run in groupby(self._assembly.steps, key=group_of):
            own = list(run)
            if not group:
                steps += own
                continue
            at = [numbers[step.part] for step in own if isinstance(step, PlacePart)]
            turn = goal_turns(np.array([self._nearness(k) for k in at]))
            waiting = sorted(range(len(own)), key=lambda k: turn[k])
            bars = {
                (j, k)
                for j, k in combinations(range(len(own)), 2)
                if self._interact(at[j], at[k])
            }
            while waiting:
                ready = next(
                    k for k in waiting if not any((j, k) in bars for j in waiting)
                )
                waiting.remove(ready)
                steps.append(own[ready])
        return replace(self._assembly, steps=tuple(steps))

    def _nearness(self, number: int) -> list[float]:
        """Return the distance of a goal from the HOME of each robot; infinite where it cannot fill it [rad]."""
        done_by = self._steps[number - 1].step.done_by
        least = dict.fromkeys((robot.name for robot in self._cell.robots), inf)
        for robot in self._robots:
            for at, _ in (
                self._ends(robot, number, None).values() if done_by(robot.name) else ()
            ):
                least[robot.name] = min(
                    least[robot.name], joint_distance(robot.home, at)
                )
        return list(least.values())

    def _interact(self, first: int, second: int) -> bool:
        """Tell whether two filled goals touch, or one blocks the straight path into the other."""
        a, b = (
            (s.part, s.place) for s in (self._steps[first - 1], self._steps[second - 1])
        )
        handling = self._assembly.handling(a[0].name)
        if not (near := nearby_entities(a, {"": b}, handling.approach)):
            return False
        led = np.array(handling.insertion), handling.approach
        touch = min(near.values()) <= self._assembly.touch
        return touch or sweeps_through(a, b, *led) or sweeps_through(b, a, *led)


def with_renamed_parts(
    assembly: PartAssembly, parts: Mapping[str, str]
) -> PartAssembly:
    """Return an assembly in which some placed parts are replaced by others.

    Args:
        assembly: no step but that of a placement names one of them.
        parts: the replacement of each part, by name.
    """

    def both(pair: Collection[str]) -> tuple[str, ...]:
        return tuple(parts.get(name, name) for name in pair)

    balance, overlaps = assembly.balance, assembly.overlaps
    if balance is not None:
        ends = [(joint, both(joint.ends)) for joint in balance.joints]
        joints = tuple(replace(joint, first=a, second=b) for joint, (a, b) in ends)
        balance = replace(balance, joints=joints)
    said = {frozenset(both(pair)): deep for pair, deep in overlaps.said.items()}
    joined = frozenset(frozenset(both(pair)) for pair in overlaps.joined)
    return replace(
        assembly,
        goals={parts.get(k, k): pose for k, pose in assembly.goals.items()},
        steps=tuple(
            replace(step, part=parts.get(step.part, step.part))
            if isinstance(step, PlacePart)
            else step
            for step in assembly.steps
        ),
        balance=balance,
        overlaps=replace(overlaps, said=said, joined=joined),
    )


def goal_turns(costs: Array) -> list[tuple[int, int]]:
    """Return for each goal its position among those of its robot, and the number of that robot.

    The sum of ways and loads is least: the next goal of a robot costs as much more as a goal costs in the
    mean.

    Args:
        costs: distance of each robot to each goal, infinite where it cannot fill it; shape (goals, robots).
    """
    goals, robots = costs.shape
    known = np.isfinite(costs)
    load = float(costs[known].mean()) if known.any() else 1.0
    cost = np.where(known, costs, _NEVER)[:, :, None] + load * np.arange(goals)
    _, taken = linear_sum_assignment(cost.reshape(goals, robots * goals))
    counted, found = [0] * robots, []
    for robot in (taken // goals).tolist():
        found.append((counted[robot], robot))
        counted[robot] += 1
    return found

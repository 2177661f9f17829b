"""Picks of parts that are alike, and placements in their goals: each is looked for once, not for every pair."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cache
from math import inf

import numpy as np

from planning.cell.workcell import CellObject, PlacedRobot, Workcell
from planning.contacts.interference import ROUNDING, depth, leads_through
from planning.contacts.precedence import stacked
from planning.contacts.touching import near_to, standing
from planning.grips.friction import firm_grips
from planning.grips.grip import Grip
from planning.grips.tool_grips import overload, robot_grips, why_no_grip
from planning.parts.assembly import PartAssembly
from planning.parts.part_skills import PartSkills, SkillTry
from planning.parts.part_steps import PartStep, part_steps
from planning.steps.skill import Obstruction, SkillPath, joint_distance
from planning.steps.skill_scene import find_obstruction
from planning.steps.tool_changes import in_racks, mounted_tool, with_tools
from planning.transforms import Transform, readonly, translation

_AWAY = 1000.0
"""Height at which parts are that come from nowhere in particular [m]."""


@dataclass(frozen=True)
class AlikeEnd:
    """A pick or a placement that is free once some parts are gone.

    Attributes:
        path: of the skill.
        after: parts that are in the way where they lie at the start.
        latest: number of the last goal, in their order, before which no part in a goal is in the way.
    """

    path: SkillPath
    after: frozenset[str] = frozenset()
    latest: float = inf


@dataclass(frozen=True)
class AlikeEnds:
    """How a robot picks a part, or puts one in a goal.

    Attributes:
        by_grip: free ends by the pose of the tool in the frame of the part.
        reasons: what else was tried, and why it is none.
    """

    by_grip: dict[bytes, AlikeEnd] = field(default_factory=dict)
    reasons: list[tuple[str, Obstruction]] = field(default_factory=list)

    def least(self, robot: PlacedRobot) -> float:
        """Return the least joint distance from HOME; infinite where there is no end [rad]."""
        far = (
            joint_distance(robot.home, e.path.contact) for e in self.by_grip.values()
        )
        return min(far, default=inf)


class GoalEnds:
    """Goals of parts that are alike, in an order, and how robots fill them.

    A goal has the name of the part that is written out with it, and is filled from nowhere in
    particular; what lies at the start has other names in scenes.

    Args:
        cell: its objects are the parts.
        assembly: with groups of parts that are alike, and its steps in an order.

    Attributes:
        steps: in which goals are filled.
        group: the parts that are alike, by the name of each.
        lying: all of them where they are at the start.

    Raises:
        InfeasibleStepError: a part would hang in the air, or goes where something is.
    """

    def __init__(self, cell: Workcell, assembly: PartAssembly) -> None:
        self._assembly = assembly
        self._skills = cache(
            lambda tools: PartSkills(with_tools(cell, tools), assembly)
        )
        self._cell = in_racks(cell)
        self.group = {name: group for group in assembly.alike for name in group}
        self.lying = {
            name: (item, item.start)
            for name in self.group
            for item in [self._cell.object(name)]
        }
        self._covers = stacked(self.lying)
        self._in_goals = {
            goal: frozenset(
                name
                for name in near_to((self._cell.object(goal), at), self.lying, 0.0)
                if depth((self._cell.object(goal), at), self.lying[name]) > ROUNDING
            )
            for goal, at in assembly.goals.items()
            if goal in self.group
        }
        gone = frozenset[str]().union(*self._in_goals.values())
        starts = {f"{name} where it starts": name for name in self.group}
        self._starts = {k: name for k, name in starts.items() if name not in gone}
        there = from_nowhere(self._cell, assembly)
        copies = tuple(
            replace(self._cell.object(name), name=k) for k, name in self._starts.items()
        )
        there = replace(there, objects=(*there.objects, *copies))
        self.steps = tuple(
            step
            for step in part_steps(there, assembly)
            if isinstance(step, PartStep) and step.part.name in self.group
        )
        self._number = {s.part.name: k for k, s in enumerate(self.steps, start=1)}
        self._found: dict[tuple[object, ...], AlikeEnds] = {}

    def placed(self, number: int, robot: PlacedRobot) -> AlikeEnds:
        """Return how a robot puts a part in a goal, beside all that is in place and at the start.

        Args:
            number: of the goal, from 1 in the order of steps.
            robot: with the tool that it has on it.
        """
        key = number, robot.name, robot.tool
        if key not in self._found:
            self._found[key] = ends = AlikeEnds()
            goal = f"{robot.name} places"
            for grip, found in self._places(number, robot):
                self._note(ends, f"{goal}, {grip.words}", grip, found)
        return self._found[key]

    def picked(self, part: str, robot: PlacedRobot) -> AlikeEnds:
        """Return how a robot picks a part where it lies at the start."""
        key = part, robot.name, robot.tool
        if key not in self._found:
            self._found[key] = ends = AlikeEnds()
            for grip, found in self._picks(part, robot):
                self._note(
                    ends, f"{robot.name} picks {part}, {grip.words}", grip, found
                )
        return self._found[key]

    def cheapest(self, number: int, robot: PlacedRobot) -> float:
        """Return the joint distance from HOME of the first way to fill a goal; infinite for none [rad]."""
        if not self.steps[number - 1].step.done_by(robot.name):
            return inf
        for _, found in self._places(number, robot):
            if isinstance(found, AlikeEnd):
                return joint_distance(robot.home, found.path.contact)
        return inf

    def in_the_way(self, number: int, part: str) -> frozenset[str]:
        """Return what must be gone before a part is taken to a goal: what is in that, and what lies on the part."""
        there = self._in_goals[self.steps[number - 1].part.name]
        return (there | self._covers.get(part, frozenset())) - {part}

    def interacting(self, first: int, second: int) -> bool:
        """Tell whether two goals touch when filled, or one bars the straight way into the other."""
        ends = [self.steps[k - 1] for k in (first, second)]
        (a, b) = ((step.part, step.place) for step in ends)
        if near_to(a, {"": b}, self._assembly.touch):
            return True
        ways = self._assembly.handling(ends[0].part.name)
        led = np.array(ways.insertion), ways.approach
        return leads_through(a, b, *led) or leads_through(b, a, *led)

    @staticmethod
    def _note(
        ends: AlikeEnds, what: str, grip: Grip, found: AlikeEnd | Obstruction
    ) -> None:
        if isinstance(found, AlikeEnd):
            ends.by_grip[grip.pose.tobytes()] = found
        else:
            ends.reasons.append((what, found))

    def _grips(
        self, robot: PlacedRobot, part: CellObject, at: Transform
    ) -> Iterator[tuple[Grip, Obstruction | None]]:
        """Yield the grips of a robot on a part somewhere, with why it cannot hold it so."""
        own, rules = self._assembly, self._assembly.handling(part.name).grips
        found = dict(enumerate(robot_grips(robot, part.shape, at, at, rules)))
        words = overload(robot, part)
        if not found:
            words = why_no_grip(robot, part.shape, rules)
        if words is not None:
            nothing = Grip(np.eye(4), "no grip")
            yield nothing, Obstruction(words)
            return
        skills = self._skills(mounted_tool(robot))
        firm = firm_grips(robot, part, found, own.frame, (at,), own.friction)
        for grip in firm.values():
            yield grip, skills.misfit(robot, part, grip)

    def _places(
        self, number: int, robot: PlacedRobot
    ) -> Iterator[tuple[Grip, AlikeEnd | Obstruction]]:
        step = self.steps[number - 1]
        skills = self._skills(mounted_tool(robot))
        for grip, wrong in self._grips(robot, step.part, step.place):
            tried = skills.place(robot, step, grip.pose)
            yield grip, wrong or self._free(tried)

    def _picks(
        self, part: str, robot: PlacedRobot
    ) -> Iterator[tuple[Grip, AlikeEnd | Obstruction]]:
        own = [s for s in self.steps if s.part.name in self.group[part]]
        first, last = self._picking(own[0], part), self._picking(own[-1], part)
        skills = self._skills(mounted_tool(robot))
        for grip, wrong in self._grips(robot, first.part, first.part.start):
            found = wrong or self._free(
                skills.pick(robot, first, grip.pose), carried=True
            )
            if isinstance(found, AlikeEnd) and len(own) > 1:
                again = skills.pick(robot, last, grip.pose)
                found = replace(found, latest=self._latest(found, again))
            yield grip, found

    def _picking(self, step: PartStep, part: str) -> PartStep:
        """Return a step that picks a part where it lies, under the name of the goal."""
        _, start = self.lying[part]
        around = {
            name: at
            for name, at in step.around.items()
            if self._starts.get(name) != part
        }
        known = replace(step, around=around)
        item = replace(step.part, start=start)
        near = near_to(
            (item, start), standing(self._cell) | known.others, self._assembly.touch
        )
        return replace(known, part=item, at_start=near)

    def _free(
        self, tried: SkillTry, *, carried: bool = False
    ) -> AlikeEnd | Obstruction:
        """Return a skill that is free once parts are gone that lie in its way at the start."""
        gone: set[str] = set()
        while True:
            path = tried.found()
            wrong = path if isinstance(path, Obstruction) else None
            if wrong is None and carried:
                wrong = tried.carried_home()
            if not isinstance(path, Obstruction) and wrong is None:
                return AlikeEnd(path, frozenset(self._starts[name] for name in gone))
            assert wrong is not None
            if wrong.by not in self._starts or wrong.by in gone:
                return wrong
            gone.add(wrong.by)
            tried = _without(tried, wrong.by)

    def _latest(self, found: AlikeEnd, tried: SkillTry) -> float:
        """Return the number of the last goal before which no part in a goal is in the way of a pick."""
        latest, after = inf, found.after
        names = {k for k, name in self._starts.items() if name in after}
        for name in names:
            tried = _without(tried, name)
        while (wrong := find_obstruction(found.path, tried.scene)) is not None:
            if wrong.by not in self._number or wrong.by in names:
                return latest
            names.add(wrong.by)
            latest = min(latest, self._number[wrong.by])
            tried = _without(tried, wrong.by)
        return latest


def from_nowhere(cell: Workcell, assembly: PartAssembly) -> Workcell:
    """Return a cell in which parts that are alike lie far away, those with goals alone."""
    alike = {name for group in assembly.alike for name in group}
    away = readonly(translation(0.0, 0.0, _AWAY))
    return replace(
        cell,
        objects=tuple(
            item
            if item.name not in alike
            else replace(item, start=readonly(away @ item.start))
            for item in cell.objects
            if item.name not in alike or item.name in assembly.goals
        ),
    )


def _without(tried: SkillTry, name: str) -> SkillTry:
    """Return a try without a thing in its scene."""
    there = {k: at for k, at in tried.scene.objects.items() if k != name}
    return replace(tried, scene=replace(tried.scene, objects=there))

"""Proof that a structure cannot be assembled: bricks of which none can be the last one in.

A brick is *perhaps insertable* beside some others when nothing is found that keeps it from going
in, whichever further bricks are there or not: none of the others is in its way or in the tool's,
and even the whole design, taken as weightless, bears the press. Whatever keeps it from that keeps
it from going in beside more bricks, too. So bricks that are perhaps insertable can be set aside
one after the other, in any order; if some remain of which none is, no order of assembly exists,
as one of them would have to be the last.

Reachability check of every step, before the search for candidates.

Nothing but the robot itself is looked at. What is out of reach here stays so whatever stands around; what is within reach may still turn out
to be obstructed when candidates are sought (``candidates``).
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from itertools import product
from typing import TypeVar

from planning.cell.workcell import PlacedRobot, Workcell
from planning.errors import InfeasibleStepError
from planning.lego.bricks.assembly import LegoAssembly, Press
from planning.lego.bricks.brick_world import BrickWorld
from planning.lego.bricks.grid import presses
from planning.lego.insertion.insertion import Insertions, press_load
from planning.lego.insertion.rules import InsertionWay
from planning.lego.skills.brick_skills import BrickSkills
from planning.lego.skills.targets import APPROACH_HEIGHT, HIGH_APPROACH
from planning.lego.stability.contacts import ToolHold
from planning.lego.stability.partial_structures import Names, PressBearing
from planning.statics.equilibrium import Load
from planning.steps.skill import (
    SkillPath,
    SkillTargets,
    skill_postures,
)

Part = TypeVar("Part")


def remaining(
    parts: Iterable[Part], perhaps: Callable[[frozenset[Part], Part], bool]
) -> frozenset[Part]:
    """Return the parts that remain when all that are perhaps insertable are set aside.

    Args:
        parts: to begin with, those that are tried first come first.
        perhaps: tells whether a part might be the last one in beside others, given them all. What
            is true for some parts must be true for fewer of them.
    """
    order = list(parts)
    left = frozenset(order)
    while True:
        before = left
        for part in order:
            if part in left and perhaps(left, part):
                left -= {part}
        if left == before:
            return left


def smallest_blocking_set(
    parts: Iterable[Part], perhaps: Callable[[frozenset[Part], Part], bool]
) -> frozenset[Part]:
    """Return parts of which none can be the last one in, and no fewer of them; none if there are.

    Args:
        parts: of the finished product, those first that should rather not be named.
        perhaps: see ``remaining``.
    """
    order = list(parts)
    core = remaining(order, perhaps)
    for part in order:
        if part in core:
            core = (
                remaining((p for p in order if p in core and p != part), perhaps)
                or core
            )
    return core


_Question = tuple[str, InsertionWay, tuple[Press, ...], tuple[ToolHold, ...]]


class Prospects:
    """Tells which bricks of a design might be the last one in beside which others.

    To ask once instead of for every press and every supporting spot, a brick is pressed at all its
    presses at once and held at all spots at once: what the structure does not bear then, it bears
    with none of them.

    Args:
        insertions: of the design.
    """

    def __init__(self, insertions: Insertions) -> None:
        self.insertions = insertions
        self._structures = insertions.structures
        self._design = frozenset(insertions.structures.bricks)
        self._borne: dict[_Question, PressBearing] = {}

    def perhaps(self, parts: Names, brick: str) -> bool:
        """Tell whether a brick might be the last one in beside others (and what is fixed)."""
        names = parts | self.insertions.fixed
        return any(
            bearing is not None and bearing.stable
            for way in self.insertions.rules.ways_of(brick)
            for bearing in [self.bearing(names, brick, way)]
        )

    def bearing(
        self, names: Names, brick: str, way: InsertionWay
    ) -> PressBearing | None:
        """Return what any partial structure might bear at most of a press on a brick.

        Args:
            names: bricks that are in the way if they are.
            brick: the brick.
            way: how it goes in.

        Returns:
            None where it cannot go in that way for want of room, or of something to go onto.
        """
        onto, over = self._structures.below, self._structures.above
        if way.up:
            onto, over = over, onto
        if over(names, brick) or not onto(self._design, brick):
            return None
        roomy = tuple(self.roomy(names, brick, up=way.up))
        if not roomy:
            return None
        holds: tuple[ToolHold, ...] = ()
        if way.held:
            holds = self.insertions.room.holds_anywhere(
                brick,
                sorted(self._design),
                names,
                from_above=way.holds_from_above,
                apart=way.apart,
            )
            if not holds:
                return None
        return self._could_bear((brick, way, roomy, holds))

    def roomy(self, names: Names, brick: str, *, up: bool) -> Iterator[Press]:
        """Yield the presses for which the tool has room among some bricks."""
        room = self.insertions.room
        for press in presses(self._structures.bricks[brick].brick):
            if not room.in_the_way(brick, press, names, up=up):
                yield press

    def _could_bear(self, question: _Question) -> PressBearing:
        known = self._borne.get(question)
        if known is None:
            brick, way, pressed, holds = question
            over = self._structures.below if way.up else self._structures.above
            there = self._design.difference(n for n in over(self._design, brick) if n)
            load = self._load(brick, way, pressed)
            known = self._structures.could_bear(there, load, holds)
            self._borne[question] = known
        return known

    def _load(self, brick: str, way: InsertionWay, pressed: tuple[Press, ...]) -> Load:
        """Return the least force that pressing can take: onto one other brick alone."""
        structures = self._structures
        onto = (structures.above if way.up else structures.below)(self._design, brick)
        force = min(self.insertions.force_onto(brick, (other,)) for other in onto)
        return press_load(structures.bricks[brick], *pressed, up=way.up, force=force)


_MOST_REASONS = 6
"""How many bricks are named."""


class Refusal:
    """Says why bricks of a design cannot go in.

    Args:
        prospects: what might be inserted.
    """

    def __init__(self, prospects: Prospects) -> None:
        self._prospects, self._insertions = prospects, prospects.insertions
        self._rules, self._fixed = self._insertions.rules, self._insertions.fixed
        self._structures = self._insertions.structures

    def place(self, name: str) -> str:
        """Return a brick's name, type and place in words."""
        item = self._structures.bricks[name]
        return f"{name!r} ({item.brick.name} at {item.cell.words})"

    def blocked(self, core: Names) -> str:
        """Return why bricks block each other: none of them can be the last one in."""
        lines = self._lines((self._why_never(core, name), name) for name in core)
        if len(core) == 1:
            return f"no order of assembly exists: this brick cannot go in\n{lines}"
        return (
            f"no order of assembly exists: of these {len(core)} bricks none can go in after the "
            f"others\n{lines}"
        )

    def dead_end(self, parts: Names) -> str:
        """Return why no brick of a partial structure can be the last one in."""
        names = parts | self._fixed
        return self._lines((self._why_not(names, name), name) for name in parts)

    def _lines(self, whys: Iterable[tuple[tuple[int, str], str]]) -> str:
        """Return a line for each brick, those that others wait for first."""
        bricks = self._structures.bricks

        def order(item: tuple[tuple[int, str], str]) -> tuple[int, int, str]:
            (rank, _), name = item
            return rank, -bricks[name].cell.level, name

        ordered = sorted(whys, key=order)
        shown = [
            f"  {self.place(name)}: {reason}"
            for (_, reason), name in ordered[:_MOST_REASONS]
        ]
        if len(ordered) > len(shown):
            shown.append(f"  and {len(ordered) - len(shown)} more")
        return "\n".join(shown)

    def _why_never(self, core: Names, name: str) -> tuple[int, str]:
        """Return why a brick cannot go in beside others, whatever else is there."""
        names = core | self._fixed
        design = frozenset(self._structures.bricks)
        below, above = self._structures.below, self._structures.above
        reasons = []
        for up, onto, over in ((False, below, above), (True, above, below)):
            way = "from below" if up else "from above"
            if not onto(design, name):
                nothing = "above" if up else "below"
                reasons.append(f"there is nothing {nothing} it to press it onto {way}")
                continue
            if over(names, name):
                reasons.append(str(self._insertions.at(names, name, up=up).obstacle()))
                continue
            if up and not self._rules.place_up:
                reasons.append("placing from below is not allowed")
                continue
            reasons.append(self._why_not_borne(names, name, up=up))
        waits = sum("is in the way" in reason for reason in reasons)
        return waits, "; ".join(reasons)

    def _why_not_borne(self, names: Names, name: str, *, up: bool) -> str:
        way = "from below" if up else "from above"
        site = self._insertions.at(names, name, up=up)
        if not any(self._prospects.roomy(names, name, up=up)):
            return f"{way} the tool has no room: {_thing(site.blocker())} is in its way"
        bearings: list[PressBearing] = []
        for each in self._rules.ways_of(name):
            bearing = self._prospects.bearing(names, name, each)
            if each.up == up and bearing is not None:
                bearings.append(bearing)
        if not bearings:
            return f"{way} no spot for the other arm has room"
        best = max(bearings, key=lambda b: b.bears)
        alone = len(bearings) == 1 and not up
        held = "" if alone else ", held at any spot"
        return (
            f"pressed {way} with {best.needed:.1f} N the structure gives way: it bears "
            f"{max(best.bears, 0.0):.1f} N at most, wherever it is pressed{held}"
        )

    def _why_not(self, names: Names, name: str) -> tuple[int, str]:
        """Return why a brick cannot be the last one in, after the rank of the reason."""
        rest = names - {name}
        if not self._structures.stands(rest):
            report = self._structures.weakness(rest)
            what = self.place(report.body or "")
            held = "nothing holds {}" if math.isinf(report.score) else "{} gives way"
            return 2, f"without it {held.format(what)}"
        from_above, from_below = (
            self._insertions.at(names, name, up=up).obstacle() for up in (False, True)
        )
        if from_above and from_below:
            return 1, f"{from_above} and {from_below}"
        up = from_above is not None
        if up and not self._rules.place_up:
            return 0, f"{from_above}, and placing from below is not allowed"
        site = self._insertions.at(names, name, up=up)
        if not site.roomy_presses:
            return 0, f"the tool has no room: {_thing(site.blocker())} is in its way"
        if up:
            return (
                0,
                "no supporting tool above has room and keeps the structure standing",
            )
        best = max((site.bears(p) for p in site.roomy_presses), key=lambda b: b.bears)
        gives = (
            f"the structure gives way under the press of {best.needed:.1f} N (it bears "
            f"{max(best.bears, 0.0):.1f} N)"
        )
        if InsertionWay.DOWN_HELD_BELOW not in self._rules.ways_of(name):
            return 0, f"{gives}, and support is not allowed"
        return 0, f"{gives}, and no supporting tool below has room and helps"


def _thing(name: str) -> str:
    return name if name == "the plate" else f"brick {name!r}"


_NAMED_BRICKS = 6
"""How many steps that are out of reach are named."""

_Attempt = tuple[PlacedRobot, SkillTargets]


def check_reach(cell: Workcell, assembly: LegoAssembly) -> None:
    """Check that every step is within the reach of robots.

    Args:
        cell: its objects are the stock of the assembly.
        assembly: the structure and its steps.

    Raises:
        InfeasibleStepError: no robot reaches where a brick goes or any brick of its type in
            stock, or no other robot reaches a place to support it; names each step, the reason
            and the robots.
    """
    faults = [
        f"step {number} ({assembly.steps[number - 1].words}): {fault}"
        for number, fault in reach_faults(cell, assembly)
    ]
    if faults:
        more = len(faults) - _NAMED_BRICKS
        shown = [*faults[:_NAMED_BRICKS], *([f"and {more} more"] if more > 0 else [])]
        raise InfeasibleStepError("\n".join(shown))


def reach_faults(cell: Workcell, assembly: LegoAssembly) -> Iterator[tuple[int, str]]:
    """Yield what is out of reach, with the number of its step.

    Args:
        cell: its objects are the stock of the assembly.
        assembly: the structure and its steps.
    """
    reach = _Reach(BrickWorld(cell, assembly))
    for number in range(1, len(assembly.steps) + 1):
        for fault in reach.faults(number):
            yield number, fault


class _Reach:
    """Reach of all robots; picks are worked out once for a stock brick."""

    def __init__(self, world: BrickWorld) -> None:
        self._world = world
        self._options = BrickSkills(world)
        self._not_picking: Callable[[str, tuple[int, ...]], dict[str, str]] = cache(
            lambda *pick: self._out_of_reach(self._picks(*pick))
        )

    def faults(self, number: int) -> Iterator[str]:
        """Yield what of a step is out of reach."""
        robots = [robot.name for robot in self._world.cell.robots]
        step = self._world.step(number)
        if len(robots) == 1 and (step.up or step.support is not None):
            need = "a handover and a support" if step.up else "a support"
            yield f"it needs {need} by another robot, and there is only {robots[0]}"
            return
        placing = self._out_of_reach(self._places(number))
        if len(placing) == len(robots):
            yield f"no robot reaches where it goes{_reasons(placing)}"
        stock = self._world.usable_stock(number)
        grasps = tuple(self._world.grasps(number))
        picking = [self._not_picking(name, grasps) for name in stock]
        if stock and all(len(found) == len(robots) for found in picking):
            yield f"no robot reaches {' or '.join(stock)} of the stock{_reasons(picking[0])}"
        if not self._world.step(number).supports:
            return
        supporting = self._out_of_reach(self._supports(number))
        if len(supporting) == len(robots):
            yield f"no robot reaches where to support it{_reasons(supporting)}"
        elif len(placing) < len(robots) and not any(
            a != b and a not in placing and b not in supporting
            for a, b in product(robots, robots)
        ):
            yield (
                "no two robots reach where it goes and where to support it"
                f"{_reasons({**placing, **supporting})}"
            )

    def _out_of_reach(self, attempts: Iterable[_Attempt]) -> dict[str, str]:
        """Return the robots that none of the attempts is possible for, each with a reason."""
        done: set[str] = set()
        reasons: dict[str, dict[str, int]] = defaultdict(lambda: defaultdict(int))
        for robot, targets in attempts:
            if robot.name in done:
                continue
            reason = ""
            for found in skill_postures(robot, targets):
                if isinstance(found, SkillPath):
                    done.add(robot.name)
                    break
                reason = reason or found.words
            else:
                reasons[robot.name][reason] += 1
        return {
            name: max(words, key=lambda w: words[w])
            for name, words in reasons.items()
            if name not in done
        }

    def _places(self, number: int) -> Iterator[_Attempt]:
        step = self._world.step(number)
        heights = (APPROACH_HEIGHT,) if step.up else (APPROACH_HEIGHT, HIGH_APPROACH)
        attacks = (step.attack, -step.attack)
        for grasp, robot, height, attack in product(
            self._world.grasps(number), self._world.cell.robots, heights, attacks
        ):
            yield (
                robot,
                self._options.place_targets(robot.name, number, grasp, attack, height),
            )

    def _picks(self, stock: str, grasps: Iterable[int]) -> Iterator[_Attempt]:
        for grasp, robot in product(grasps, self._world.cell.robots):
            yield robot, self._options.pick_targets(robot.name, stock, grasp)

    def _supports(self, number: int) -> Iterator[_Attempt]:
        choices = range(len(self._world.step(number).supports))
        for choice, robot in product(choices, self._world.cell.robots):
            for targets in self._options.support_targets(number, choice):
                yield robot, targets


def _reasons(reasons: dict[str, str]) -> str:
    """Return why it is out of reach of each robot, in brackets."""
    return f" ({'; '.join(f'{name}: {why}' for name, why in reasons.items())})"

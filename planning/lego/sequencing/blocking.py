"""Proof that a structure cannot be assembled: a set of bricks of which none can be inserted last.

Bricks that are perhaps insertable (see ``insertion``) can be removed one after the other, in any order; if
some remain of which none is, no assembly order exists, as one of them would have to be the last.

Also the reachability check of every step, before the search for candidates. It considers the robot alone:
what is out of reach here stays so in any surroundings; what is within reach may still be obstructed.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from itertools import product
from textwrap import indent
from typing import TypeVar

from planning.cell.workcell import PlacedRobot, Workcell
from planning.errors import InfeasibleStepError, format_faults
from planning.handling.skill_targets import SkillTargets, skill_postures
from planning.lego.bricks.assembly import LegoAssembly
from planning.lego.bricks.brick_world import BrickWorld
from planning.lego.insertion.insertion import Insertions
from planning.lego.insertion.rules import NO_ARM, InsertionMethod
from planning.lego.skills.brick_skills import BrickSkills
from planning.lego.skills.targets import APPROACH_HEIGHT, HIGH_APPROACH, support_targets
from planning.lego.stability.partial_structures import Names
from planning.steps.skill import SkillPath

Part = TypeVar("Part")
_Attempt = tuple[PlacedRobot, SkillTargets]


def blocked_parts(
    parts: Iterable[Part], perhaps: Callable[[frozenset[Part], Part], bool]
) -> frozenset[Part]:
    """Return the parts that remain after removing all that are possibly insertable, repeatedly.

    Args:
        parts: to begin with, those that are tried first come first.
        perhaps: tells whether a part might be inserted last, given all parts with it. What
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
    """Return a smallest set of parts of which none can be inserted last; empty if there is none.

    Args:
        parts: of the finished product, those first that should rather not be named.
        perhaps: see ``blocked_parts``.
    """
    order = list(parts)
    core = blocked_parts(order, perhaps)
    for part in order:
        if part in core:
            core = (
                blocked_parts((p for p in order if p in core and p != part), perhaps)
                or core
            )
    return core


class Refusal:
    """Explains why bricks of a design cannot be inserted.

    Args:
        insertions: of the design.
    """

    def __init__(self, insertions: Insertions) -> None:
        self._insertions, self._structures = insertions, insertions.structures
        self._rules, self._fixed = insertions.rules, insertions.fixed

    def place(self, name: str) -> str:
        """Return a brick's name, type and place in words."""
        item = self._structures.bricks[name]
        return f"{name!r} ({item.brick.name} at {item.cell.words})"

    def blocked(self, core: Names) -> str:
        """Return the reason why bricks block each other: none of them can be inserted last."""
        lines = self._lines(
            (self._structural_refusal(core, name), name) for name in core
        )
        if len(core) == 1:
            return f"no order of assembly exists: this brick cannot go in\n{lines}"
        return (
            f"no order of assembly exists: of these {len(core)} bricks none can go in after the "
            f"others\n{lines}"
        )

    def dead_end(self, parts: Names) -> str:
        """Return the reason why no brick of a partial structure can be inserted last."""
        names = parts | self._fixed
        return self._lines((self._refusal_reason(names, name), name) for name in parts)

    def _lines(self, whys: Iterable[tuple[tuple[int, str], str]]) -> str:
        """Return one line per brick, those that others wait for first."""
        bricks = self._structures.bricks

        def order(item: tuple[tuple[int, str], str]) -> tuple[int, int, str]:
            (rank, _), name = item
            return rank, -bricks[name].cell.level, name

        ordered = sorted(whys, key=order)
        lines = [f"{self.place(name)}: {reason}" for (_, reason), name in ordered]
        return indent(format_faults(lines), "  ")

    def _structural_refusal(self, core: Names, name: str) -> tuple[int, str]:
        """Return the reason why a brick cannot be inserted next to others in any structure."""
        names, design = core | self._fixed, frozenset(self._structures.bricks)
        below, above = self._structures.below, self._structures.above
        reasons, waits = [], 0
        for up, onto, over in ((False, below, above), (True, above, below)):
            if not onto(design, name):
                way, nothing = ("below", "above") if up else ("above", "below")
                reason = f"there is nothing {nothing} it to press it onto from {way}"
            elif over(names, name):
                reason = str(self._insertions.at(names, name, up=up).obstacle())
                waits += 1
            elif up and not self._rules.place_up:
                reason = "placing from below is not allowed"
            else:
                reason = self._explain_overload(names, name, up=up)
            reasons.append(reason)
        return waits, "; ".join(reasons)

    def _explain_overload(self, names: Names, name: str, *, up: bool) -> str:
        way = "from below" if up else "from above"
        site = self._insertions.at(names, name, up=up)
        if not site.roomy:
            return f"{way} {_no_room(site.blocker())}"
        alternatives = [each for each in self._rules.methods_of(name) if each.up == up]
        bearings = [b for b in map(site.prospect, alternatives) if b is not None]
        if not bearings:
            return f"{way} no spot for the other arm has room"
        best = max(bearings, key=lambda b: b.bears)
        alone = len(bearings) == 1 and not up
        held = "" if alone else ", held at any spot"
        return (
            f"pressed {way} with {best.needed:.1f} N the structure gives way: it bears "
            f"{max(best.bears, 0.0):.1f} N at most, wherever it is pressed{held}"
        )

    def _refusal_reason(self, names: Names, name: str) -> tuple[int, str]:
        """Return the reason why a brick cannot be inserted last, after the rank of the reason."""
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
            return 0, _no_room(site.blocker())
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
        if InsertionMethod.DOWN_HELD_BELOW not in self._rules.methods_of(name):
            return 0, f"{gives}, and support is not allowed"
        return 0, f"{gives}, and no supporting tool below has room and helps"


def _no_room(blocker: str) -> str:
    """Return the reason why the tool does not fit."""
    if blocker == NO_ARM:
        return "no arm of the cell gets there with a grip that has room"
    thing = blocker if blocker == "the plate" else f"brick {blocker!r}"
    return f"the tool has no room: {thing} is in its way"


def check_reach(
    cell: Workcell, assembly: LegoAssembly, names: Sequence[str] = ()
) -> None:
    """Check that every step is within the reach of robots.

    Args:
        cell: its objects are the stock of the assembly.
        assembly: the structure and its steps.
        names: what the steps are called, by default their numbers and what they do.

    Raises:
        InfeasibleStepError: no robot reaches where a brick goes or any brick of its type in
            stock, or no other robot reaches a place to support it; names each step, the reason
            and the robots.
    """
    faults = find_reach_faults(cell, assembly, names)
    if faults:
        raise InfeasibleStepError(
            format_faults([words for _, words in faults]),
            steps=[step for step, _ in faults],
        )


def find_reach_faults(
    cell: Workcell, assembly: LegoAssembly, names: Sequence[str] = ()
) -> list[tuple[int, str]]:
    """Return the number of each unreachable step, with the reason; see ``check_reach``."""
    reach, steps = _Reach(BrickWorld(cell, assembly)), assembly.steps
    names = names or [f"step {k} ({s.words})" for k, s in enumerate(steps, start=1)]
    return [
        (number, f"{name}: {fault}")
        for number, name in enumerate(names, start=1)
        for fault in reach.faults(number)
    ]


class _Reach:
    """Reach of all robots, with cached picks of stock bricks."""

    def __init__(self, world: BrickWorld) -> None:
        self._world = world
        self._options = BrickSkills(world)
        self._not_picking: Callable[[str, tuple[int, ...]], dict[str, str]] = cache(
            lambda *pick: self._out_of_reach(self._picks(*pick))
        )

    def faults(self, number: int) -> Iterator[str]:
        """Yield what is out of reach in a step."""
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
        """Return the robots for which no attempt is possible, each with a reason."""
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
        supports, plate = self._world.step(number).supports, self._world.assembly.plate
        for support, robot in product(supports, self._world.cell.robots):
            for targets in support_targets(plate, support):
                yield robot, targets


def _reasons(reasons: dict[str, str]) -> str:
    """Return the reason for each robot, in brackets."""
    return f" ({'; '.join(f'{name}: {why}' for name, why in reasons.items())})"

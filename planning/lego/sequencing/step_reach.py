"""Reachability check of every step, before the search for candidates.

Each robot is considered alone, without obstacles. A pose that is out of reach here is out of reach in any scene. A
pose within reach may still be obstructed.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from itertools import product

from planning.cell.workcell import PlacedRobot, Workcell
from planning.errors import InfeasibleStepError, format_faults
from planning.handling.skill_targets import SkillTargets, skill_postures
from planning.lego.bricks.assembly import LegoAssembly
from planning.lego.bricks.brick_world import BrickWorld
from planning.lego.skills.brick_skills import BrickSkills
from planning.lego.skills.support_targets import support_targets
from planning.lego.skills.targets import APPROACH_HEIGHT, HIGH_APPROACH
from planning.steps.skill import SkillPath

_Attempt = tuple[PlacedRobot, SkillTargets]


def check_reach(
    cell: Workcell, assembly: LegoAssembly, names: Sequence[str] = ()
) -> None:
    """Check that every step is within the reach of robots.

    Args:
        cell: its objects are the stock of the assembly.
        assembly: the structure and its steps.
        names: names of the steps in messages; by default their numbers and descriptions.

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

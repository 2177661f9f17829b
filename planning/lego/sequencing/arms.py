"""Search for a sequence that the arms of a cell can execute: tool clearance and reach are tested alternately.

A sequence is first searched with tool clearance alone. Then the candidates of the arms are computed for each step, as
in planning. If no robot can do a step, the search is repeated with a new constraint. A grip that no arm reaches is
excluded. A grip that bricks obstruct for every arm is excluded next to these bricks. A brick that no two arms can
support must be inserted without support. Every failed sequence adds a constraint that excludes it; otherwise the
search ends.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from planning.cell.workcell import Workcell
from planning.errors import TwinError
from planning.handling.skill_targets import is_possible_in_some_posture
from planning.lego.bricks.assembly import LegoAssembly, PlacedBrick, Plate, Press
from planning.lego.bricks.brick_world import goal_name, press_from_number
from planning.lego.bricks.grid import top_pose
from planning.lego.insertion.rules import ArmLimits, Grip, SequencingRules
from planning.lego.sequencing.sequencing import SequencedStructure
from planning.lego.sequencing.step_reach import check_reach
from planning.lego.skills.candidates import LegoCandidates, find_candidates
from planning.lego.skills.targets import (
    APPROACH_HEIGHT,
    HIGH_APPROACH,
    BrickGrip,
    place_targets,
)
from planning.steps.skill import Obstruction

_MOST_TRIES = 12
"""Sequences that are tried."""

_PATIENCE = 3
"""Number of consecutive sequences without improvement before the search stops."""

Sequencer = Callable[[SequencingRules], tuple[LegoAssembly, SequencedStructure]]
"""Finds a sequence by some rules."""


class GripReach:
    """Cached test whether some arm of a cell reaches a place of a plate with a grip.

    Nothing but the arm itself is looked at.

    Args:
        cell: the cell.
        plate: of the structure.
    """

    def __init__(self, cell: Workcell, plate: Plate) -> None:
        self._cell, self._plate = cell, plate
        self._known: dict[tuple[bytes, bool], bool] = {}

    def __call__(self, item: PlacedBrick, press: Press, up: bool) -> bool:
        """Tell whether an arm reaches a brick with a grip, from below or from above."""
        robot = self._cell.robots[0]
        some = BrickGrip(
            robot.model.frames, item.brick, top_pose(self._plate, item), press
        )
        # Bricks that are gripped at the same place, in the same turn, are one question.
        at = np.round(some.alt if up else some.tool, 6) + 0.0
        key = at.tobytes(), up
        if key not in self._known:
            self._known[key] = self._find(some, up)
        return self._known[key]

    def _find(self, some: BrickGrip, up: bool) -> bool:
        heights = (APPROACH_HEIGHT,) if up else (APPROACH_HEIGHT, HIGH_APPROACH)
        return any(
            is_possible_in_some_posture(
                robot,
                place_targets(
                    replace(some, frames=robot.model.frames),
                    up=up,
                    attack=attack,
                    height=height,
                ),
            )
            for robot, attack, height in product(self._cell.robots, (1, -1), heights)
        )


@dataclass(frozen=True)
class ArmSequence:
    """A sequence, and the capabilities of the arms at its steps.

    Attributes:
        found: the sequence.
        candidates: of its steps.
        rules: that it was found with, the last of them.
    """

    found: SequencedStructure
    candidates: LegoCandidates
    rules: SequencingRules

    @property
    def done(self) -> bool:
        """Whether every step can be done by some arms."""
        return not self.candidates.problem.impossible


def sequence_for_arms(
    cell: Workcell,
    sequenced: Sequencer,
    rules: SequencingRules,
    stage: Callable[[], AbstractContextManager[None]],
) -> ArmSequence:
    """Return a sequence whose every step some arms of a cell can do, or else the first one found.

    Args:
        cell: its objects are the stock.
        sequenced: finds a sequence by some rules.
        rules: to begin with.
        stage: context entered while the reach of arms is checked.

    Raises:
        TwinError: there is no sequence even for the tool alone, or a place that no arm reaches.
    """
    first: ArmSequence | None = None
    reach: GripReach | None = None
    fewest, since = math.inf, 0
    for _ in range(_MOST_TRIES):
        try:
            assembly, found = sequenced(rules)
        except TwinError:
            if first is None:
                raise
            return first  # whose assignment says which step no arm can do
        with stage():
            check_reach(cell, assembly)
            candidates = find_candidates(cell, assembly)
            now = ArmSequence(found, candidates, rules)
            first = first or now
            reach = reach or GripReach(cell, assembly.plate)
        if now.done:
            return now
        undone = len(candidates.problem.impossible)
        since = 0 if undone < fewest else since + 1
        fewest = min(fewest, undone)
        learnt = _refined_rules(now, reach)
        if learnt is None or since == _PATIENCE:
            break
        rules = learnt
    assert first is not None
    return first


def _refined_rules(now: ArmSequence, reach: GripReach) -> SequencingRules | None:
    """Return rules that exclude what the arms cannot do, None where nothing is learnt."""
    rules, names = now.rules, [item.name for item in now.found.sequence]
    impossible = now.candidates.problem.impossible
    blocking = dict(rules.arms.blocking) if rules.arms else {}
    unsupported = set(rules.unsupported)
    for number in impossible:
        item = now.found.sequence[number - 1]
        if item.step.supports and item.name not in unsupported:
            unsupported.add(item.name)
            continue
        for press in item.step.presses:
            bricks = _common_blockers(now.candidates, number, press, names)
            grip: Grip = (item.name, press, item.step.up)
            if bricks is not None and bricks not in blocking.get(grip, ()):
                blocking[grip] = (*blocking.get(grip, ()), bricks)
    # Where arms only do not get to supports, all else is as the tool alone decides it.
    plain = any(not now.found.sequence[k - 1].step.supports for k in impossible)
    arms = ArmLimits(reach, blocking) if plain or rules.arms or blocking else None
    more = replace(rules, unsupported=frozenset(unsupported), arms=arms)
    return None if more == rules else more


def _common_blockers(
    candidates: LegoCandidates, number: int, press: Press, names: Sequence[str]
) -> frozenset[str] | None:
    """Return the bricks that blocked a grip of a step for all arms, None where an arm can reach it.

    They were in the way where the brick goes, or where it is picked.
    """
    world, skills = candidates.world, candidates.skills
    goals = {name: names[k - 1] for name, k in world.goal_numbers.items()}
    grasp = next(g for g in world.grasps(number) if press_from_number(g) == press)
    found: set[str | None] = set()
    for robot in skills.home:
        place = skills.place(robot, number, grasp, None)
        if isinstance(place, Obstruction):
            found.add(place.by)
            continue
        for stock in world.usable_stock(number):
            pick = skills.pick(robot, stock, grasp)
            if isinstance(pick, Obstruction):
                found.add(pick.by)
                continue
            latest = skills.latest(pick)
            if latest is None or number <= latest:
                return None
            found.add(goal_name(latest))
    return frozenset(goals[by] for by in found if by in goals)

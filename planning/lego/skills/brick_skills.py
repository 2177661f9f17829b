"""Collision-free skills of a LEGO assembly for each robot and grip, cached.

A pick depends on the robot, the stock brick and the grip. A place depends on the robot, the step and the grip. They
are checked separately, so pairs of a pick and a place need no checks.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import wraps
from itertools import product
from typing import Any, Concatenate, ParamSpec, TypeVar

from planning.cell.workcell import Attachment
from planning.handling.handovers import Handover, find_handover
from planning.handling.skill_contacts import (
    NOTHING,
    SkillContacts,
    ToolContact,
    grip_contact,
)
from planning.handling.skill_scene import SkillScene
from planning.handling.skill_targets import SkillTargets, Subgoal, skill_postures
from planning.handling.skill_trial import ResolvedSkill, resolve_skill
from planning.kinematics.kinematics import inverse_kinematics
from planning.lego.bricks.brick_world import (
    BrickWorld,
    Placed,
    goal_name,
    press_from_number,
)
from planning.lego.skills.brick_contacts import (
    PRESSED,
    neighbours_leaned_on,
    resting_contacts,
    resting_room,
    support_contacts,
)
from planning.lego.skills.handovers import brick_meetings, giver_rest_poses
from planning.lego.skills.support_targets import support_targets, supported_span
from planning.lego.skills.targets import (
    APPROACH_HEIGHT,
    HIGH_APPROACH,
    BrickGrip,
    pick_targets,
    place_targets,
)
from planning.steps.skill import Obstruction, Pairs, SkillPath, joint_distance
from planning.tasks.assignment import SupportCandidate
from planning.transforms import Array, translation

Found = ResolvedSkill | Obstruction
"""A skill that is free of permanent obstacles, or the reason why there is none."""

Key = ParamSpec("Key")
Answer = TypeVar("Answer")

_ALIKE = 1e-5
"""Joint distances of one posture found twice differ by less [rad or m]."""

_DRAWN_BACK = (0.0, 0.01, 0.02, 0.04)
"""How far behind the pre-pose a support may start [m]."""


def _cached(
    find: Callable[Concatenate[BrickSkills, Key], Answer],
) -> Callable[Concatenate[BrickSkills, Key], Answer]:
    """Cache the results of a method per arguments."""

    @wraps(find)
    def found(skills: BrickSkills, /, *key: Key.args, **named: Key.kwargs) -> Answer:
        known, asked = skills.known[find.__name__], (*key, *named.values())
        if asked not in known:
            known[asked] = find(skills, *key, **named)
        answer: Answer = known[asked]
        return answer

    return found


class BrickSkills:
    """Collision-free picks, places, supports and handovers, or the reasons why there are none.

    Each is computed at most once. The scene is the stock at rest and the goals of the earlier
    steps, other robots at HOME.

    Attributes:
        world: cell and assembly.
        home: HOME of each robot, shape (n,).
        known: cached results by arguments, by the name of the method.
    """

    def __init__(self, world: BrickWorld) -> None:
        self.world = world
        self._tool = ToolContact(world.cell.clearances.contact_tolerance, PRESSED)
        self.home: dict[str, Array] = {r.name: r.home for r in world.cell.robots}
        self.known: dict[str, dict[tuple[object, ...], Any]] = defaultdict(dict)

    def after(self, skill: ResolvedSkill) -> frozenset[str]:
        """Return the stock bricks that block a skill until they have been used."""
        return skill.gone.difference(self.world.goal_numbers)

    def latest(self, skill: ResolvedSkill) -> int | None:
        """Return the last step at which a skill is possible before a later brick blocks it."""
        numbers = self.world.goal_numbers
        return min((numbers[k] for k in skill.gone if k in numbers), default=None)

    @_cached
    def pick(self, robot: str, stock: str, grasp: int) -> Found:
        """Return the pick of a brick of the stock (name) by a robot (name), with a grip (number)."""
        world = self.world
        item, grip = world.stock[stock], self._picked(robot, stock, grasp)
        near = world.stock_neighbours(stock)
        pose, fixtures = world.stock_at_rest[stock][1].pose, world.cell.fixtures
        touching = resting_contacts(robot, item, pose, grip.press, near, fixtures)
        above = world.above[stock]
        scene = SkillScene(
            world.cell,
            {stock: world.stock_at_rest[stock]},
            self.home,
            SkillContacts(NOTHING, touching, grip_contact(robot, stock)),
            (stock, Attachment(robot, grip.held())),
            self._refill(stock),
            world.all_standing.without([*above, stock]),
            ToolContact(
                world.cell.clearances.contact_tolerance,
                PRESSED,
                neighbours_leaned_on(item, near),
            ),
        )
        # What may be gone, or not be there yet, when the brick is picked.
        loose = world.loose_stock.union(world.goal_numbers) - above - {stock}
        option = resolve_skill(
            world.cell.robot(robot),
            [self.pick_targets(robot, stock, grasp)],
            scene,
            loose,
        )
        if self._is_blocked(option):
            targets = self.pick_targets(robot, stock, grasp, by_halves=True)
            other = resolve_skill(world.cell.robot(robot), [targets], scene, loose)
            if not isinstance(other, Obstruction) and (
                isinstance(option, Obstruction)
                or len(self.after(other)) < len(self.after(option))
            ):
                option = other
        if isinstance(option, Obstruction):
            return option
        return replace(option, gone=option.gone | above)

    def _is_blocked(self, found: Found) -> bool:
        """Tell whether obstacles block a skill, for good or until they are gone."""
        if isinstance(found, Obstruction):
            return found.by is not None
        return bool(self.after(found))

    def _refill(self, stock: str) -> Placed | None:
        """Return the next brick at the place of a stock brick once that has been picked."""
        if stock not in self.world.stations:
            return None
        item, at = self.world.stock_at_rest[stock]
        return replace(item, name=f"the next brick of {stock}"), at

    def pick_targets(
        self, robot: str, stock: str, grasp: int, *, by_halves: bool = False
    ) -> SkillTargets:
        """Return the subgoals of picking a stock brick with a grip; ``by_halves`` splits the twist."""
        twist = self.world.assembly.twist["pick"]
        grip = self._picked(robot, stock, grasp)
        return pick_targets(grip, twist=twist, by_halves=by_halves)

    def _picked(self, robot: str, stock: str, grasp: int) -> BrickGrip:
        """Return a robot's grip on a stock brick at its pick."""
        item, top = self.world.stock[stock], self.world.start_top(stock)
        frames = self.world.cell.robot(robot).model.frames
        return BrickGrip(frames, item.brick, top, press_from_number(grasp))

    def place_targets(
        self,
        robot: str,
        step: int,
        grasp: int,
        attack: int | None = None,
        height: float = APPROACH_HEIGHT,
    ) -> SkillTargets:
        """Return the subgoals of placing the brick of a step.

        Args:
            robot: the placing robot.
            step: counted from 1.
            grasp: number of the grip.
            attack: sign of the sideways offset of the approach, the step's own when None.
            height: of the approach of a place-down [m].
        """
        work, twist = self.world.step(step), self.world.assembly.twist
        return place_targets(
            self._placed(robot, step, grasp),
            up=work.up,
            attack=attack or work.attack,
            height=height,
            twist=twist,
        )

    def placing(self, robot: str, step: int, grasp: int) -> Subgoal:
        """Return the pose at which a robot releases the brick of a step."""
        return self._placed(robot, step, grasp).place(up=self.world.step(step).up)

    def _placed(self, robot: str, step: int, grasp: int) -> BrickGrip:
        """Return a robot's grip on the brick of a step in its place."""
        kind, top = self.world.step(step).brick, self.world.goal_top(step)
        frames = self.world.cell.robot(robot).model.frames
        return BrickGrip(frames, kind, top, press_from_number(grasp))

    @_cached
    def place(
        self, robot: str, step: int, grasp: int, supporter: SupportCandidate | None
    ) -> Found:
        """Return the place of a step (from 1) by a robot, with a grip (number).

        ``supporter`` is the robot that supports meanwhile; None when all others are at HOME.
        """
        world, name, work = self.world, goal_name(step), self.world.step(step)
        goal, at_goal = world.goal(step)
        item, near = world.goal_bricks[step - 1], resting_room(work)
        press, others = press_from_number(grasp), world.bricks_near(near, step)
        touching = resting_contacts(
            robot, item, at_goal.pose, press, others, world.cell.fixtures
        )
        standing = dict(self.home)
        if supporter is not None:
            support = self.support(supporter.robot, step, supporter.pose)
            assert isinstance(support, ResolvedSkill), support
            standing[supporter.robot] = support.path.path[-1]
            touching |= self.supported(supporter.robot, step, supporter.pose)
        held = self._placed(robot, step, grasp).held(up=work.up)
        scene = SkillScene(
            world.cell,
            {name: (goal, Attachment(robot, held))},
            standing,
            SkillContacts(grip_contact(robot, name), touching, NOTHING),
            (name, at_goal),
            standing=world.standing(step),
            tool=self._tool,
        )
        alternatives = (
            self.place_targets(robot, step, grasp, attack, height)
            for height, attack in product(*self._approach_options(step, grasp))
        )
        return resolve_skill(
            world.cell.robot(robot), alternatives, scene, world.loose_stock
        )

    @_cached
    def least_pick(self, robot: str, stock: str, grasp: int) -> float:
        """Return the least joint distance from HOME to the grasp of a pick, ignoring obstacles."""
        return self._least(robot, [self.pick_targets(robot, stock, grasp)])

    @_cached
    def near_place(self, robot: str, step: int, grasp: int) -> float:
        """Return a cheap lower bound of ``least_place``: the joint distance to the pose alone.

        That is 0 where no posture is found.
        """
        goal, placed = self.placing(robot, step, grasp), self.world.cell.robot(robot)
        found = inverse_kinematics(placed, goal.frame, goal.pose, placed.home)
        return joint_distance(placed.home, found[0]) - _ALIKE if found else 0.0

    @_cached
    def least_place(self, robot: str, step: int, grasp: int) -> float:
        """Return the least joint distance from HOME to the release of a place, ignoring obstacles."""
        alternatives = product(*self._approach_options(step, grasp))
        return self._least(
            robot,
            [
                self.place_targets(robot, step, grasp, attack, height)
                for height, attack in alternatives
            ],
        )

    def _least(self, robot: str, alternatives: Iterable[SkillTargets]) -> float:
        """Return the least cost of skills in any posture, infinite where there is none.

        What comes after the contact may rule postures out, but adds none.
        """
        least = math.inf
        for targets in alternatives:
            assert targets.change_at is not None
            begun = replace(targets, subgoals=targets.subgoals[: targets.change_at + 1])
            for path in skill_postures(self.world.cell.robot(robot), begun):
                if isinstance(path, SkillPath):
                    least = min(least, joint_distance(self.home[robot], path.contact))
        return least

    def _approach_options(
        self, step: int, grasp: int
    ) -> tuple[tuple[float, ...], tuple[int, ...]]:
        """Return the heights and sides of the approach, in the order to try."""
        work = self.world.step(step)
        # The side given belongs to the step's own press.
        other = () if work.press == press_from_number(grasp) else (-work.attack,)
        heights = (APPROACH_HEIGHT,) if work.up else (APPROACH_HEIGHT, HIGH_APPROACH)
        return heights, (work.attack, *other)

    def supported(self, robot: str, step: int, choice: int) -> Pairs:
        """Return the allowed contacts of a supporting tool, the step's brick included."""
        world = self.world
        support = world.step(step).supports[choice]
        bricks = world.bricks_near(supported_span(support), step)
        own = {goal_name(step): world.step(step)}
        return support_contacts(robot, support, {**bricks, **own})

    @_cached
    def support(self, robot: str, step: int, choice: int) -> Found:
        """Return the support of a step by a robot, by its number, see ``LegoStep.supports``.

        It is from the first pre-pose that works. Where bricks beside the pre-pose are too near for a transit to end there, the skill
        starts further back along the tool.
        """
        world = self.world
        if not world.step(step).supports:
            return Obstruction("the step does not say where to support")
        held = self.supported(robot, step, choice)
        contacts = SkillContacts(NOTHING, held, held)
        standing = world.standing(step)
        alternatives = support_targets(
            world.assembly.plate, world.step(step).supports[choice]
        )
        scene = SkillScene(
            world.cell, {}, self.home, contacts, standing=standing, tool=self._tool
        )
        further = (
            _drawn_back(targets, back)
            for back, targets in product(_DRAWN_BACK, alternatives)
        )
        return resolve_skill(world.cell.robot(robot), further, scene, world.loose_stock)

    @_cached
    def handover(
        self, giver: str, receiver: str, step: int, grasp: int
    ) -> Handover | Obstruction:
        """Return the handover of the brick of a step, at the first place that is free."""
        cell = self.world.cell
        robots = source, _ = cell.robot(giver), cell.robot(receiver)
        resting = giver_rest_poses(source.base)
        rests = inverse_kinematics(source, resting.frame, resting.pose, source.home)
        if not rests:
            return Obstruction(f"{resting.name} of {giver} is out of reach")
        goals = {goal_name(k): self.world.goal(k) for k in range(1, step)}
        around = {**self.world.stock_at_rest, **goals}
        reason: Obstruction | None = None
        for meeting in brick_meetings(
            self.world, robots, step, press_from_number(grasp), rests[0]
        ):
            found = find_handover(cell, around, meeting)
            if isinstance(found, Handover):
                return found
            reason = reason or found
        return reason or Obstruction(f"receive is out of reach of {receiver}")


def _drawn_back(skill: SkillTargets, distance: float) -> SkillTargets:
    """Return a skill that starts further back along the tool [m]."""
    if distance == 0.0:
        return skill
    pre = skill.subgoals[0]
    start = Subgoal("drawn back", pre.frame, pre.pose @ translation(0, 0, -distance))
    return replace(skill, subgoals=(start, *skill.subgoals))

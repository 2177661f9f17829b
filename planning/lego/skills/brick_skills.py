"""Collision-free options of each robot for each skill of a LEGO assembly, cached.

What depends on the robot, the stock brick and the grip (the pick) is apart from what depends on
the robot, the step and the grip (the place): their product is never checked pair by pair.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import cached_property
from itertools import product
from typing import Any, TypeVar

from planning.cell.workcell import Attachment
from planning.kinematics.kinematics import inverse_kinematics
from planning.lego.bricks.assembly import BrickType, Press
from planning.lego.bricks.brick_world import (
    BrickWorld,
    Placed,
    goal_name,
    press_of,
)
from planning.lego.bricks.grid import grip_pose, side_contact_pose
from planning.lego.skills.allowed_contacts import (
    PRESSED,
    contacts_at_rest,
    leaned_on,
    room_at_rest,
    supporting,
)
from planning.lego.skills.handovers import brick_meetings, giver_rest
from planning.lego.skills.targets import (
    APPROACH_HEIGHT,
    HIGH_APPROACH,
    held_box,
    pick_targets,
    place_targets,
    support_bottom_targets,
    support_top_targets,
    supported_span,
)
from planning.steps.handovers import Handover, find_handover
from planning.steps.skill import (
    NOTHING,
    Obstruction,
    Pairs,
    SkillContacts,
    SkillTargets,
    Subgoal,
    ToolContact,
    gripped,
)
from planning.steps.skill_scene import ResolvedSkill, SkillScene, resolve_skill
from planning.tasks.assignment import SupportCandidate
from planning.transforms import Array, Transform, translation

Found = ResolvedSkill | Obstruction
"""A skill that is free but for what will be gone, or why there is none."""

Key = TypeVar("Key", bound=tuple[Any, ...])
Answer = TypeVar("Answer")

_DRAWN_BACK = (0.0, 0.01, 0.02, 0.04)
"""How far behind the pre-pose a support may start [m]."""


class BrickSkills:
    """Free picks, places and supports, or why there are none; each is worked out at most once.

    The scene is the stock at rest and the goals of the earlier steps, other robots at HOME.

    Attributes:
        world: cell and assembly.
        home: HOME of each robot, shape (n,).
    """

    def __init__(self, world: BrickWorld) -> None:
        self.world = world
        self._tool = ToolContact(world.cell.clearances.contact_tolerance, PRESSED)
        self.home: dict[str, Array] = {r.name: r.home for r in world.cell.robots}
        self._picks: dict[tuple[str, str, int], Found] = {}
        self._places: dict[tuple[str, int, int, SupportCandidate | None], Found] = {}
        self._supports: dict[tuple[str, int, int], Found] = {}
        self._handovers: dict[tuple[str, str, int, int], Handover | Obstruction] = {}

    def pick(self, robot: str, stock: str, grasp: int) -> Found:
        """Return the pick of a brick of the stock (name) by a robot (name), with a grip (number)."""
        return _once(self._picks, (robot, stock, grasp), self._pick)

    def place(
        self, robot: str, step: int, grasp: int, beside: SupportCandidate | None
    ) -> Found:
        """Return the place of a step (from 1) by a robot, with a grip.

        Args:
            robot: who places.
            step: counted from 1.
            grasp: number of the grip.
            beside: who stands supporting meanwhile; None when all others are at HOME.
        """
        return _once(self._places, (robot, step, grasp, beside), self._place)

    def support(self, robot: str, step: int, choice: int) -> Found:
        """Return the support of a step by a robot, by its number, see ``LegoStep.supports``."""
        return _once(self._supports, (robot, step, choice), self._support)

    def handover(
        self, giver: str, receiver: str, step: int, grasp: int
    ) -> Handover | Obstruction:
        """Return how the brick of a step goes from one robot to another, with a grip."""
        key = giver, receiver, step, grasp
        return _once(self._handovers, key, self._handover)

    def after(self, skill: ResolvedSkill) -> frozenset[str]:
        """Return the stock bricks that stand in the way of a skill until they have been used."""
        return skill.gone.difference(self.world.goal_numbers)

    def latest(self, skill: ResolvedSkill) -> int | None:
        """Return the last step at which a skill is possible: a later brick is in the way."""
        numbers = self.world.goal_numbers
        return min((numbers[k] for k in skill.gone if k in numbers), default=None)

    def exchanged(self, world: BrickWorld, step: int) -> BrickSkills:
        """Return the options of a world in which a step and the next one are exchanged.

        What is known, and does not depend on their order, is not worked out again.
        """
        other = BrickSkills(world)
        number = {step: step + 1, step + 1: step}
        name = {goal_name(a): goal_name(b) for a, b in number.items()}

        def renamed(found: Found) -> Found:
            return found if isinstance(found, Obstruction) else found.renamed(name)

        other._picks = {key: renamed(found) for key, found in self._picks.items()}
        for placed, found in self._places.items():
            if placed[1] not in number:
                other._places[placed] = renamed(found)
        for held, found in self._supports.items():
            if held[1] not in number:
                other._supports[held] = renamed(found)
        for way, handover in self._handovers.items():
            if way[2] not in number:
                other._handovers[way] = handover
        return other

    def _pick(self, robot: str, stock: str, grasp: int) -> Found:
        world = self.world
        item, top = world.stock[stock], world.start_top(stock)
        near = world.stock_neighbours(stock)
        pose, fixtures = world.stock_at_rest[stock][1].pose, world.cell.fixtures
        press = press_of(grasp)
        touching = contacts_at_rest(robot, item, pose, press, near, fixtures)
        tool = grip_pose(top, item.brick, press)
        held = held_box(world.frames(robot), "tool", tool, top, item.brick)
        above = world.above[stock]
        scene = SkillScene(
            world.cell,
            {stock: world.stock_at_rest[stock]},
            self.home,
            SkillContacts(NOTHING, touching, gripped(robot, stock)),
            (stock, Attachment(robot, held)),
            self._refill(stock),
            world.all_standing.without([*above, stock]),
            ToolContact(
                world.cell.clearances.contact_tolerance,
                PRESSED,
                leaned_on(item, near),
            ),
        )
        loose = self._loose_in_picks - above - {stock}
        option = resolve_skill(
            world.cell.robot(robot),
            self.pick_targets(robot, stock, grasp),
            scene,
            loose,
        )
        if self._is_blocked(option):
            targets = self.pick_targets(robot, stock, grasp, by_halves=True)
            other = resolve_skill(world.cell.robot(robot), targets, scene, loose)
            if not isinstance(other, Obstruction) and (
                isinstance(option, Obstruction)
                or len(self.after(other)) < len(self.after(option))
            ):
                option = other
        if isinstance(option, Obstruction):
            return option
        return replace(option, gone=option.gone | above)

    def _is_blocked(self, found: Found) -> bool:
        """Tell whether things are in the way of a skill, for good or until they are gone."""
        if isinstance(found, Obstruction):
            return found.by is not None
        return bool(self.after(found))

    def _refill(self, stock: str) -> Placed | None:
        """Return what stands where a stock brick was, once it has been picked."""
        if stock not in self.world.stations:
            return None
        item, at = self.world.stock_at_rest[stock]
        return replace(item, name=f"the next brick of {stock}"), at

    def pick_targets(
        self, robot: str, stock: str, grasp: int, *, by_halves: bool = False
    ) -> SkillTargets:
        """Return the subgoals of picking a stock brick with a grip, its twist by halves or not."""
        world = self.world
        return pick_targets(
            world.frames(robot),
            world.stock[stock].brick,
            world.start_top(stock),
            press_of(grasp),
            twist=world.assembly.twist["pick"],
            by_halves=by_halves,
        )

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
            robot: who places.
            step: counted from 1.
            grasp: number of the grip.
            attack: sign of the sideways offset of the approach, the step's own when None.
            height: of the approach of a place-down [m].
        """
        work, twist = self.world.step(step), self.world.assembly.twist
        return place_targets(
            *self._handled(robot, step, grasp),
            up=work.up,
            attack=attack or work.attack,
            height=height,
            twist=twist,
        )

    def held_for_place(self, robot: str, step: int, grasp: int) -> Attachment:
        """Return the attachment of the brick that a robot is about to place."""
        frames, kind, top, press = self._handled(robot, step, grasp)
        if self.world.step(step).up:
            contact = side_contact_pose(top, kind, press)
            return Attachment(robot, held_box(frames, "alt", contact, top, kind))
        tool = grip_pose(top, kind, press)
        return Attachment(robot, held_box(frames, "tool", tool, top, kind))

    def _handled(
        self, robot: str, step: int, grasp: int
    ) -> tuple[Mapping[str, Transform], BrickType, Transform, Press]:
        world = self.world
        brick, top = world.step(step).brick, world.goal_top(step)
        return world.frames(robot), brick, top, press_of(grasp)

    @cached_property
    def _loose_in_picks(self) -> frozenset[str]:
        """What may be gone, or not be there yet, when a brick is picked."""
        steps = range(1, len(self.world.assembly.steps) + 1)
        return self.world.loose_stock.union(map(goal_name, steps))

    def around(self, step: int) -> dict[str, Placed]:
        """Return the stock at rest and the goals of the earlier steps."""
        return {**self.world.stock_at_rest, **self.world.goals(range(1, step))}

    def _place(
        self, robot: str, step: int, grasp: int, beside: SupportCandidate | None
    ) -> Found:
        world, name, work = self.world, goal_name(step), self.world.step(step)
        goal, at_goal = world.goal(step)
        item, near = (
            world.goal_bricks[step - 1],
            world.cells_near(room_at_rest(work), step),
        )
        press, fixtures = press_of(grasp), world.cell.fixtures
        touching = contacts_at_rest(robot, item, at_goal.pose, press, near, fixtures)
        standing = dict(self.home)
        if beside is not None:
            held = self.support(beside.robot, step, beside.pose)
            assert isinstance(held, ResolvedSkill), held
            standing[beside.robot] = held.path.path[-1]
            touching |= self.supported(beside.robot, step, beside.pose)
        held_goal = (goal, self.held_for_place(robot, step, grasp))
        scene = SkillScene(
            world.cell,
            {name: held_goal},
            standing,
            SkillContacts(gripped(robot, name), touching, NOTHING),
            (name, at_goal),
            standing=world.standing(step),
            tool=self._tool,
        )
        attacks = [work.attack]
        if work.press != press:
            attacks.append(-work.attack)  # that of the step belongs to its own press
        heights = (APPROACH_HEIGHT,) if work.up else (APPROACH_HEIGHT, HIGH_APPROACH)
        return _first_free(
            resolve_skill(
                world.cell.robot(robot),
                self.place_targets(robot, step, grasp, attack, height),
                scene,
                world.loose_stock,
            )
            for height, attack in product(heights, attacks)
        )

    def supported(self, robot: str, step: int, choice: int) -> Pairs:
        """Return the allowed contacts of a supporting tool, the step's brick included."""
        world = self.world
        support = world.step(step).supports[choice]
        bricks = world.cells_near(supported_span(support), step)
        own = {goal_name(step): world.step(step)}
        return supporting(robot, support, {**bricks, **own})

    def support_targets(self, step: int, choice: int) -> tuple[SkillTargets, ...]:
        """Return the support of a step as subgoals, from each of its pre-poses."""
        work = self.world.step(step)
        support = work.supports[choice]
        top = work.up or support.from_above
        find = support_top_targets if top else support_bottom_targets
        return find(self.world.assembly.plate, support)

    def _support(self, robot: str, step: int, choice: int) -> Found:
        """Return a support from the first pre-pose that works.

        Where bricks beside the pre-pose are too near for a transit to end there, the skill
        starts further back along the tool.
        """
        world = self.world
        if not world.step(step).supports:
            return Obstruction("the step does not say where to support")
        held = self.supported(robot, step, choice)
        contacts = SkillContacts(NOTHING, held, held)
        standing = world.standing(step)
        scene = SkillScene(
            world.cell, {}, self.home, contacts, standing=standing, tool=self._tool
        )
        return _first_free(
            resolve_skill(
                world.cell.robot(robot),
                _drawn_back(targets, back),
                scene,
                world.loose_stock,
            )
            for back, targets in product(
                _DRAWN_BACK, self.support_targets(step, choice)
            )
        )

    def _handover(
        self, giver: str, receiver: str, step: int, grasp: int
    ) -> Handover | Obstruction:
        """Return a handover at the first place that works."""
        cell = self.world.cell
        robots = source, _ = cell.robot(giver), cell.robot(receiver)
        resting = giver_rest(source.base)
        rests = inverse_kinematics(source, resting.frame, resting.pose, source.home)
        if not rests:
            return Obstruction(f"{resting.name} of {giver} is out of reach")
        taken = self.held_for_place(receiver, step, grasp)
        reason: Obstruction | None = None
        for meeting in brick_meetings(
            self.world, robots, step, press_of(grasp), taken, rests[0]
        ):
            found = find_handover(cell, self.around(step), meeting)
            if isinstance(found, Handover):
                return found
            reason = reason or found
        return reason or Obstruction(f"receive is out of reach of {receiver}")


def _once(known: dict[Key, Answer], key: Key, find: Callable[..., Answer]) -> Answer:
    if key not in known:
        known[key] = find(*key)
    return known[key]


def _first_free(tried: Iterable[Found]) -> Found:
    """Return the first way that is free, or else why the first one is not."""
    reason: Obstruction | None = None
    for found in tried:
        if not isinstance(found, Obstruction):
            return found
        reason = reason or found
    assert reason is not None
    return reason


def _drawn_back(skill: SkillTargets, distance: float) -> SkillTargets:
    """Return a skill that starts further back along the tool [m]."""
    if distance == 0.0:
        return skill
    pre = skill.subgoals[0]
    start = Subgoal("drawn back", pre.frame, pre.pose @ translation(0, 0, -distance))
    return replace(skill, subgoals=(start, *skill.subgoals))

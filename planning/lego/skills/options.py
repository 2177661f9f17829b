"""Collision-free options of each robot for each skill of a LEGO assembly, cached.

What depends on the robot, the stock brick and the grip (the pick) is apart from what depends on
the robot, the step and the grip (the place): their product is never checked pair by pair.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

from planning.cell.workcell import Attachment, PlacedRobot
from planning.lego.bricks.assembly import BrickType, Press
from planning.lego.bricks.brick_world import (
    BrickWorld,
    Placed,
    goal_name,
    grasp_number,
    press_of,
)
from planning.lego.bricks.grips import grip_pose, side_contact_pose
from planning.lego.skills.allowed_contacts import (
    contacts_at_rest,
    supporting,
)
from planning.lego.skills.support import support_bottom_targets, support_top_targets
from planning.lego.skills.targets import (
    APPROACH_HEIGHT,
    HIGH_APPROACH,
    held_box,
    pick_targets,
    place_down_targets,
    place_up_targets,
    support_skill,
)
from planning.skills.contacts import NOTHING, Pairs, SkillContacts, gripped
from planning.skills.joint_paths import (
    Obstruction,
    SkillPath,
    nearer_reason,
    skill_postures,
    unreachable,
)
from planning.skills.subgoals import SkillTargets, Subgoal
from planning.skills.surroundings import SkillScene, SkillTrial
from planning.transforms import Array, Transform, translation

_DRAWN_BACK = (0.0, 0.01, 0.02, 0.04)
"""How far behind the pre-pose a support may start [m]."""


@dataclass(frozen=True)
class SkillOption:
    """A collision-free execution of a skill by one robot.

    Attributes:
        path: in joint space.
        after: stock bricks that stand in the way until they have been used.
        latest: last step at which it is possible, because a later brick is in the way; None
            when none is.
    """

    path: SkillPath
    after: frozenset[str] = frozenset()
    latest: int | None = None


@dataclass(frozen=True)
class StandingSupport:
    """A robot at its support while another one places.

    Attributes:
        robot: who.
        choice: which of the supports of the step.
    """

    robot: str
    choice: int = 0


class SkillOptions:
    """Finds picks, places and supports; each is worked out at most once.

    The scene is the stock at rest and the goals of the earlier steps, other robots at HOME.
    """

    def __init__(self, world: BrickWorld) -> None:
        self.world = world
        self.home: dict[str, Array] = {r.name: r.home for r in world.cell.robots}
        self._known: dict[tuple[Any, ...], SkillOption | Obstruction] = {}

    def pick(self, robot: str, stock: str, grasp: int) -> SkillOption | Obstruction:
        """Return a free pick of a stock brick by a robot with a grip."""
        key = ("pick", robot, stock, grasp)
        if key not in self._known:
            self._known[key] = self._pick(self.world.cell.robot(robot), stock, grasp)
        return self._known[key]

    def place(
        self, robot: str, step: int, grasp: int, beside: StandingSupport | None = None
    ) -> SkillOption | Obstruction:
        """Return a free place of a step's brick by a robot, down or up.

        Args:
            robot: who places.
            step: counted from 1.
            grasp: number of the grip.
            beside: another robot that stands supporting meanwhile; None when it is at HOME.
        """
        key = ("place", robot, step, grasp, beside)
        if key not in self._known:
            self._known[key] = self._place(robot, step, grasp, beside)
        return self._known[key]

    def support(
        self, robot: str, step: int, choice: int = 0
    ) -> SkillOption | Obstruction:
        """Return a free support of a step by a robot, from the first pre-pose that works.

        Args:
            robot: who supports.
            step: counted from 1.
            choice: which of the supports of the step, see ``BrickWorld.supports``.

        Where bricks beside the pre-pose are too near for a transit to end there, the skill
        starts further back along the tool.
        """
        key = ("support", robot, step, choice)
        if key not in self._known:
            placed = self.world.cell.robot(robot)
            self._known[key] = self._support(placed, step, choice)
        return self._known[key]

    def _pick(
        self, robot: PlacedRobot, stock: str, grasp: int
    ) -> SkillOption | Obstruction:
        world = self.world
        item, top = world.stock[stock], world.start_top(stock)
        kind = world.kind(item.brick)
        grip = gripped(robot.name, stock)
        seat = (item.cell, kind, world.stock_at_rest[stock][1].pose)
        touching = contacts_at_rest(
            robot.name, stock, seat, world.stock_beside(stock), world.cell.fixtures
        )
        tool = grip_pose(top, kind, press_of(grasp))
        held = held_box(robot.model.frames, "tool", tool, top)
        above = world.above(stock)
        goals = world.goals(range(1, len(world.assembly.steps) + 1))
        here = {k: v for k, v in world.stock_at_rest.items() if k not in above}
        scene = SkillScene(
            world.cell,
            {**here, **goals},
            self.home,
            SkillContacts(NOTHING, touching, grip),
            (stock, Attachment(robot.name, held)),
            self._refill(stock),
        )
        loose = (world.loose_stock & here.keys()) - {stock} | set(goals)
        targets = self.pick_targets(robot.name, stock, grasp)
        option = self._resolve(robot, targets, scene, loose)
        if isinstance(option, Obstruction):
            return option
        return replace(option, after=option.after | above)

    def _refill(self, stock: str) -> Placed | None:
        """Return what stands where a stock brick was, once it has been picked."""
        if stock not in self.world.stations:
            return None
        item, at = self.world.stock_at_rest[stock]
        return replace(item, name=f"the next brick of {stock}"), at

    def pick_targets(self, robot: str, stock: str, grasp: int) -> SkillTargets:
        """Return the subgoals of picking a stock brick with a grip."""
        world = self.world
        return pick_targets(
            world.cell.robot(robot).model.frames,
            world.kind(world.stock[stock].brick),
            world.start_top(stock),
            press_of(grasp),
            twist=world.assembly.twist["pick"],
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
        frames, kind, top, press = self._handled(robot, step, grasp)
        attack = attack or work.attack
        if work.up:
            contact = side_contact_pose(top, kind, press)
            turn = twist["place-up"]
            return place_up_targets(frames, contact, attack=attack, twist=turn)
        turn = twist["place-down"]
        return place_down_targets(
            frames, kind, top, press, attack=attack, height=height, twist=turn
        )

    def held_for_place(self, robot: str, step: int, grasp: int) -> Attachment:
        """Return the attachment of the brick that a robot is about to place."""
        frames, kind, top, press = self._handled(robot, step, grasp)
        if self.world.step(step).up:
            contact = side_contact_pose(top, kind, press)
            return Attachment(robot, held_box(frames, "alt", contact, top))
        tool = grip_pose(top, kind, press)
        return Attachment(robot, held_box(frames, "tool", tool, top))

    def _handled(
        self, robot: str, step: int, grasp: int
    ) -> tuple[Mapping[str, Transform], BrickType, Transform, Press]:
        """Return tool frames, and type, goal of the top face and grip of a step's brick."""
        world = self.world
        kind = world.kind(world.step(step).brick)
        frames = world.cell.robot(robot).model.frames
        return frames, kind, world.goal_top(step), press_of(grasp)

    def around(self, step: int) -> dict[str, Placed]:
        """Return the stock at rest and the goals of the earlier steps."""
        return {
            **self.world.stock_at_rest,
            **self.world.goals(range(1, step)),
        }

    def _place(
        self, robot: str, step: int, grasp: int, beside: StandingSupport | None
    ) -> SkillOption | Obstruction:
        world = self.world
        name = goal_name(step)
        work = world.step(step)
        others = world.cells_during(step)
        kind = world.kind(work.brick)
        grip = gripped(robot, name)
        goal, at_goal = world.goal(step)
        seat = (work.cell, kind, at_goal.pose)
        touching = contacts_at_rest(robot, name, seat, others, world.cell.fixtures)
        standing = dict(self.home)
        if beside is not None:
            held = self.support(beside.robot, step, beside.choice)
            assert isinstance(held, SkillOption), held
            standing[beside.robot] = held.path.path[-1]
            touching |= self.supported(beside.robot, step, beside.choice)
        scene = SkillScene(
            world.cell,
            {
                **self.around(step),
                name: (goal, self.held_for_place(robot, step, grasp)),
            },
            standing,
            SkillContacts(grip, touching, NOTHING),
            (name, at_goal),
        )
        attacks = [work.attack]
        if grasp_number(work.press or press_of(grasp)) != grasp or not work.press:
            attacks.append(-work.attack)  # that of the step belongs to its own press
        heights = (APPROACH_HEIGHT,) if work.up else (APPROACH_HEIGHT, HIGH_APPROACH)
        placing = world.cell.robot(robot)
        return _first_option(
            self._resolve(
                placing,
                self.place_targets(robot, step, grasp, attack, height),
                scene,
                world.loose_stock,
            )
            for height, attack in product(heights, attacks)
        )

    def supported(self, robot: str, step: int, choice: int = 0) -> Pairs:
        """Return the allowed contacts of a supporting tool, the step's brick included."""
        world = self.world
        bricks = {**world.cells_during(step), **world.goal_cells([step])}
        return supporting(robot, world.supports(step)[choice], bricks)

    def _support(
        self, robot: PlacedRobot, step: int, choice: int
    ) -> SkillOption | Obstruction:
        world = self.world
        work = world.step(step)
        if not world.supports(step):
            return Obstruction("the step does not say where to support")
        plate = world.assembly.plate
        find = support_top_targets if work.up else support_bottom_targets
        targets = find(plate, world.supports(step)[choice])
        held = self.supported(robot.name, step, choice)
        scene = SkillScene(
            world.cell,
            self.around(step),
            self.home,
            SkillContacts(NOTHING, held, held),
        )
        skills = (
            _drawn_back(support_skill(targets, pre=k), back)
            for back, k in product(_DRAWN_BACK, range(len(targets.pre)))
        )
        return _first_option(
            self._resolve(robot, skill, scene, world.loose_stock) for skill in skills
        )

    def _resolve(
        self,
        robot: PlacedRobot,
        targets: SkillTargets,
        scene: SkillScene,
        loose: Iterable[str],
    ) -> SkillOption | Obstruction:
        """Return a path clear of everything, or else of everything that will be gone."""
        trials: list[SkillTrial | Obstruction] = []
        reason: Obstruction | None = None
        for path in skill_postures(robot, targets):
            if isinstance(path, Obstruction):
                trials.append(path)
                reason = nearer_reason(reason, path)
                continue
            trial = SkillTrial(path, scene)
            if trial.found is None:
                return SkillOption(path)
            trials.append(trial)
            reason = nearer_reason(reason, trial.found)
        if reason is None:
            return unreachable(targets)
        loose = set(loose)
        if reason.by not in loose:
            return reason
        reason = None
        for item in trials:
            found = item if isinstance(item, Obstruction) else item.take_away(loose)
            if found is None:
                assert isinstance(item, SkillTrial)
                return self._with_obstacles(item.path, item.gone)
            reason = nearer_reason(reason, found)
        assert reason is not None
        return reason

    def _with_obstacles(self, path: SkillPath, gone: Iterable[str]) -> SkillOption:
        steps: Mapping[str, int] = {
            goal_name(k): k for k in range(1, len(self.world.assembly.steps) + 1)
        }
        later = [steps[name] for name in gone if name in steps]
        stock = frozenset(name for name in gone if name not in steps)
        return SkillOption(path, stock, min(later) if later else None)


def _first_option(
    tried: Iterable[SkillOption | Obstruction],
) -> SkillOption | Obstruction:
    """Return the first way that is free, or else why the first one is not."""
    reason: Obstruction | None = None
    for option in tried:
        if isinstance(option, SkillOption):
            return option
        reason = reason or option
    assert reason is not None
    return reason


def _drawn_back(skill: SkillTargets, distance: float) -> SkillTargets:
    """Return a skill that starts further back along the tool [m]."""
    if distance == 0.0:
        return skill
    pre = skill.subgoals[0]
    start = Subgoal("drawn back", pre.frame, pre.pose @ translation(0, 0, -distance))
    return replace(skill, subgoals=(start, *skill.subgoals))

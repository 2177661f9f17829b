"""Scene of a skill, collision checks of a path in it, and the posture that is free."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from planning.cell import shape
from planning.cell.workcell import (
    Attachment,
    CellObject,
    PlacedRobot,
    Workcell,
    WorldState,
)
from planning.geometry.robot_bodies import entity, robot_bodies, while_deviating
from planning.geometry.scene_checker import SceneChecker
from planning.geometry.standing import StandingBoxes, stand_boxes
from planning.geometry.swept import boxes_in_reach, make_swept
from planning.kinematics.kinematics import frame_pose
from planning.motion.sequential import MARGIN
from planning.steps.skill import (
    Obstruction,
    Pairs,
    Phase,
    SkillContacts,
    SkillPath,
    SkillTargets,
    ToolContact,
    skill_postures,
    touching,
)
from planning.transforms import Array

_IN_IT = (Phase.UNTIL_CHANGE, Phase.SINCE_CHANGE)
"""Phases of the skill itself."""

Placed = tuple[CellObject, Attachment]
"""An object and where it is."""

Objects = Mapping[str, Placed]
"""Objects by name, and where they are."""


@dataclass(frozen=True)
class SkillScene:
    """The scene of a skill: all that stands around the robot, and what changes hands.

    Attributes:
        cell: robots and fixtures; its objects are not used.
        objects: the objects there, by name, each with where it is; of those at rest only what
            changes hands, where ``standing`` is given.
        configurations: of all robots.
        contacts: who may touch whom.
        handed: the object that changes hands in the skill and where it is then, or None.
        refill: what stands there once the skill is complete, such as the next brick of a
            feeding station, or None.
        standing: the fixtures and all objects at rest but for what changes hands, where they are
            known already.
        tool: how deep the tool may overlap objects at rest within the skill; None for not at
            all, and without a limit for those that it may touch.
    """

    cell: Workcell
    objects: Objects
    configurations: Mapping[str, Array]
    contacts: SkillContacts
    handed: tuple[str, Attachment] | None = None
    refill: Placed | None = None
    standing: StandingBoxes | None = None
    tool: ToolContact | None = None

    def near(self, path: SkillPath) -> StandingBoxes:
        """Return the fixtures, and the objects at rest that anything on a path may come near to.

        Nothing that could touch is left out: what counts are the capsules swept along the
        path by the robot and by all that it ever holds on it. The object that changes hands
        is not among them.
        """
        held = self._held_by(path.robot, after=False)
        if self.handed is not None and self.handed[1].holder == path.robot:
            held.append((self.objects[self.handed[0]][0], self.handed[1]))
        boxes = self._at_rest
        objects = boxes.rows[boxes.fixtures :]
        robot = self.cell.robot(path.robot)
        own = robot_bodies(robot, held)
        if error := self.cell.deviations.get(path.skill):
            own = while_deviating(own, robot, path.waypoints, error)
        return boxes.only(
            boxes_in_reach(
                make_swept(own.hulls),
                np.vstack([path.lead, path.path]),
                boxes.places.pose[objects],
                boxes.places.half[objects],
                boxes.places.bounds[objects],
                self.cell.clearances.robot_object + MARGIN,
            )
        )

    def checker(
        self, path: SkillPath, boxes: StandingBoxes, phase: Phase, allowed: Pairs
    ) -> SceneChecker:
        """Return the collision checker of a robot in a phase of the skill.

        Args:
            path: of the skill; the robot may deviate from it as the cell says, but before and after.
            boxes: what stands around but for what changes hands, see ``near``.
            phase: of the skill.
            allowed: who may touch whom in it.
        """
        robot, error = path.robot, self.cell.deviations.get(path.skill)
        after = phase in (Phase.SINCE_CHANGE, Phase.AFTER)
        more: list[shape.Placed] = []
        in_hand: list[tuple[PlacedRobot, list[shape.Placed]]] = []
        for name, (item, at) in self._not_at_rest(after=after).items():
            if at.holder == robot:
                continue
            if at.holder is None:
                more += item.shape.placed(name, at.pose)
                continue
            holder = self.cell.robot(at.holder)
            pose = frame_pose(holder, self.configurations[at.holder]) @ at.pose
            in_hand.append((holder, item.shape.placed(name, pose)))
        if phase is Phase.AFTER and self.refill is not None:
            item, at = self.refill
            more += item.shape.placed(item.name, at.pose)
        around = boxes.plus(more)
        for holder, pieces in in_hand:
            around = around.plus(pieces, of_robot=holder)
        return SceneChecker(
            self.cell,
            robot,
            WorldState(self.configurations, {}),
            allowed,
            margin=MARGIN,
            amid=(self._held_by(robot, after=after), around),
            deviating=(path.waypoints, error) if error and phase in _IN_IT else None,
        )

    @cached_property
    def _at_rest(self) -> StandingBoxes:
        if self.standing is not None:
            return self.standing
        handed = None if self.handed is None else self.handed[0]
        return stand_boxes(
            self.cell.fixtures,
            [
                piece
                for name, (item, at) in self.objects.items()
                if at.holder is None and name != handed
                for piece in item.shape.placed(name, at.pose)
            ],
        )

    def _not_at_rest(self, *, after: bool) -> dict[str, Placed]:
        """Return what changes hands, and what is held, before or after the change."""
        out = {k: v for k, v in self.objects.items() if v[1].holder is not None}
        if self.handed is not None:
            name, at = self.handed
            item, start = self.objects[name]
            out[name] = (item, at if after else start)
        return out

    def _held_by(self, robot: str, *, after: bool) -> list[Placed]:
        around = self._not_at_rest(after=after)
        return [placed for placed in around.values() if placed[1].holder == robot]


class SkillTrial:
    """A path in a scene, checked until something is in the way.

    Attributes:
        path: of the skill.
        found: what is in the way, None when nothing is (any more).
        gone: names of what has been taken away, in this order.
        touched: names of what the tool grazes or leans on, no deeper than it may; whether it
            leans on it.
    """

    def __init__(self, path: SkillPath, scene: SkillScene) -> None:
        self.path = path
        self.gone: list[str] = []
        self.touched: dict[str, bool] = {}
        self._scene = scene
        self._near = scene.near(path)
        self._built: dict[tuple[bool, bool], SceneChecker] = {}
        self._checkers: dict[Phase, SceneChecker] = {}
        self._obstructions = self._in_the_way()
        self.found = self._next()

    def take_away(self, names: Collection[str]) -> Obstruction | None:
        """Go on without whatever is in the way and among some names; return what remains so."""
        while self.found is not None and self.found.by in names:
            assert self.found.by is not None
            if self.found.by in self.gone:
                break
            self.gone.append(self.found.by)
            self._checkers.clear()
            self.found = self._next()
        return self.found

    def resolved(self) -> ResolvedSkill:
        """Return the skill as it is once nothing is in the way any more."""
        left = {k: v for k, v in self.touched.items() if k not in self.gone}
        return ResolvedSkill(self.path, frozenset(self.gone), left)

    def _in_the_way(self) -> Iterator[Obstruction]:
        """Yield obstructions of the path, from its start to its end.

        Whoever goes on has taken away what was yielded last: the same place is looked at again,
        and what was clear before it still is.
        """
        waypoints, change = self.path.waypoints, self.path.change_at
        for q in self.path.lead:
            while found := self._at(q, Phase.BEFORE):
                yield found
        phase = Phase.UNTIL_CHANGE
        for k, (q_a, q_b) in enumerate(pairwise(waypoints)):
            if k == change:
                phase = Phase.SINCE_CHANGE
            while not self._checker(phase).motion_free(q_a, q_b):
                yield self._on_the_way(phase, q_a, q_b)
        while found := self._at(waypoints[-1], Phase.AFTER):
            yield found

    def _at(self, q: Array, phase: Phase) -> Obstruction | None:
        contact = self._checker(phase).contact(q)
        if contact is None:
            return None
        words = f"{contact} {phase.value}"
        return Obstruction(words, contact.second.split(":")[0], phase)

    def _on_the_way(self, phase: Phase, q_a: Array, q_b: Array) -> Obstruction:
        for t in np.linspace(0.0, 1.0, 9)[::-1]:
            contact = self._checker(phase).contact(q_a + t * (q_b - q_a))
            if contact is not None:
                return Obstruction(str(contact), contact.second.split(":")[0])
        return Obstruction("something touches between two subgoals")

    def _next(self) -> Obstruction | None:
        """Return what is in the way next, but for what the tool may graze or lean on."""
        found = next(self._obstructions, None)
        while found is not None and self._may_touch(found.by):
            found = next(self._obstructions, None)
        return self._pressed_into() if found is None else self._explained(found)

    def _explained(self, found: Obstruction) -> Obstruction:
        """Return an obstruction that says so where a robot is in the way as it waits at HOME."""
        name = (found.by or "").partition("/")[0]
        for robot in self._scene.cell.robots:
            if robot.name == name != self.path.robot:
                at = self._scene.configurations[name]
                if np.array_equal(at, robot.home):
                    words = f"{found.words}, as {name} stands at HOME"
                    return replace(found, words=words)
        return found

    def _may_touch(self, name: str | None) -> bool:
        """Tell whether the tool comes near to an object, but no deeper into it than it may."""
        tool = self._scene.tool
        if tool is None or name is None or name in self.touched:
            return False
        if name not in self._near.names[self._near.fixtures :]:
            return False
        checker, way = self._checker(Phase.UNTIL_CHANGE), self.path.waypoints
        leans = checker.tool_comes_within(way, name, -tool.grazing)
        if leans and (
            name not in tool.leaning
            or checker.tool_comes_within(way, name, -tool.pressing)
        ):
            return False
        if not checker.tool_comes_within(way, name, checker.clearance):
            return False
        self.touched[name] = leans
        self._checkers.clear()
        return True

    def _pressed_into(self) -> Obstruction | None:
        """Return an object that the tool may touch, but goes into deeper than it may."""
        tool, scene = self._scene.tool, self._scene
        if tool is None:
            return None
        hand = entity(self.path.robot, "tool")
        beside = {
            name for pair in scene.contacts.during if hand in pair for name in pair
        }
        checker = self._checker(Phase.UNTIL_CHANGE)
        there = frozenset(self._near.names[self._near.fixtures :])
        for name in sorted(beside & there - frozenset(self.gone)):
            if checker.tool_comes_within(self.path.waypoints, name, -tool.pressing):
                deep = f"more than {tool.pressing * 1e3:g} mm"
                return Obstruction(f"the tool would press {deep} into {name}", name)
        return None

    def _checker(self, phase: Phase) -> SceneChecker:
        if phase not in self._checkers:
            checker = self._whole(phase)
            if self.gone:
                checker = checker.without(self.gone)
            self._checkers[phase] = checker
        return self._checkers[phase]

    def _whole(self, phase: Phase) -> SceneChecker:
        """Build one checker while things stay where they are, whatever may touch."""
        scene, robot = self._scene, self.path.robot
        allowed = scene.contacts.before
        if phase is Phase.AFTER:
            allowed = scene.contacts.after
        elif phase is not Phase.BEFORE:
            grazed = touching(entity(robot, "tool"), self.touched)
            allowed = scene.contacts.during | grazed
        if phase is Phase.AFTER and scene.refill is not None:
            return scene.checker(self.path, self._near, phase, allowed)
        changed = scene.handed is not None
        after = phase in (Phase.SINCE_CHANGE, Phase.AFTER) and changed
        deviates = phase in _IN_IT and self.path.skill in scene.cell.deviations
        if (after, deviates) not in self._built:
            built = scene.checker(self.path, self._near, phase, allowed)
            self._built[after, deviates] = built
            return built
        return self._built[after, deviates].with_allowed(allowed)


def find_obstruction(path: SkillPath, scene: SkillScene) -> Obstruction | None:
    """Return the first obstruction of a skill, None where there is none.

    Checked are the goals of the transits before it, every stretch of its reference path, and
    its last configuration, from which the next transit starts.
    """
    return SkillTrial(path, scene).found


@dataclass(frozen=True)
class ResolvedSkill:
    """A skill in joint space that is free of all that stays.

    Attributes:
        path: of the skill.
        gone: names of what must be gone.
        touched: names of what the tool grazes, False, or leans on, True.
    """

    path: SkillPath
    gone: frozenset[str]
    touched: Mapping[str, bool]

    def renamed(self, names: Mapping[str, str]) -> ResolvedSkill:
        """Return the same skill where some things have other names."""
        gone = frozenset(names.get(name, name) for name in self.gone)
        touched = {names.get(name, name): leans for name, leans in self.touched.items()}
        return ResolvedSkill(self.path, gone, touched)


def resolve_skill(
    robot: PlacedRobot,
    targets: SkillTargets,
    scene: SkillScene,
    loose: Collection[str] = (),
) -> ResolvedSkill | Obstruction:
    """Return the skill in joint space, in the posture nearest to HOME that is free.

    Args:
        robot: who does it.
        targets: poses to reach in order.
        scene: of the skill.
        loose: names of objects that may be gone by then, taken away where no posture is free.

    Returns:
        The path, what must be gone and what the tool touches; or why the posture nearest to HOME
        that came furthest failed.
    """
    trials: list[SkillTrial | Obstruction] = []

    def tried() -> Iterator[SkillTrial | Obstruction]:
        for path in skill_postures(robot, targets):
            trial = path if isinstance(path, Obstruction) else SkillTrial(path, scene)
            trials.append(trial)
            yield trial

    found = _first_free(tried(), ())
    if isinstance(found, Obstruction) and found.by in loose:
        return _first_free(trials, loose)
    return found


def _first_free(
    trials: Iterable[SkillTrial | Obstruction], loose: Collection[str]
) -> ResolvedSkill | Obstruction:
    """Return the first skill that is free, or the most telling reason: a collision, in the earlier posture."""
    reason: Obstruction | None = None
    for trial in trials:
        found = trial if isinstance(trial, Obstruction) else trial.take_away(loose)
        if found is None:
            assert isinstance(trial, SkillTrial)
            return trial.resolved()
        if reason is None or (reason.by is None and found.by is not None):
            reason = found
    assert reason is not None
    return reason

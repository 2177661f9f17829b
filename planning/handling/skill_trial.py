"""Collision checks of a skill's path in a scene, and the choice of an arm posture with a collision-free path."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from planning.cell.workcell import PlacedRobot
from planning.geometry.exact import Solid, hull_distance_at
from planning.geometry.robot_bodies import entity_name
from planning.geometry.scene_checker import BodyPair, SceneChecker
from planning.handling.skill_scene import SkillScene
from planning.handling.skill_targets import SkillTargets, skill_postures
from planning.steps.skill import Obstruction, Phase, SkillPath, contacts_with
from planning.transforms import Array, inverse

_CERTAIN_DEPTH = 1e-5
"""Least violation of a clearance that rules out a path: above the error of distances and poses [m]."""

_NO_JOINTS = np.empty(0)
_REFUSED_LIKE_ANOTHER = Obstruction("refused like another path")


@dataclass(frozen=True)
class PathObstacle:
    """Two bodies that blocked a path at one of its configurations.

    Another path of the same scene is refused as well if the same two bodies block it, without a check of all others.

    Attributes:
        before: whether the configuration is the goal of a transit before the skill, not a waypoint of it.
        at: index among these goals, or among the waypoints.
        pair: the bodies.
    """

    before: bool
    at: int
    pair: BodyPair

    def refuses(self, path: SkillPath) -> bool:
        """Tell whether the two bodies block another path."""
        where = path.lead if self.before else path.waypoints
        if not -len(where) <= self.at < len(where):
            return False
        gap, limit = self.pair.gap_at(where[self.at])
        return gap < limit

    def refuses_all(self, robot: PlacedRobot, targets: SkillTargets) -> bool:
        """Tell whether the two bodies block every path through some poses.

        The pose of what the last joint carries is the same in all postures.
        """
        mine, other, limit, _ = self.pair
        before, lead = self.before, targets.lead
        goals = targets.subgoals[:lead] if before else targets.subgoals[lead - 1 :]
        if not -len(goals) <= self.at < len(goals):
            return False
        if mine.joint != robot.model.dof - 1 or other.carrier is not None:
            return False
        goal = goals[self.at]
        joint = goal.pose @ inverse(robot.model.frame_in_last_joint(goal.frame))
        there = Solid(mine.name, mine.body, joint @ mine.local)
        return (
            hull_distance_at(there, _NO_JOINTS, other, _NO_JOINTS)
            < limit - _CERTAIN_DEPTH
        )


class SkillTrial:
    """A path in a scene, checked up to its first obstacle.

    Attributes:
        path: of the skill.
        found: the current obstruction, None for none.
        gone: names of the removed obstacles, in order.
        touched: True for each object that the tool leans on, False for each that it grazes, by name; both
            within the allowed depth.
        hindrance: the bodies that block the path, if other paths can be checked for them; None otherwise.
    """

    def __init__(self, path: SkillPath, scene: SkillScene) -> None:
        self.path = path
        self.gone: list[str] = []
        self.touched: dict[str, bool] = {}
        self.hindrance: PathObstacle | None = None
        self._scene = scene
        self._near = scene.near(path)
        self._checkers: dict[Phase, SceneChecker] = {}
        self._obstructions = self._iterate_obstructions()
        self.found = self._next_obstruction()

    def remove_obstacles(self, names: Collection[str]) -> Obstruction | None:
        """Continue without the obstacles among some names; return the remaining obstruction."""
        while self.found is not None and self.found.by in names:
            assert self.found.by is not None
            if self.found.by in self.gone:
                break
            self.gone.append(self.found.by)
            self._checkers.clear()
            self.found = self._next_obstruction()
        return self.found

    def resolved(self) -> ResolvedSkill:
        """Return the skill after all obstacles are resolved."""
        left = {k: v for k, v in self.touched.items() if k not in self.gone}
        return ResolvedSkill(self.path, frozenset(self.gone), left)

    def _iterate_obstructions(self) -> Iterator[Obstruction]:
        """Yield obstructions of the path, from its start to its end.

        The caller continues after removing the last obstacle. Then the path is checked again from the place of
        that obstacle on, since a removal leaves the path before it clear.
        """
        waypoints, change = self.path.waypoints, self.path.change_at
        for k in range(len(self.path.lead)):
            while found := self._obstruction_at(k, Phase.BEFORE):
                yield found
        phase = Phase.UNTIL_CHANGE
        for k, (q_a, q_b) in enumerate(pairwise(waypoints)):
            if k == change:
                phase = Phase.SINCE_CHANGE
            while not self._checker(phase).motion_free(q_a, q_b, probing=False):
                yield self._path_obstruction(phase, q_a, q_b)
        while found := self._obstruction_at(-1, Phase.AFTER):
            yield found

    def _obstruction_at(self, k: int, phase: Phase) -> Obstruction | None:
        """Return the obstruction at the goal of a transit before the skill, or at a waypoint."""
        path = self.path.lead if phase is Phase.BEFORE else self.path.waypoints
        contact = self._checker(phase).contact(path[k])
        if contact is None:
            return None
        before = phase is Phase.BEFORE
        self.hindrance = contact.pair and PathObstacle(before, k, contact.pair)
        words = f"{contact} {phase.value}"
        return Obstruction(words, contact.obstacle, phase, contact.moving)

    def _path_obstruction(self, phase: Phase, q_a: Array, q_b: Array) -> Obstruction:
        for t in np.linspace(0.0, 1.0, 9)[::-1]:
            contact = self._checker(phase).contact(q_a + t * (q_b - q_a))
            if contact is not None:
                return Obstruction(
                    str(contact), contact.obstacle, moving=contact.moving
                )
        return Obstruction("something touches between two subgoals")

    def _next_obstruction(self) -> Obstruction | None:
        """Return the next obstruction, except contacts that the tool may graze or lean on."""
        found = next(self._obstructions, None)
        while found is not None and self._may_touch(found.by):
            found = next(self._obstructions, None)
        found = self._pressed_into() if found is None else self._with_explanation(found)
        if found is not None and found.phase is None:
            self.hindrance = self._overlap_obstacle(found.by)
        return found

    def _overlap_obstacle(self, name: str | None) -> PathObstacle | None:
        """Return a waypoint at which the tool penetrates an object deeper than is ever allowed."""
        tool, path = self._scene.tool, self.path.waypoints
        if tool is None or name not in self._near.names[self._near.fixtures :]:
            return None
        depth = max(tool.grazing, tool.pressing) + _CERTAIN_DEPTH
        checker = self._checker(Phase.UNTIL_CHANGE)
        pairs = (checker.tool_overlaps(q, name, depth) for q in path[::-1])
        return next(
            (
                PathObstacle(before=False, at=~k, pair=p)
                for k, p in enumerate(pairs)
                if p
            ),
            None,
        )

    def _with_explanation(self, found: Obstruction) -> Obstruction:
        """Return an obstruction whose text says so if the blocking robot stands at HOME."""
        name = (found.by or "").partition("/")[0]
        for robot in self._scene.cell.robots:
            if robot.name == name != self.path.robot:
                at = self._scene.configurations[name]
                if np.array_equal(at, robot.home):
                    words = f"{found.words}, as {name} stands at HOME"
                    return replace(found, words=words)
        return found

    def _may_touch(self, name: str | None) -> bool:
        """Tell whether the tool comes near an object, and penetrates it no deeper than allowed."""
        tool = self._scene.tool
        if tool is None or name is None or name in self.touched:
            return False
        if name not in self._near.names[self._near.fixtures :]:
            return False
        checker, path = self._checker(Phase.UNTIL_CHANGE), self.path.waypoints
        leans = checker.tool_comes_within(path, name, -tool.grazing)
        if leans and (
            name not in tool.leaning
            or checker.tool_comes_within(path, name, -tool.pressing)
        ):
            return False
        if not leans and not checker.tool_comes_within(path, name, checker.clearance):
            return False
        self.touched[name] = leans
        self._checkers.clear()
        return True

    def _pressed_into(self) -> Obstruction | None:
        """Return an object that the tool may touch, but penetrates deeper than allowed."""
        tool, scene = self._scene.tool, self._scene
        if tool is None:
            return None
        hand = entity_name(self.path.robot, "tool")
        touchable = {
            name for pair in scene.contacts.during if hand in pair for name in pair
        }
        checker = self._checker(Phase.UNTIL_CHANGE)
        there = frozenset(self._near.names[self._near.fixtures :])
        for name in sorted(touchable & there - frozenset(self.gone)):
            if checker.tool_comes_within(self.path.waypoints, name, -tool.pressing):
                deep = f"more than {tool.pressing * 1e3:g} mm"
                return Obstruction(f"the tool would press {deep} into {name}", name)
        return None

    def _checker(self, phase: Phase) -> SceneChecker:
        if phase not in self._checkers:
            checker = self._build_checker(phase)
            if self.gone:
                checker = checker.without(self.gone)
            self._checkers[phase] = checker
        return self._checkers[phase]

    def _build_checker(self, phase: Phase) -> SceneChecker:
        """Return the checker of a phase, with its allowed contacts."""
        scene, robot = self._scene, self.path.robot
        allowed = scene.contacts.before
        if phase is Phase.AFTER:
            allowed = scene.contacts.after
        elif phase is not Phase.BEFORE:
            grazed = contacts_with(entity_name(robot, "tool"), self.touched)
            allowed = scene.contacts.during | grazed
        return scene.checker(self.path, self._near, phase, allowed)


def find_obstruction(path: SkillPath, scene: SkillScene) -> Obstruction | None:
    """Return the first obstruction of a skill, None where there is none.

    The goals of the transits before it are checked, every stretch of its reference path, and its last
    configuration, from which the next transit starts.
    """
    return SkillTrial(path, scene).found


@dataclass(frozen=True)
class ResolvedSkill:
    """A skill in joint space that is free of permanent obstacles.

    Attributes:
        path: of the skill.
        gone: names of the objects that must be gone.
        touched: True for each object that the tool leans on, False for each that it grazes, by name.
    """

    path: SkillPath
    gone: frozenset[str]
    touched: Mapping[str, bool]


def resolve_skill(
    robot: PlacedRobot,
    alternatives: Iterable[SkillTargets],
    scene: SkillScene,
    loose: Collection[str] = (),
) -> ResolvedSkill | Obstruction:
    """Return the skill in joint space: the first feasible alternative, in the collision-free posture nearest to HOME.

    Args:
        robot: the robot.
        alternatives: poses to reach in order, for each alternative.
        scene: of the skill.
        loose: names of objects that may be gone by then; they are removed if no posture is free otherwise.

    Returns:
        The resolved skill; or the most informative obstruction of the first alternative, among its postures in order
        of distance to HOME.
    """
    hindrances: list[PathObstacle] = []
    reason: Obstruction | None = None
    for targets in alternatives:
        found = _resolve_posture(
            robot, targets, scene, loose, hindrances, existence_only=reason is not None
        )
        if not isinstance(found, Obstruction):
            return found
        reason = reason or found
    assert reason is not None
    return reason


def _resolve_posture(
    robot: PlacedRobot,
    targets: SkillTargets,
    scene: SkillScene,
    loose: Collection[str],
    hindrances: list[PathObstacle],
    *,
    existence_only: bool,
) -> ResolvedSkill | Obstruction:
    """Return the skill by one alternative.

    Args:
        robot, targets, scene, loose: see ``resolve_skill``.
        hindrances: of other paths; those of this alternative are put before them.
        existence_only: True if only the existence of a skill matters, not the reason why there is none.
    """
    if existence_only and any(one.refuses_all(robot, targets) for one in hindrances):
        return _REFUSED_LIKE_ANOTHER
    trials: list[SkillTrial | SkillPath | Obstruction] = []
    reason: Obstruction | None = None
    may_help, settled = False, existence_only
    for path in skill_postures(robot, targets):
        # Once it is known why there is none, a posture may be refused for any reason.
        if (
            settled
            and isinstance(path, SkillPath)
            and any(hindrance.refuses(path) for hindrance in hindrances)
        ):
            trials.append(path)
            continue
        trial = path if isinstance(path, Obstruction) else SkillTrial(path, scene)
        found = trial if isinstance(trial, Obstruction) else trial.found
        if found is None:
            assert isinstance(trial, SkillTrial)
            return trial.resolved()
        trials.append(trial)
        reason = _more_informative(reason, found)
        may_help |= (found if existence_only else reason).by in loose
        settled = existence_only or (reason.by is not None and not may_help)
        if isinstance(trial, SkillTrial) and trial.hindrance and found.by not in loose:
            hindrances.insert(0, trial.hindrance)
            if settled and trial.hindrance.refuses_all(robot, targets):
                return reason
    if not may_help:
        return reason or _REFUSED_LIKE_ANOTHER
    every = [SkillTrial(t, scene) if isinstance(t, SkillPath) else t for t in trials]
    blocked = _first_free(every, ())
    if isinstance(blocked, Obstruction) and blocked.by in loose:
        return _first_free(every, loose)
    return blocked


def _first_free(
    trials: Iterable[SkillTrial | Obstruction], loose: Collection[str]
) -> ResolvedSkill | Obstruction:
    """Return the first free skill, or the most informative reason."""
    reason: Obstruction | None = None
    for trial in trials:
        found = (
            trial if isinstance(trial, Obstruction) else trial.remove_obstacles(loose)
        )
        if found is None:
            assert isinstance(trial, SkillTrial)
            return trial.resolved()
        reason = _more_informative(reason, found)
    assert reason is not None
    return reason


def _more_informative(known: Obstruction | None, found: Obstruction) -> Obstruction:
    """Return the more informative of two reasons: a collision, then the earlier one."""
    if known is None or (known.by is None and found.by is not None):
        return found
    return known

"""Order of robot goals in which no robot stands where another one has to go.

Goals are taken in the order in which they are given. Where every configuration of a goal is blocked by robots that stand
there, each of these does its own next goal first, if it can; else it moves to a configuration that makes room, and
returns to its last goal at the end. Only configurations at rest are compared: paths are found by the motion planner.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from planning.cell.workcell import Workcell
from planning.geometry.scene_checker import Contact, SceneChecker
from planning.goals.robot_goal import RobotGoal
from planning.kinematics.kinematics import inverse_kinematics
from planning.motion.sequential import MARGIN
from planning.steps.skill import Obstruction, joint_distance
from planning.transforms import Array

_MOST_CONFIGURATIONS = 12
"""Configurations tried for one pose of a tool."""

_SAMPLES = 256
"""Random configurations tried for a robot that makes room."""

_MOST_TURNS = np.pi
"""Greatest angle of a joint among these samples [rad]."""


@dataclass(frozen=True)
class ReachedGoal:
    """A goal with its configurations.

    Attributes:
        goal: the goal.
        start: configuration that its robot is expected to come from, shape (n,).
        configurations: those that are clear of fixtures, resting objects and the robot itself, by number.
        rejected: reason why a configuration is not among them, by number; by 0 where there is none at all.
        blocked_by: robot that stands there and cannot make room; None if that is not the cause.
    """

    goal: RobotGoal
    start: Array
    configurations: dict[int, Array]
    rejected: dict[int, Obstruction]
    blocked_by: str | None = None

    def nearest_first(self) -> list[Array]:
        """Return the configurations in the order in which the motion planner tries them."""
        return sorted(
            self.configurations.values(), key=lambda q: joint_distance(q, self.start)
        )


def order_goals(cell: Workcell, goals: Sequence[RobotGoal]) -> list[ReachedGoal]:
    """Return goals in an order in which every robot finds its goal free, with configurations that make room.

    Args:
        cell: the static cell; robots start at HOME.
        goals: in the order in which they are taken where no robot is in the way.

    Returns:
        The goals and the added ones. A goal without configurations cannot be reached; nothing follows one that is
        blocked by other robots.
    """
    return list(_Order(cell, goals).reached())


@dataclass
class _Order:
    """Robots at rest while one goal after another is reached.

    Attributes:
        cell: the static cell.
        pending: goals that are still to be reached.
        standing: configuration of each robot, shape (n,).
        last: goal that each robot reached last.
    """

    cell: Workcell
    goals: Sequence[RobotGoal]
    pending: deque[RobotGoal] = field(init=False)
    standing: dict[str, Array] = field(init=False)
    last: dict[str, RobotGoal] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.pending = deque(self.goals)
        self.standing = dict(self.cell.start_state().configurations)

    def reached(self) -> Iterator[ReachedGoal]:
        """Yield the goals in their new order."""
        left = 4 * len(self.goals) * len(self.cell.robots)
        while self.pending:
            there = self._configurations(self.pending.popleft())
            if self._reach(there) or not there.configurations:
                yield there
            elif left > 0 and (leaving := self._leaving_robot(there)) is not None:
                self.pending.appendleft(there.goal)
                self._plan_return(leaving.goal)
                self._reach(leaving)
                yield leaving
                left -= 1
            else:
                yield self._blocked(there)
                return

    def _reach(self, there: ReachedGoal) -> bool:
        """Move a robot to the first configuration of its goal that is free of other robots; False for none."""
        robot = there.goal.robot
        for q in there.nearest_first():
            if self._is_free(robot, q):
                self.standing[robot] = q
                if there.goal.purpose != "make room":
                    self.last[robot] = there.goal
                return True
        return False

    def _leaving_robot(self, there: ReachedGoal) -> ReachedGoal | None:
        """Return the next goal of a robot that stands at the goal of another one; None if not all can leave."""
        robot = there.goal.robot
        tried = [(q, self._blockers(robot, q)) for q in there.nearest_first()]
        for q, blockers in sorted(tried, key=lambda item: len(item[1])):
            found = [self._leave(name, robot, q, there.goal) for name in blockers]
            if None not in found:
                return found[0]
        return None

    def _leave(
        self, name: str, robot: str, q: Array, goal: RobotGoal
    ) -> ReachedGoal | None:
        """Return the goal of a robot that leaves the place that another one needs; None if it cannot leave."""
        own = next((item for item in self.pending if item.robot == name), None)
        wanted = own if own is not None and own.purpose == "goal" else None
        if own is None and (last := self.last.get(name)) is not None:
            # In another posture, if its last goal is a pose.
            wanted = replace(last, purpose="return")
        if wanted is not None:
            there = self._configurations(wanted)
            clear = {
                number: then
                for number, then in there.configurations.items()
                if self._is_free(name, then, robot, q)
            }
            if clear:
                return replace(there, configurations=clear)
        if own is None and name in self.last and self._has_ended(robot):
            return None  # both would have to stay where they are
        for place in self._places(name):
            if self._is_free(name, place, robot, q):
                room = RobotGoal(name, place, number=goal.number, purpose="make room")
                there = self._configurations(room)
                if there.configurations:
                    return there
        return None

    def _plan_return(self, goal: RobotGoal) -> None:
        """Remove a goal that comes earlier than planned, or append the return of a robot that makes room."""
        kept = [item for item in self.pending if item is not goal]
        if len(kept) < len(self.pending):
            self.pending = deque(kept)
            return
        last = self.last.get(goal.robot)
        if goal.purpose == "make room" and last and self._has_ended(goal.robot):
            self.pending.append(replace(last, purpose="return"))

    def _has_ended(self, robot: str) -> bool:
        return all(item.robot != robot for item in self.pending)

    def _blocked(self, there: ReachedGoal) -> ReachedGoal:
        """Return a goal without configurations, with the robot that stands there as the reason."""
        rejected, robot, name = dict(there.rejected), there.goal.robot, ""
        for number, q in there.configurations.items():
            name, contact = next(iter(self._blockers(robot, q).items()))
            last = self.last.get(name)
            where = "at HOME" if last is None else f"at goal {last.number}, its last"
            words = f"{name} stands there {where}, and cannot make room: {contact}"
            rejected[number] = Obstruction(words, contact.obstacle)
        return ReachedGoal(there.goal, there.start, {}, rejected, name)

    def _places(self, name: str) -> Iterator[Array]:
        """Yield configurations at which a robot may make room: HOME, then samples, the nearest first."""
        placed = self.cell.robot(name)
        yield placed.home
        here, model = self.standing[name], placed.model
        low = np.maximum(model.lower, np.minimum(-_MOST_TURNS, model.upper))
        high = np.minimum(model.upper, np.maximum(_MOST_TURNS, model.lower))
        drawn = np.random.default_rng(0).uniform(low, high, (_SAMPLES, len(here)))
        # Near ones too: a small motion is often enough.
        near = here + (drawn - here) * np.linspace(0.1, 1.0, _SAMPLES)[:, None]
        yield from sorted(near, key=lambda sample: joint_distance(sample, here))

    def _configurations(self, goal: RobotGoal) -> ReachedGoal:
        """Return the configurations of a goal that are possible if there are no other robots."""
        name, start = goal.robot, self.standing[goal.robot]
        alone = replace(self.cell, robots=(self.cell.robot(name),))
        checker = SceneChecker(alone, name, alone.start_state(), margin=MARGIN)
        found, rejected = dict[int, Array](), dict[int, Obstruction]()
        for number, q in enumerate(self._solutions(goal, start)):
            if (contact := checker.contact(q)) is None:
                found[number] = q
            else:
                rejected[number] = Obstruction(str(contact), contact.obstacle)
        if not found and not rejected:
            rejected[0] = Obstruction("the pose is out of reach")
        return ReachedGoal(goal, start, found, rejected)

    def _solutions(self, goal: RobotGoal, near: Array) -> Sequence[Array]:
        if goal.joints is not None:
            return [goal.joints]
        assert goal.pose is not None
        robot = self.cell.robot(goal.robot)
        solutions = inverse_kinematics(robot, goal.frame, goal.pose, near)
        return solutions[:_MOST_CONFIGURATIONS]

    def _is_free(
        self, name: str, q: Array, robot: str | None = None, at: Array | None = None
    ) -> bool:
        """Tell whether a configuration is free of other robots, and of ``robot`` at ``at``, too."""
        if self._blockers(name, q):
            return False
        if robot is None or at is None:
            return True
        return self._contact(name, q, robot, at) is None

    def _blockers(self, name: str, q: Array) -> dict[str, Contact]:
        """Return the robots that stand where a robot would be at ``q``."""
        found: dict[str, Contact] = {}
        for robot in self.cell.robots:
            if robot.name != name:
                at = self.standing[robot.name]
                contact = self._contact(name, q, robot.name, at)
                if contact is not None:
                    found[robot.name] = contact
        return found

    def _contact(self, name: str, q: Array, other: str, at: Array) -> Contact | None:
        """Return the contact of a robot at ``q`` with another one at ``at``; None if there is none."""
        pair = replace(
            self.cell,
            robots=(self.cell.robot(name), self.cell.robot(other)),
            fixtures=(),
            objects=(),
        )
        state = pair.start_state().with_robot(other, at)
        return SceneChecker(pair, name, state, margin=MARGIN).contact(q)

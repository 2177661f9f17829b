"""Small worlds for tests: planar arms of boxes, random sequential plans with objects."""

from copy import copy
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from planning.cell.body import ConvexBody
from planning.cell.cover import box_body
from planning.cell.robot_model import KinematicChain, LinkPart, RobotModel
from planning.cell.shape import box_shape
from planning.cell.workcell import (
    Attachment,
    CellObject,
    Clearances,
    PlacedRobot,
    Workcell,
    WorldState,
)
from planning.geometry.exact import TOLERANCE
from planning.geometry.scene_checker import SceneChecker
from planning.kinematics.kinematics import frame_pose
from planning.motion.motion_plan import MotionPlan, TaskMotion
from planning.tasks.task import AllowedContact, Handling, Task
from planning.transforms import Array, inverse, rotation, translation

LINK = 0.3


def _shifted(name: str, size: tuple[float, float, float], x: float) -> ConvexBody:
    body = box_body(name, size)
    shift = np.array([x, 0.0, 0.0])
    capsules = type(body.capsules)(
        body.capsules.start + shift, body.capsules.end + shift, body.capsules.radius
    )
    return ConvexBody(name, body.vertices + shift, capsules)


def planar_arm(joints: int) -> RobotModel:
    """An arm in the x-y plane: ``joints`` links of LINK each, the last one is its tool."""
    placement = np.stack(
        [np.eye(4)] + [translation(LINK, 0.0, 0.0) for _ in range(joints - 1)]
    )
    parts = tuple(
        LinkPart(
            j,
            "tool" if j == joints - 1 else "arm",
            _shifted(f"link{j}", (LINK - 0.02, 0.05, 0.05), LINK / 2),
        )
        for j in range(joints)
    )
    return RobotModel(
        f"planar{joints}",
        Path(f"planar{joints}.urdf"),
        (),
        tuple(f"j{j}" for j in range(joints)),
        np.full(joints, -2.8),
        np.full(joints, 2.8),
        np.full(joints, 1.0),
        KinematicChain(
            placement, np.tile([0.0, 0.0, 1.0], (joints, 1)), np.zeros(joints, bool)
        ),
        translation(LINK, 0.0, 0.0),
        {},
        parts,
        frozenset((i, j) for j in range(joints) for i in range(j)),
        np.zeros(joints),
    )


def planar_cell(
    robots: int, rng: np.random.Generator, objects: int = 0, *, reach: float = 0.75
) -> Workcell:
    """Arms on a circle, folded back at HOME, and boxes that plans place somewhere."""
    placed = []
    for i in range(robots):
        joints = 2 + int(rng.integers(2))
        angle = 2 * np.pi * i / robots
        base = rotation("z", angle + np.pi) @ translation(-reach, 0.0, 0.0)
        home = np.full(joints, 2.3)
        home[0] = 1.2
        placed.append(PlacedRobot(f"arm{i}", planar_arm(joints), base, home))
    boxes = tuple(
        CellObject(
            f"box{k}",
            "box",
            box_shape("box", (0.06, 0.06, 0.04)),
            translation(0.0, 0.0, -1.0 - k),
        )
        for k in range(objects)
    )
    return Workcell(tuple(placed), (), boxes, Clearances(0.001, 0.0))


@dataclass
class PlanWriter:
    """Writes a sequential plan task by task, checking each motion in the scene as it stands."""

    cell: Workcell
    rng: np.random.Generator
    step: float = 0.15
    configurations: dict[str, Array] = field(default_factory=dict)
    attachments: dict[str, Attachment] = field(default_factory=dict)
    tasks: list[Task] = field(default_factory=list)
    motions: list[TaskMotion] = field(default_factory=list)
    dependencies: list[tuple[int, int]] = field(default_factory=list)
    allowed: list[AllowedContact] = field(default_factory=list)
    time: float = 0.0

    def __post_init__(self) -> None:
        self.configurations = {r.name: r.home for r in self.cell.robots}
        self.attachments = {
            o.name: Attachment(None, o.start) for o in self.cell.objects
        }

    def checker(self, robot: str, touching: tuple[str, ...] = ()) -> SceneChecker:
        return SceneChecker(
            self.cell,
            robot,
            WorldState(self.configurations, self.attachments),
            frozenset(frozenset((f"{robot}/tool", o)) for o in touching),
            margin=2 * TOLERANCE,
        )

    def line(self, q_a: Array, q_b: Array) -> Array:
        count = max(int(np.ceil(np.abs(q_b - q_a).sum() / self.step)), 1)
        return q_a + np.linspace(0.0, 1.0, count + 1)[:, None] * (q_b - q_a)

    def free(self, robot: str, path: Array, touching: tuple[str, ...] = ()) -> bool:
        checker = self.checker(robot, touching)
        return all(checker.motion_free(a, b) for a, b in pairwise(path))

    def random_goal(self, robot: str) -> Array:
        model = self.cell.robot(robot).model
        q = self.rng.uniform(-1.3, 1.3, model.dof)
        q[0] = self.rng.uniform(-0.9, 0.9)
        return q

    def add(
        self,
        robot: str,
        kind: str,
        path: Array,
        handlings: tuple[Handling, ...] = (),
        obj: str | None = None,
    ) -> int:
        index = len(self.tasks)
        length = np.abs(np.diff(path, axis=0)).sum(axis=1)
        time = self.time + np.concatenate([[0.0], np.cumsum(length)])
        self.tasks.append(
            Task(index, robot, kind, 1, f"{kind} {index}", path[1:], handlings, obj)
        )
        self.motions.append(TaskMotion(path, time))
        self.time = float(time[-1])
        self.configurations[robot] = path[-1]
        for h in handlings:
            self.attachments[h.object] = Attachment(h.holder, h.pose)
        return index

    def transit(self, robot: str, goal: Array, via: bool = True) -> bool:
        start = self.configurations[robot]
        path = self.line(start, goal)
        if via and self.rng.random() < 0.5:
            middle = 0.5 * (start + goal) + self.rng.normal(0.0, 0.15, len(goal))
            path = np.vstack([self.line(start, middle), self.line(middle, goal)[1:]])
        if not self.free(robot, path):
            return False
        self.add(robot, "transit", path)
        return True

    def flange(self, robot: str) -> Array:
        return frame_pose(self.cell.robot(robot), self.configurations[robot])

    def written(self) -> dict[str, Any]:
        """Return all that is written so far."""
        kept = vars(self).items()
        return {key: copy(value) for key, value in kept if key not in ("cell", "rng")}

    def go_back(self, written: dict[str, Any]) -> None:
        """Forget all that was written since."""
        vars(self).update(written)

    def plan(self) -> MotionPlan:
        return MotionPlan(
            self.cell,
            tuple(self.tasks),
            tuple(self.motions),
            np.array(self.dependencies, dtype=np.int64).reshape(-1, 2),
            tuple(self.allowed),
        )


def _wiggle(writer: PlanWriter, robot: str) -> Array:
    q = writer.configurations[robot]
    there = q + writer.rng.normal(0.0, 0.05, len(q))
    return np.stack([q, there, q])


def random_plan(
    robots: int,
    seed: int,
    *,
    rounds: int = 8,
    objects: int = 2,
    handover: bool = True,
    step: float = 0.15,
    cell: Workcell | None = None,
) -> MotionPlan:
    """Robots take turns: out, a skill, maybe with a box, sometimes home, sometimes they stay."""
    rng = np.random.default_rng(seed)
    writer = PlanWriter(cell or planar_cell(robots, rng, objects), rng, step)
    names = [r.name for r in writer.cell.robots]
    last_use: dict[str, int] = {}
    for _ in range(rounds):
        robot = names[int(rng.integers(robots))]
        for _attempt in range(10):
            if writer.transit(robot, writer.random_goal(robot)):
                break
        held = [o for o, a in writer.attachments.items() if a.holder == robot]
        wiggle = _wiggle(writer, robot)
        fresh = [o for o in writer.attachments if o not in last_use]
        index = len(writer.tasks)
        if held and handover and rng.random() < 0.4 and robots > 1:
            _hand_over(writer, robot, held[0], last_use)
        elif held:
            _put_down(writer, robot, held[0], wiggle, last_use)
        elif fresh:
            _pick_up(writer, robot, fresh[0], wiggle, last_use)
        elif writer.free(robot, wiggle):
            writer.add(robot, "support-bottom", wiggle)
            if index > 2 and rng.random() < 0.5:
                writer.dependencies.append((int(rng.integers(index)), index))
        if rng.random() < 0.75:
            writer.transit(robot, writer.cell.robot(robot).home)
    plan = writer.plan()
    keep = [
        (a, b)
        for a, b in plan.dependencies.tolist()
        if plan.tasks[a].robot != plan.tasks[b].robot or a < b
    ]
    return replace(plan, dependencies=np.array(keep, dtype=np.int64).reshape(-1, 2))


def _allow(writer: PlanWriter, robots: tuple[str, ...], box: str, *tasks: int) -> None:
    for robot in robots:
        writer.allowed.append(AllowedContact(f"{robot}/tool", box, frozenset(tasks)))


def _pick_up(
    writer: PlanWriter, robot: str, box: str, wiggle: Array, last_use: dict[str, int]
) -> None:
    # The box is put where the tool is going to be: its start is a free parameter of the world.
    pose = frame_pose(writer.cell.robot(robot), wiggle[1]) @ translation(0.04, 0, 0)
    cell = writer.cell
    objects = (replace(o, start=pose) if o.name == box else o for o in cell.objects)
    trial = replace(cell, objects=tuple(objects))
    if not _free_since_start(writer, trial, box, pose, robot):
        return
    held = Attachment(robot, translation(0.04, 0, 0))
    resting = dict(writer.attachments)
    writer.attachments[box] = held
    ok = writer.free(robot, wiggle)
    writer.attachments = resting
    if not ok:
        return
    writer.cell = trial
    writer.attachments[box] = Attachment(None, pose)
    index = writer.add(
        robot, "pick", wiggle, (Handling(box, 1, robot, held.pose),), box
    )
    _allow(writer, (robot,), box, index, index - 1)
    last_use[box] = index


def _free_since_start(
    writer: PlanWriter, trial: Workcell, box: str, pose: Array, robot: str
) -> bool:
    """Tell whether all motions written so far clear a box that rests at ``pose``."""
    attachments = {
        o.name: Attachment(None, translation(0, 0, -5.0 - k))
        for k, o in enumerate(trial.objects)
    }
    attachments[box] = Attachment(None, pose)
    far = {r.name: r.home for r in trial.robots}
    held: dict[str, Attachment] = {}
    for task, motion in zip(writer.tasks, writer.motions, strict=True):
        last = task.index == len(writer.tasks) - 1 and task.robot == robot
        allowed = (
            frozenset([frozenset((f"{robot}/tool", box))]) if last else frozenset()
        )
        carried = {o: a for o, a in held.items() if a.holder == task.robot}
        for handling in task.handlings:
            held[handling.object] = Attachment(handling.holder, handling.pose)
        carried |= {o: a for o, a in held.items() if a.holder == task.robot}
        alone = tuple(r for r in trial.robots if r.name == task.robot)
        checker = SceneChecker(
            replace(trial, robots=alone),
            task.robot,
            WorldState(far, attachments | carried),
            allowed,
            margin=0.12,
        )
        if not all(checker.motion_free(a, b) for a, b in pairwise(motion.path)):
            return False
    return True


def _put_down(
    writer: PlanWriter, robot: str, box: str, wiggle: Array, last_use: dict[str, int]
) -> None:
    pose = (
        frame_pose(writer.cell.robot(robot), wiggle[1]) @ writer.attachments[box].pose
    )
    if not writer.free(robot, wiggle):
        return
    before = writer.written()
    index = writer.add(
        robot, "place-down", wiggle, (Handling(box, 1, None, pose),), box
    )
    # It leaves at once: straight home, touching what it has just put down.
    home = writer.line(writer.configurations[robot], writer.cell.robot(robot).home)
    if not writer.free(robot, home, (box,)):
        writer.go_back(before)
        return
    writer.add(robot, "transit", home)
    _allow(writer, (robot,), box, index, index + 1)
    last_use[box] = index


def _hand_over(
    writer: PlanWriter, giver: str, box: str, last_use: dict[str, int]
) -> None:
    names = [r.name for r in writer.cell.robots if r.name != giver]
    receiver = names[int(writer.rng.integers(len(names)))]
    q = writer.configurations[giver]
    path = np.stack([q, q])
    world = writer.flange(giver) @ writer.attachments[box].pose
    pose = inverse(writer.flange(receiver)) @ world
    before = writer.written()
    prior = [t.index for t in writer.tasks if t.robot == receiver]
    index = writer.add(
        giver, "handover", path, (Handling(box, 1, receiver, pose),), box
    )
    if prior:
        writer.dependencies.append((prior[-1], index))
    home = writer.line(q, writer.cell.robot(giver).home)
    ok = writer.free(giver, home, (box,))
    if ok:
        writer.add(giver, "transit", home)
        _allow(writer, (giver,), box, index, index + 1)
        back = writer.configurations[receiver]
        ok = writer.transit(receiver, back + 0.1, via=False)
    if ok:
        _allow(writer, (giver, receiver), box, index, index + 1, index + 2)
        writer.dependencies.append((index, index + 2))
        last_use[box] = index
    else:
        writer.go_back(before)

"""Keyframes of a pick and a place as one program (Hartmann et al., eq. 4), to compare with drawing them.

Unknowns are the configurations at both switches and at the ends of their straight ways, and the turn
with which the tool holds the part, which all share. Residuals are errors of the tool's pose, and by how much capsules of the robot come nearer
than a margin to boxes; Levenberg-Marquardt on compiled kinematics, from inverse kinematics that has
not looked at collisions. What comes out is judged by the exact checks that all keyframes pass.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from planning.construction.checks.checker import SpaceTimeChecker
from planning.construction.keyframes import Keyframe, Keyframes, KeyframeSolver
from planning.construction.problem.problem import Hold
from planning.construction.world.timeline import skill_motion
from planning.geometry.distance import segment_box
from planning.geometry.robot_bodies import robot_bodies
from planning.kernels import inner_kernel, kernel
from planning.kinematics.chain import JointTable, placed_joints, pose_joints
from planning.kinematics.damped_least_squares import solve_from
from planning.kinematics.kinematics import frame_in_last_joint
from planning.transforms import Array, Indices, Transform, translation

_MARGIN = 0.006
"""Robots keep so far from boxes [m]."""

_WEIGHT = 0.5
"""A metre too near weighs so much of a metre off the pose."""

_STEPS = 40


class Bodies(NamedTuple):
    """Capsules of a robot, and boxes around it at one switch.

    Attributes:
        ends: of the capsules in the frame of the joint that carries each, shape (c, 2, 3).
        radius: shape (c,) [m].
        joint: shape (c,).
        pose: of the boxes, shape (b, 4, 4).
        half: shape (b, 3) [m].
        looked: which capsules keep clear of which boxes, shape (c, b).
    """

    ends: Array
    radius: Array
    joint: Indices
    pose: Array
    half: Array
    looked: Array


@inner_kernel
def _residuals(
    joints: JointTable,
    tip: Array,
    target: Array,
    bodies: Bodies,
    q: Array,
    poses: Array,
    out: Array,
) -> None:
    """Write pose errors and penalties of one switch, shape (6 + c,)."""
    pose_joints(joints, q, poses)
    tool = poses[-1] @ tip
    out[:6] = 0.0
    for i in range(3):
        out[i] = tool[i, 3] - target[i, 3]
        a, b = tool[:, i], target[:, i]
        out[3] += 0.5 * (b[1] * a[2] - b[2] * a[1])
        out[4] += 0.5 * (b[2] * a[0] - b[0] * a[2])
        out[5] += 0.5 * (b[0] * a[1] - b[1] * a[0])
    start, end = np.empty(3), np.empty(3)
    for c in range(len(bodies.radius)):
        at = poses[bodies.joint[c] + 1]
        for i in range(3):
            start[i], end[i] = at[i, 3], at[i, 3]
            for k in range(3):
                start[i] += at[i, k] * bodies.ends[c, 0, k]
                end[i] += at[i, k] * bodies.ends[c, 1, k]
        total = 0.0
        for b in range(len(bodies.half)):
            if bodies.looked[c, b]:
                gap = np.sqrt(segment_box(start, end, bodies.pose[b], bodies.half[b]))
                near = bodies.radius[c] + _MARGIN - gap
                if near > 0.0:
                    total += near * near
        out[6 + c] = _WEIGHT * np.sqrt(total)


@inner_kernel
def _turned(target: Array, turn: float) -> Array:
    out = target.copy()
    c, s = np.cos(turn), np.sin(turn)
    out[:3, 0] = c * target[:3, 0] + s * target[:3, 1]
    out[:3, 1] = c * target[:3, 1] - s * target[:3, 0]
    return out


@kernel
def solve_jointly(
    joints: JointTable,
    tip: Array,
    targets: Array,
    split: int,
    pick: Bodies,
    place: Bodies,
    x: Array,
) -> float:
    """Solve for all phases from a start; write the solution to ``x``, shape (p n + 1,).

    Args:
        joints: of the robot.
        tip: pose of the tool frame in the last joint's frame, shape (4, 4).
        targets: its pose in each phase at turn zero, shape (p, 4, 4).
        split: how many phases are of the pick; the others are of the place.
        pick, place: what is around the robot then.
        x: configurations of the phases one after another, and the turn [rad].

    Returns:
        Sum of squares of what is left.
    """
    n, p = len(joints.lower), len(targets)
    last, rows = p * n, 6 + len(pick.radius)
    poses = np.empty((n + 1, 4, 4))
    r, moved, new = np.empty(p * rows), np.empty(p * rows), np.empty(p * rows)
    jacobian, y = np.zeros((p * rows, last + 1)), np.empty(last + 1)
    damping, cost = 1e-3, np.inf
    for step in range(_STEPS):
        if step == 0:
            for k in range(p):
                _phase(joints, tip, targets, split, pick, place, x, k, poses, r)
            cost = np.sum(r * r)
        if cost < 1e-16:
            break
        for j in range(last + 1):
            y[:] = x
            y[j] += 1e-6
            moved[:] = r
            for k in range(p):
                if j == last or j // n == k:
                    _phase(joints, tip, targets, split, pick, place, y, k, poses, moved)
            jacobian[:, j] = (moved - r) / 1e-6
        matrix, slope = jacobian.T @ jacobian, jacobian.T @ r
        better = False
        for _ in range(8):
            damped = matrix.copy()
            for j in range(last + 1):
                damped[j, j] += damping * (1.0 + matrix[j, j])
            y[:] = x - np.linalg.solve(damped, slope)
            for j in range(last):
                y[j] = min(max(y[j], joints.lower[j % n]), joints.upper[j % n])
            for k in range(p):
                _phase(joints, tip, targets, split, pick, place, y, k, poses, new)
            trial = np.sum(new * new)
            if trial < cost:
                better = trial < cost * (1.0 - 1e-4)
                x[:], r[:], cost = y, new, trial
                damping = max(0.2 * damping, 1e-9)
                break
            damping *= 5.0
        if not better:
            break
    return float(cost)


@inner_kernel
def _phase(
    joints: JointTable,
    tip: Array,
    targets: Array,
    split: int,
    pick: Bodies,
    place: Bodies,
    x: Array,
    k: int,
    poses: Array,
    out: Array,
) -> None:
    n, rows = len(joints.lower), 6 + len(pick.radius)
    to = _turned(targets[k], x[-1])
    around = pick if k < split else place
    own = out[k * rows : (k + 1) * rows]
    _residuals(joints, tip, to, around, x[k * n : (k + 1) * n], poses, own)


@dataclass
class JointKeyframes(KeyframeSolver):
    """Finds keyframes of one robot by the joint program.

    Attributes:
        restarts: starts of the program.
        failed: how many of them ended in a configuration that the exact checks refused.
    """

    restarts: int = 30
    failed: int = 0

    def alone(self, robot: str) -> Iterator[Keyframes]:
        """Yield keyframes of one robot that picks and places."""
        scenes = self.scenes
        problem, part = scenes.problem, scenes.part
        placed, item = problem.cell.robot(robot), problem.object(part)
        joints = placed_joints(placed)
        tip = np.ascontiguousarray(frame_in_last_joint(placed.model, problem.frame))
        n, sampler = placed.model.dof, self.bounds.sampler(robot)
        around = [self._bodies(robot, at) for at in (item.start, part.goal)]
        for _ in range(self.restarts):
            grip = int(self.rng.integers(len(part.grips)))
            turn = float(self.rng.uniform(-np.pi, np.pi))
            ends = (item.start, part.goal)
            starts = [
                sampler.sample(problem.tool_pose(part, at, grip, turn), self.rng, 1)
                for at in ends
            ]
            if not all(starts):
                continue
            flat = [problem.tool_pose(part, at, grip, 0.0) for at in ends]
            off = [translation(*(-problem.approach * tool[:3, 2])) for tool in flat]
            before = translation(*(-problem.approach * part.insertion))
            targets = (
                flat[0],
                off[0] @ flat[0],
                flat[1],
                before @ flat[1],
                off[1] @ flat[1],
            )
            first, second = starts[0][0], starts[1][0]
            x = np.concatenate([first, first, second, second, second, [turn]])
            solve_jointly(joints, tip, np.array(targets), 2, around[0], around[1], x)
            hold = Hold(grip, float(x[-1]))
            found = [
                self._exact(robot, skill, hold, at, q)
                for skill, at, q in zip(
                    ("pick", "place-down"), ends, (x[:n], x[2 * n : 3 * n]), strict=True
                )
            ]
            pick, place = found
            if pick is None or place is None:
                self.failed += 1
                continue
            yield Keyframes((hold,), (pick,), (place,))

    def _bodies(self, robot: str, at: Transform) -> Bodies:
        """Return the capsules of a robot, and fixtures and the part where it is touched."""
        problem, part = self.scenes.problem, self.scenes.part
        own = robot_bodies(problem.cell.robot(robot))
        item = problem.object(part)
        boxes = [
            (f.name, f.pose, f.shape.pieces[0].half) for f in problem.cell.fixtures
        ]
        boxes.append((part.name, at, item.shape.pieces[0].half))
        ends, radius, joint, looked = [], [], [], []
        for solid, entity in zip(own.solids, own.entities, strict=True):
            for pair, r in zip(solid.ends, solid.body.capsules.radius, strict=True):
                ends.append(pair)
                radius.append(r)
                joint.append(solid.joint)
                looked.append(
                    [
                        not (name == part.name and entity.endswith("/tool"))
                        and not (name == "ground" and solid.joint < 3)
                        for name, _, _ in boxes
                    ]
                )
        return Bodies(
            np.ascontiguousarray(ends),
            np.array(radius),
            np.array(joint, dtype=np.int64),
            np.array([pose for _, pose, _ in boxes]),
            np.array([half for _, _, half in boxes]),
            np.array(looked),
        )

    def _exact(
        self, robot: str, skill: str, hold: Hold, at: Transform, q: Array
    ) -> Keyframe | None:
        """Return the keyframe at a configuration, None where the exact checks refuse it."""
        scenes = self.scenes
        problem, part = scenes.problem, scenes.part
        placed = problem.cell.robot(robot)
        tool = problem.tool_pose(part, at, *hold)
        found, start = np.empty((1, len(q))), np.ascontiguousarray(q)
        tip = np.ascontiguousarray(frame_in_last_joint(placed.model, problem.frame))
        target = np.ascontiguousarray(tool)
        if not solve_from(
            placed_joints(placed), tip, target, start, start[None], found
        ):
            return None
        if np.max(np.abs(found[0] - q)) > 0.1:
            return None
        at_goal = skill != "pick"
        empty = scenes.empty(robot, at_goal=at_goal)
        held = scenes.held(robot, hold, at_goal=at_goal)
        phase: tuple[SpaceTimeChecker, SpaceTimeChecker]
        phase = (held, empty) if at_goal else (empty, held)
        into = part.insertion if at_goal else tool[:3, 2]
        ways = (problem.approach * into, -problem.approach * tool[:3, 2])
        checker, q = phase[0], found[0].copy()
        soon = checker.start + checker.least_duration(checker.start_configuration(), q)
        if not checker.configuration_free(q, soon):
            return None
        seconds = problem.seconds_of(skill, robot, part)
        velocity = placed.model.velocity
        motion = skill_motion(placed, problem.frame, q, ways, velocity, seconds)
        if motion is None:
            return None
        windows = self._windows(motion, phase, soon)
        return Keyframe(motion, windows) if len(windows) else None

"""Damped least squares (Levenberg-Marquardt) on the six-dimensional pose error, in compiled code.

The pose error has six components: the difference of the positions [m] and the rotation vector between the
orientations [rad], with equal weights. Joint limits hold at every step.
"""

from __future__ import annotations

import numpy as np

from planning.kernels import inner_kernel, kernel
from planning.kinematics.chain import JointTable, joint_axis, pose_joints
from planning.transforms import Array

TOLERANCE = 1e-7
"""Greatest distance [m] and angle [rad] of a solution from its target."""

_STEPS = 80
_DISTINCT = 1e-4


@kernel
def solve_from(
    joints: JointTable,
    tip: Array,
    target: Array,
    seed: Array,
    starts: Array,
    found: Array,
) -> int:
    """Solve from every start; write distinct solutions to ``found`` and return how many.

    Args:
        joints: of the robot.
        tip: pose of the wanted frame in the last joint's frame, shape (4, 4).
        target: its wanted pose in the base frame, shape (4, 4).
        seed: a solution takes the whole turns nearest to it, shape (n,).
        starts: shape (s, n), within the limits.
        found: receives the solutions, in the order of the starts, shape (s, n).
    """
    count = 0
    n = starts.shape[1]
    poses, q = np.empty((n + 1, 4, 4)), np.empty(n)
    for k in range(starts.shape[0]):
        for j in range(n):
            q[j] = starts[k, j]
        if not _converge(joints, tip, target, q, poses):
            continue
        _take_nearest_turns(joints, q, seed)
        known = False
        for i in range(count):
            gap = 0.0
            for j in range(n):
                gap = max(gap, abs(found[i, j] - q[j]))
            if gap < _DISTINCT:
                known = True
                break
        if not known:
            for j in range(n):
                found[count, j] = q[j]
            count += 1
    return count


@kernel
def follow_targets(
    joints: JointTable, tips: Array, targets: Array, chain: Array, begin: int
) -> int:
    """Solve for targets one after another, each from the solution before it.

    Args:
        joints: of the robot.
        tips: pose of the wanted frame of each target in the last joint's frame, shape
            (s, 4, 4).
        targets: wanted poses in the base frame, shape (s, 4, 4).
        chain: receives the solutions, shape (s, n); the one before ``begin`` is given.
        begin: first target to solve for, at least 1.

    Returns:
        The first target that was not solved for, s when all were.
    """
    n = chain.shape[1]
    lower, upper = joints.lower, joints.upper
    poses, q = np.empty((n + 1, 4, 4)), np.empty(n)
    for k in range(begin, len(targets)):
        for j in range(n):
            q[j] = min(max(chain[k - 1, j], lower[j]), upper[j])
        if not _converge(joints, tips[k], targets[k], q, poses):
            return k
        _take_nearest_turns(joints, q, chain[k - 1])
        for j in range(n):
            chain[k, j] = q[j]
    return len(targets)


@inner_kernel
def _take_nearest_turns(joints: JointTable, q: Array, seed: Array) -> None:
    """Add whole turns to each revolute joint, within its limits, to bring it near the seed."""
    turn = 2.0 * np.pi
    for j in range(len(q)):
        if joints.prismatic[j]:
            continue
        lower, upper = joints.lower[j], joints.upper[j]
        best = q[j]
        other = best - turn * np.floor((best - lower) / turn)
        while other <= upper:
            if other >= lower and abs(other - seed[j]) < abs(best - seed[j]):
                best = other
            other += turn
        q[j] = best


@inner_kernel
def _converge(
    joints: JointTable, tip: Array, target: Array, q: Array, poses: Array
) -> bool:
    """Move ``q`` to a solution by damped least squares; True on success."""
    n = q.shape[0]
    lower, upper = joints.lower, joints.upper
    error, trial_error = np.empty(6), np.empty(6)
    jacobian, gradient = np.empty((6, n)), np.empty(n)
    normal, damped = np.empty((n, n)), np.empty((n, n))
    step, trial = np.empty(n), np.empty(n)
    tip_pose = np.empty((4, 4))
    pose_joints(joints, q, poses)
    size = _pose_error(poses, tip, target, tip_pose, error)
    damping = 1e-2
    for _ in range(_STEPS):
        if size < 1e-22:
            break
        _jacobian(joints, poses, tip_pose, jacobian)
        _normal_equations(joints, jacobian, error, q, normal, gradient)
        before = size
        for _ in range(8):
            for i in range(n):
                for j in range(i + 1):
                    damped[i, j] = normal[i, j]
                damped[i, i] += damping
                step[i] = gradient[i]
            _solve_positive(damped, step)
            for i in range(n):
                trial[i] = min(max(q[i] + step[i], lower[i]), upper[i])
            pose_joints(joints, trial, poses)
            trial_size = _pose_error(poses, tip, target, tip_pose, trial_error)
            if trial_size < size:
                break
            damping *= 6.0
        if not trial_size < before:
            break
        damping = max(damping * (0.1 if trial_size < 0.25 * before else 0.5), 1e-14)
        for i in range(n):
            q[i] = trial[i]
        for i in range(6):
            error[i] = trial_error[i]
        size = trial_size
        if size > 0.9999 * before and size > 1e-10:
            break  # a local minimum
    distance = np.sqrt(error[0] ** 2 + error[1] ** 2 + error[2] ** 2)
    angle = np.sqrt(error[3] ** 2 + error[4] ** 2 + error[5] ** 2)
    return bool(distance < TOLERANCE and angle < TOLERANCE)


@inner_kernel
def _pose_error(
    poses: Array, tip: Array, target: Array, tip_pose: Array, error: Array
) -> float:
    """Write tip pose and its error (metres, rotation vector); return the squared norm."""
    n = poses.shape[0] - 1
    for r in range(3):
        for c in range(4):
            total = 0.0
            for k in range(3):
                total += poses[n, r, k] * tip[k, c]
            tip_pose[r, c] = total + (poses[n, r, 3] if c == 3 else 0.0)
    turn = np.empty((3, 3))
    for r in range(3):
        error[r] = target[r, 3] - tip_pose[r, 3]
        for c in range(3):
            turn[r, c] = (
                target[r, 0] * tip_pose[c, 0]
                + target[r, 1] * tip_pose[c, 1]
                + target[r, 2] * tip_pose[c, 2]
            )
    x, y, z = turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]
    sine = 0.5 * np.sqrt(x * x + y * y + z * z)
    cosine = 0.5 * (turn[0, 0] + turn[1, 1] + turn[2, 2] - 1.0)
    angle = np.arctan2(sine, cosine)
    if sine > 1e-7:
        scale = 0.5 * angle / sine
    elif cosine > 0.0:
        scale = 0.5
    else:
        # Half a turn: the antisymmetric part vanishes, any axis of the symmetric one serves.
        k = 0
        for i in range(3):
            if turn[i, i] > turn[k, k]:
                k = i
        along = np.sqrt(max(0.5 * (turn[k, k] + 1.0), 1e-12))
        x = np.pi * (along if k == 0 else 0.5 * turn[0, k] / along)
        y = np.pi * (along if k == 1 else 0.5 * turn[1, k] / along)
        z = np.pi * (along if k == 2 else 0.5 * turn[2, k] / along)
        scale = 1.0
    error[3], error[4], error[5] = scale * x, scale * y, scale * z
    size = 0.0
    for r in range(6):
        size += error[r] * error[r]
    return size


@inner_kernel
def _jacobian(joints: JointTable, poses: Array, tip_pose: Array, out: Array) -> None:
    """Write the geometric Jacobian of the tip in the base frame, shape (6, n)."""
    for j in range(len(joints.prismatic)):
        pose = poses[j + 1]
        ax, ay, az = joint_axis(joints, poses, j)
        if joints.prismatic[j]:
            out[0, j], out[1, j], out[2, j] = ax, ay, az
            out[3, j] = out[4, j] = out[5, j] = 0.0
            continue
        dx = tip_pose[0, 3] - pose[0, 3]
        dy = tip_pose[1, 3] - pose[1, 3]
        dz = tip_pose[2, 3] - pose[2, 3]
        out[0, j], out[1, j], out[2, j] = (
            ay * dz - az * dy,
            az * dx - ax * dz,
            ax * dy - ay * dx,
        )
        out[3, j], out[4, j], out[5, j] = ax, ay, az


@inner_kernel
def _normal_equations(
    joints: JointTable,
    jacobian: Array,
    error: Array,
    q: Array,
    normal: Array,
    gradient: Array,
) -> None:
    """Write J'J (lower triangle) and J'e; joints pushed out of their limits take no part."""
    lower, upper = joints.lower, joints.upper
    n = q.shape[0]
    for i in range(n):
        total = 0.0
        for r in range(6):
            total += jacobian[r, i] * error[r]
        if (q[i] <= lower[i] and total < 0.0) or (q[i] >= upper[i] and total > 0.0):
            total = 0.0
            for r in range(6):
                jacobian[r, i] = 0.0
        gradient[i] = total
        for j in range(i + 1):
            total = 0.0
            for r in range(6):
                total += jacobian[r, i] * jacobian[r, j]
            normal[i, j] = total


@inner_kernel
def _solve_positive(matrix: Array, vector: Array) -> None:
    """Solve a positive definite system in place by Cholesky, lower triangle given."""
    n = vector.shape[0]
    for j in range(n):
        total = matrix[j, j]
        for k in range(j):
            total -= matrix[j, k] * matrix[j, k]
        root = np.sqrt(max(total, 1e-30))
        matrix[j, j] = root
        for i in range(j + 1, n):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = total / root
    for i in range(n):
        total = vector[i]
        for k in range(i):
            total -= matrix[i, k] * vector[k]
        vector[i] = total / matrix[i, i]
    for i in range(n - 1, -1, -1):
        total = vector[i]
        for k in range(i + 1, n):
            total -= matrix[k, i] * vector[k]
        vector[i] = total / matrix[i, i]

"""Slowdown of motions for joint effort limits, by inverse dynamics.

If a motion takes k times as long, its speeds are divided by k and its accelerations by k^2. The joint efforts are
then gravity + share * rest, where share = 1 / k^2 and rest is the effort beyond gravity at the original speed. The
largest share within the effort limits follows for each joint and sample. The excess between samples is bounded by
twice their second differences.

Robot descriptions have no friction and rotor inertia, so both are ignored; so are process forces.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import pinocchio
from scipy import constants

from planning.caches import BoundedCache
from planning.cell.robot_model import RobotModel
from planning.cell.shape import Shape
from planning.cell.workcell import PlacedRobot
from planning.timing.blended_path import BentPieces, BlendedPath
from planning.timing.path_bounds import EffortRows, PathEfforts
from planning.timing.smooth_path import SmoothPath
from planning.timing.stretch import Stretch
from planning.transforms import Array, Indices, Transform

_TURN = 0.05
"""Farthest from sample to sample, all joints added up [rad or m]."""

_FEWEST = 8
"""Steps from sample to sample of a stretch, at least."""

_PIECE = 2
"""The same between two rows of a skill's motion."""

_SPARE = 0.01
"""Share of its effort that gravity has to leave a joint which is to move."""


_KNOWN: BoundedCache[TorqueScaling] = BoundedCache(2000)
"""Slowdowns of skills, which plans of the same products share, by robot, payload and motion."""


@dataclass(frozen=True, eq=False)
class HandPayload:
    """A held part as payload.

    Attributes:
        mass: [kg].
        shape: of it; as to its rotational inertia, it counts as the box around it.
        pose: of its frame in the flange frame.
    """

    mass: float
    shape: Shape
    pose: Transform


@dataclass(frozen=True)
class TorqueScaling:
    """Slowdown of a motion by effort limits.

    Attributes:
        factor: how many times as long it has to take.
        easing: of a stretch, how many times as long it has to take to full speed and to rest, where
            that alone is enough; none if infinite.
        joint: index of the joint that asks for that, -1 for none.
        overloaded: index of a joint that gravity alone leaves less than a hundredth of its effort,
            which no slowing mends; -1 for none.
    """

    factor: float = 1.0
    easing: float = 1.0
    joint: int = -1
    overloaded: int = -1


def torque_limited_stretch(stretch: Stretch, bearing: TorqueScaling) -> Stretch:
    """Return a stretch within effort limits: slower throughout, or with lower accelerations only.

    The quicker of the two; the jerk is no greater than it was.
    """
    factor = bearing.factor
    slower = replace(
        stretch, cruise=stretch.cruise * factor, ramp=stretch.ramp * factor
    )
    if not math.isfinite(bearing.easing):
        return slower
    eased = replace(stretch, ramp=stretch.ramp * bearing.easing)
    return min(slower, eased, key=lambda found: found.seconds)


class ArmDynamics:
    """Inverse dynamics of a robot with its payload.

    Args:
        robot: where it stands.
        model: the robot, with the tool that it has on its flange.
        payloads: its payloads.
    """

    def __init__(
        self,
        robot: PlacedRobot,
        model: RobotModel,
        payloads: Sequence[HandPayload] = (),
    ) -> None:
        assert model.drives is not None
        self._effort = model.drives.effort
        self._body = _body(model).copy()
        down = robot.base[:3, :3].T @ (0.0, 0.0, -constants.g)
        self._body.gravity = pinocchio.Motion(down, np.zeros(3))
        for payload in payloads:
            self._body.appendBodyToJoint(
                model.dof,
                _box_inertia(payload),
                pinocchio.SE3(np.asarray(model.flange @ payload.pose)),
            )
        self._data = self._body.createData()
        bodies = (own.toDynamicParameters().tobytes() for own in self._body.inertias)
        self._content = model, down.tobytes(), *bodies

    def gravity(self, q: Array) -> Array:
        """Return the gravity load of the joints at ``q``, shape (n,) [N m or N]."""
        still = np.zeros(len(q))
        return np.array(pinocchio.rnea(self._body, self._data, q, still, still))

    def along_stretch(
        self, start: Array, displacement: Array, stretch: Stretch
    ) -> TorqueScaling:
        """Return the slowdown of a straight line in joint space by effort limits.

        The robot may speed up or slow down anywhere on it, at any speed that it can reach.

        Args:
            start: where it begins, shape (n,).
            displacement: from there to its end, shape (n,).
            stretch: how it is passed.
        """
        count = max(_FEWEST, math.ceil(float(np.abs(displacement).sum()) / _TURN))
        q = start + np.linspace(0.0, 1.0, count + 1)[:, None] * displacement
        still, along = np.zeros_like(q), np.tile(displacement, (count + 1, 1))
        weight = self._efforts(q, still, still)
        push = self._efforts(q, still, along) - weight
        swing = self._efforts(q, along, still) - weight
        # Full speed may be out of reach on a short way.
        fast = min(1.0, stretch.cruise / stretch.ramp) / stretch.cruise**2
        quick = 1.0 / (stretch.cruise * stretch.ramp)
        corners = [a * push + b * swing for a in (-quick, quick) for b in (0.0, fast)]
        loose, more = quick * _between(push), fast * _between(swing)
        slower = self._bearing(
            weight, _between(weight), np.array(corners), loose + more
        )
        if slower.joint < 0:
            return slower
        # At full speed, with lower accelerations: what they ask for is the rest.
        eased = [
            self._bearing(
                weight + speed * swing,
                _between(weight) + speed * _between(swing),
                np.array([-quick * push, quick * push]),
                loose,
            )
            for speed in (0.0, fast)
        ]
        easing = max(bearing.factor**2 for bearing in eased)
        if any(bearing.overloaded >= 0 for bearing in eased):
            easing = math.inf
        return replace(slower, easing=easing)

    def along_skill(self, motion: SmoothPath, rows: slice) -> TorqueScaling:
        """Return the slowdown of some rows of a skill's motion by effort limits.

        Args:
            motion: of the skill; what is executed is as quick, or slower by one factor.
            rows: which; more than one.
        """
        own = motion.t[rows], motion.q[rows], motion.v[rows], motion.a[rows]
        key = self._content, *(x.tobytes() for x in own)
        return _KNOWN.get(key, lambda: self._along_skill(*own))

    def _along_skill(self, t: Array, q: Array, v: Array, a: Array) -> TorqueScaling:
        """Return the slowdown of the rows of a skill, see ``along_skill``."""
        turns = np.abs(np.diff(q, axis=0)).sum(axis=1)
        counts = np.maximum(np.ceil(turns / _TURN).astype(np.int64), _PIECE)
        piece, share = _samples(counts)
        span = np.diff(t)[piece, None]
        since = span * share[:, None]
        jerk = (a[piece + 1] - a[piece]) / span
        rise = a[piece] + since * jerk
        rate = v[piece] + since * (a[piece] + since * jerk / 2.0)
        at = q[piece] + since * (
            v[piece] + since * (a[piece] / 2.0 + since * jerk / 6.0)
        )
        inner = (share > 0.0) & (share < 1.0)
        still = np.zeros_like(at)
        weight = self._efforts(at, still, still)
        rest = self._efforts(at, rate, rise) - weight
        loose, extra = _between(weight, inner), _between(rest, inner)
        return self._bearing(weight, loose, rest[None], extra)

    def along_rounded(self, path: BlendedPath, bent: BentPieces) -> PathEfforts:
        """Return the joint efforts along a path with rounded corners.

        Args:
            path: the path.
            bent: pieces of it that are not straight.
        """
        span = bent.high - bent.low
        turns = bent.first.sum(axis=1) * span
        counts = np.maximum(np.ceil(turns / _TURN).astype(np.int64), _PIECE)
        piece, share = _samples(counts)
        displacement = bent.low[piece] + share * span[piece]
        return PathEfforts(
            self.along_legs(path), self._rows(*path.states(displacement), piece)
        )

    def along_legs(self, path: BlendedPath) -> EffortRows:
        """Return the joint efforts along the straight legs of a path with rounded corners."""
        displacements = np.diff(path.points, axis=0)
        turns = np.abs(displacements).sum(axis=1)
        counts = np.maximum(np.ceil(turns / _TURN).astype(np.int64), _FEWEST)
        piece, share = _samples(counts)
        q = path.points[piece] + share[:, None] * displacements[piece]
        return self._rows(q, path.velocity[piece], np.zeros_like(q), piece)

    def _rows(
        self, q: Array, first: Array, second: Array, piece: Indices
    ) -> EffortRows:
        """Return the joint efforts of a path with free speed.

        Args:
            q: samples of it, shape (rows, n); what lies between those of a piece is allowed for.
            first, second: derivatives there by the way along the path, likewise.
            piece: which piece each sample is of, rising, shape (rows,).
        """
        begins = np.flatnonzero(np.diff(piece, prepend=-1, append=piece[-1] + 1))
        inner = np.ones(len(q), dtype=np.bool_)
        inner[begins[:-1]] = inner[begins[1:] - 1] = False
        still = np.zeros_like(q)
        weight = self._efforts(q, still, still)
        push = self._efforts(q, still, first) - weight
        swing = self._efforts(q, first, second) - weight
        room, more = self._effort - _between(weight, inner), _between(swing, inner)
        # Against gravity and with it.
        spare = np.stack([room - weight, room + weight], axis=1)
        rates = np.stack([np.abs(push) + _between(push, inner)] * 2, axis=1)
        squares = np.maximum(np.stack([more + swing, more - swing], axis=1), 0.0)
        joint = np.broadcast_to(np.arange(q.shape[1]), spare.shape)
        return EffortRows(
            spare.ravel(),
            rates.ravel(),
            squares.ravel(),
            joint.ravel(),
            begins * (spare.shape[1] * spare.shape[2]),
        )

    def _efforts(self, q: Array, v: Array, a: Array) -> Array:
        """Return the joint efforts in some states, shape (rows, n) [N m or N]."""
        body, data = self._body, self._data
        rows = zip(q, v, a, strict=True)
        return np.array([pinocchio.rnea(body, data, *row).copy() for row in rows])

    def _bearing(
        self, weight: Array, loose: Array, rest: Array, extra: Array
    ) -> TorqueScaling:
        """Return the least slowdown factor within effort limits, given gravity and the other terms.

        Args:
            weight: what gravity asks for at the samples, shape (rows, n).
            loose: by how much that may be more between them, likewise.
            rest: what the motion asks for besides, shape (cases, rows, n).
            extra: by how much that may be more between samples, shape (rows, n).
        """
        spare = self._effort - np.abs(weight) - loose
        known = np.isfinite(self._effort)
        tight = known & (spare <= _SPARE * self._effort)
        overloaded = int(np.argmax(tight.any(axis=0))) if tight.any() else -1
        # Against gravity and with it: what is left on the one side and on the other.
        up = self._effort - weight - loose
        down = self._effort + weight - loose
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.minimum(
                np.where(rest + extra > 0.0, up / (rest + extra), np.inf),
                np.where(rest - extra < 0.0, down / (extra - rest), np.inf),
            )
        share = np.where(tight, np.inf, share).min(axis=(0, 1))
        joint = int(np.argmin(share))
        if share[joint] >= 1.0:
            return TorqueScaling(overloaded=overloaded)
        factor = 1.0 / math.sqrt(float(share[joint]))
        return TorqueScaling(factor, math.inf, joint, overloaded)


def explain_unchecked_efforts(robot: PlacedRobot) -> str | None:
    """Return in words why the efforts of a robot cannot be checked; None where they can.

    A description may have no limits of effort or no masses, or values that were filled in by default.
    """
    return _missing_data(robot.model) or describe_weak_joint(robot)


def describe_weak_joint(robot: PlacedRobot) -> str | None:
    """Return in words which joint cannot hold its arm at HOME; None where all can.

    None, too, where the description does not have it.
    """
    model = robot.model
    if _missing_data(model) or model.drives is None:
        return None
    weight = np.abs(ArmDynamics(robot, model).gravity(robot.home))
    over = weight > model.drives.effort
    if not over.any():
        return None
    k = int(np.argmax(over))
    return (
        f"{model.joint_names[k]} would not even hold the arm at HOME: that takes {weight[k]:.3g} N m"
        f" or N, and its effort is {model.drives.effort[k]:.3g}"
    )


def _missing_data(model: RobotModel) -> str | None:
    if model.drives is None or not np.isfinite(model.drives.effort).any():
        return "its effort limits are unknown"
    if model.inertias is None:
        return "its masses are unknown"
    mass = model.inertias.mass
    for joint in sorted({part.joint for part in model.parts if part.joint >= 0}):
        if not mass[joint] > 0.0:
            return f"the mass is unknown of what {model.joint_names[joint]} moves"
    if len(mass) > 1 and np.ptp(mass) <= 0.0:
        return f"all links have the same mass, {mass[0]:g} kg, as by default"
    return None


def _between(values: Array, inner: npt.NDArray[np.bool_] | None = None) -> Array:
    """Return a bound on how much values may exceed those at the samples, like ``values``.

    Args:
        values: at samples, shape (rows, n).
        inner: which samples have neighbours on both sides, shape (rows,); by default all but the
            first and the last.
    """
    bend = np.zeros_like(values)
    bend[1:-1] = np.abs(np.diff(values, 2, axis=0))
    if inner is not None:
        bend[np.logical_not(inner)] = 0.0
    near = bend.copy()
    near[1:] = np.maximum(near[1:], bend[:-1])
    near[:-1] = np.maximum(near[:-1], bend[1:])
    return near / 4.0


def _samples(counts: Indices) -> tuple[Indices, Array]:
    """Return samples of pieces of a path: the piece and the fraction of each.

    Args:
        counts: steps from sample to sample of each piece, from its one end to the other, shape (p,).
    """
    piece = np.repeat(np.arange(len(counts)), counts + 1)
    begin = np.repeat(np.cumsum(counts + 1) - counts - 1, counts + 1)
    return piece, (np.arange(len(piece)) - begin) / counts[piece]


@lru_cache(maxsize=64)
def _body(model: RobotModel) -> pinocchio.Model:
    """Return the joints of a robot and the bodies on them, as pinocchio's model."""
    body, own = pinocchio.Model(), model.inertias
    assert own is not None
    for k in range(model.dof):
        kind = (
            pinocchio.JointModelPrismaticUnaligned
            if model.chain.prismatic[k]
            else pinocchio.JointModelRevoluteUnaligned
        )
        axis = np.array(model.chain.axis[k])
        place = pinocchio.SE3(np.array(model.chain.placement[k]))
        joint = body.addJoint(k, kind(axis), place, model.joint_names[k])
        moved = pinocchio.Inertia(float(own.mass[k]), own.centre[k], own.inertia[k])
        body.appendBodyToJoint(joint, moved, pinocchio.SE3.Identity())
    return body


def _box_inertia(payload: HandPayload) -> pinocchio.Inertia:
    x, y, z = payload.shape.size**2
    turning = payload.mass / 12.0 * np.diag([y + z, x + z, x + y])
    centre = np.asarray(payload.shape.centre_of_mass)
    return pinocchio.Inertia(payload.mass, centre, turning)
